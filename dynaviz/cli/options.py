"""Options shared by the commands that open a sequence or write a run."""

from __future__ import annotations

import functools
import inspect
import shlex
import sys
from collections.abc import Callable, Collection, Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dynaviz.cli.console import set_quiet
from dynaviz.errors import UsageError

if TYPE_CHECKING:
    from dynaviz.sources.drive import Drive


class PointFrame(StrEnum):
    """Coordinate frames of stored points."""

    sensor = "sensor"
    world = "world"


class RecordModeOption(StrEnum):
    """How much a recording contains."""

    full = "full"
    errors = "errors"
    scores = "scores"
    none = "none"


def plugin_names(kind: str) -> Callable[[str], list[str]]:
    """Completes names of plug-ins of a kind."""

    def complete(incomplete: str) -> list[str]:
        from dynaviz.contracts import registry

        return [
            handle.name for handle in registry.handles(kind) if handle.name.startswith(incomplete)
        ]

    return complete


def sensor_completions(incomplete: str) -> list[str]:
    """Completes names of sensors."""
    from dynaviz.contracts.sensors import sensor_names

    return [name for name in sensor_names() if name.startswith(incomplete)]


def preset_completions(incomplete: str) -> list[str]:
    """Completes names of presets."""
    from dynaviz.contracts import registry

    return [name for name in sorted(registry.preset_files()) if name.startswith(incomplete)]


method_names = plugin_names("methods")
Method = Annotated[
    str,
    typer.Argument(
        metavar="METHOD",
        help="Method name; see 'dynaviz list methods'.",
        autocompletion=method_names,
    ),
]
Record = Annotated[RecordModeOption, typer.Option(help="How much to record in run.rrd.")]
Threads = Annotated[
    int | None, typer.Option(min=1, metavar="N", help="Threads for kernels. [default: all cores]")
]
Moved = Annotated[
    str | None,
    typer.Option("--sequence", metavar="SEQ", help="Sequence of the run, if it has moved."),
]
Review = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Decisions of a person (review.json), which ground truth and maps follow.",
    ),
]

SEQUENCE: dict[str, Any] = {
    "frames": Annotated[
        str | None, typer.Option(metavar="A:B", help="Use only these frames, as in a Python slice.")
    ],
    "stride": Annotated[int, typer.Option(metavar="N", help="Use every N-th frame.")],
    "sensor": Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE.toml",
            help="Sensor, if the data do not define it; see 'dynaviz list sensors'.",
            autocompletion=sensor_completions,
        ),
    ],
    "poses": Annotated[
        str | None,
        typer.Option(
            metavar="FILE|small-gicp",
            help="Sensor poses: a KITTI, TUM or CSV file, or an odometry that estimates them. For "
            "a bag also a topic "
            "or TF frame.",
        ),
    ],
    "refine_poses": Annotated[
        bool,
        typer.Option(
            "--refine-poses", help="Register each scan to the scans around it to refine its pose."
        ),
    ],
    "points_in": Annotated[
        PointFrame | None,
        typer.Option(help="Coordinate frame of the stored points. [default: sensor]"),
    ],
    "deskew": Annotated[
        bool | None,
        typer.Option(
            "--deskew/--no-deskew",
            help="Compensate the motion during each sweep. [default: deskew]",
        ),
    ],
    "extrinsic": Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z,ROLL,PITCH,YAW",
            help="Pose of the lidar on the vehicle, or a file with it, if the poses are those of "
            "the vehicle.",
        ),
    ],
}
"""Options of commands that open a sequence, by field of ``SequenceOptions``."""

METHOD: dict[str, Any] = {
    "preset": Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Published parameter set; see 'dynaviz list presets'.",
            autocompletion=preset_completions,
        ),
    ],
    "config": Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="TOML file with parameters, such as config.toml of a run."
        ),
    ],
    "settings": Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Set one parameter. Repeatable."),
    ],
    "seed": Annotated[
        int | None, typer.Option(min=0, metavar="N", help="Random seed of the method. [default: 0]")
    ],
    "threads": Threads,
}
"""Options of commands that start a method, by field of ``MethodOptions``."""

RUN: dict[str, Any] = {
    **METHOD,
    "online": Annotated[
        bool | None,
        typer.Option(
            "--online/--offline",
            help="Label each scan as soon as it is observed, or all scans at the end. [default: "
            "offline]",
        ),
    ],
    "variant": Annotated[
        str, typer.Option(metavar="NAME", help="Name of the parameter set, for tables.")
    ],
    "record": Record,
    "record_budget": Annotated[
        str | None,
        typer.Option(
            metavar="SIZE",
            help="Maximum size of the recordings, such as 2GB; the states of the method are left "
            "out first.",
        ),
    ],
    "view": Annotated[bool, typer.Option("--view", help="Show the run live in the viewer.")],
    "tiles": Annotated[
        str | None,
        typer.Option(
            metavar="METRES",
            help="Divide the map into squares of this size, for drives of any length.",
        ),
    ],
    "workers": Annotated[
        int, typer.Option(min=1, metavar="N", help="Number of tiles that run at a time.")
    ],
    "scheduler": Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS", help="Run the tiles on the workers of this Dask scheduler."
        ),
    ],
    "maps": Annotated[
        bool, typer.Option("--map/--no-map", help="Write static_map.pcd and dynamic_points.pcd.")
    ],
    "review": Review,
}
"""Options of commands that run a method on a sequence, by field of ``RunOptions``."""

COMMON = ("frames", "poses", "settings", "record", "sensor", "preset")
"""Listed before the others in the help of a command."""

DEFAULTS: dict[str, Any] = {
    "stride": 1, "refine_poses": False, "variant": "", "record": RecordModeOption.errors,
    "view": False, "workers": 1,
    "maps": True,
}  # fmt: skip
"""Defaults other than None."""


def takes(
    *tables: Mapping[str, Any], without: Collection[str] = ()
) -> Callable[[Callable[..., None]], Any]:
    """Give a command all options of some tables, which it receives as ``options``, a dictionary.

    The names and values are those of the keyword arguments of ``dynaviz.open`` and ``dynaviz.run``.

    Args:
        tables: ``SEQUENCE``, ``METHOD`` or ``RUN``.
        without: options that the command sets itself.
    """
    wanted = {name: kind for table in tables for name, kind in table.items() if name not in without}
    wanted = {name: wanted[name] for name in COMMON if name in wanted} | wanted

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(command)
        def call(*args: Any, **given: Any) -> None:
            options = {name: _plain(name, given.pop(name)) for name in wanted}
            command(*args, options=options, **given)

        own = inspect.signature(command, eval_str=True)
        listed = [each for name, each in own.parameters.items() if name != "options"]
        last = next(
            (k for k, each in enumerate(listed) if each.name in ("json", "quiet")), len(listed)
        )
        listed[last:last] = [
            inspect.Parameter(
                name,
                inspect.Parameter.KEYWORD_ONLY,
                default=DEFAULTS.get(name),
                annotation=annotation,
            )
            for name, annotation in wanted.items()
        ]
        listed = [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in listed]
        call.__signature__ = own.replace(parameters=listed)  # type: ignore[attr-defined]
        call.__annotations__ = {each.name: each.annotation for each in listed}
        return call

    return decorate


def refuse(options: Mapping[str, Any], what: str) -> None:
    """Raise UsageError if options of ``takes`` are given beside something that does
    not use them.
    """
    for name, value in options.items():
        if value and value != DEFAULTS.get(name):
            raise UsageError(f"--{name.replace('_', '-')}: not with {what}")


def _plain(name: str, value: Any) -> Any:
    """An option's value as Python functions take it."""
    if isinstance(value, StrEnum):
        return value.value
    return tuple(value or ()) if name == "settings" else value


Json = Annotated[
    Path | None,
    typer.Option(
        "--json",
        metavar="FILE",
        help="Also write the result as JSON to a file; - for standard output.",
    ),
]
Quiet = Annotated[
    bool,
    typer.Option("-q", "--quiet", help="Show no progress.", callback=set_quiet, expose_value=False),
]


def recording_in(path: Path) -> Path:
    """The recording of a run, given the recording or the folder of the run.

    Repaired if it is damaged.

    Raises:
        DataError: for a recording of which nothing can be read.
    """
    file = path / "run.rrd" if path.is_dir() else path
    if (
        file.suffix == ".rrd"
        and not file.exists()
        and (part := file.with_name(f".{file.name}.part")).is_file()
    ):
        file = part
    if not file.name.endswith((".rrd", ".rrd.part")) or not file.is_file():
        return file
    from dynaviz.views.read.repair import repaired

    return repaired(file)


def run_in(path: Path) -> Path:
    """The path of a run, or of what could be repaired of its recording if that is damaged."""
    file = recording_in(path)
    return file if file.is_file() and file not in (path, path / "run.rrd") else path


def typed_command() -> str:
    """What the user typed, for the record."""
    return shlex.join(["dynaviz", *sys.argv[1:]])


def open_posed_or_not(path: str, options: dict[str, Any]) -> tuple[Drive, str]:
    """The sequence, and the problem if it has no poses: then each scan is in its own frame.

    Raises:
        DataError, UsageError: as ``dynaviz.open``.
    """
    from dynaviz import api
    from dynaviz.errors import NoPoses
    from dynaviz.sources.datasets.pose_matching import NO_POSES

    try:
        return api.open(path, **options), ""
    except NoPoses as error:
        if options.get("poses") is not None:
            raise
        return api.open(path, **{**options, "poses": NO_POSES}), error.problem


def proposal(path: str) -> str:
    """The command that estimates poses and cleans the map."""
    name = Path(path.partition("#")[0]).stem or "clean"
    return shlex.join(["dynaviz", "clean", path, "-o", f"{name}_clean.laz"])
