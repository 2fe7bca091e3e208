"""Options shared by the commands that open a sequence or write a run."""

from __future__ import annotations

import functools
import inspect
import shlex
import sys
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dynaviz.cli.console import set_quiet
from dynaviz.contracts.options import options_of
from dynaviz.errors import UsageError
from dynaviz.runs.options import MethodOptions, RunOptions
from dynaviz.sources.options import SequenceOptions

if TYPE_CHECKING:
    from dynaviz.sources.drive import Drive


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
Moved = Annotated[
    str | None,
    typer.Option("--sequence", metavar="SEQ", help="Sequence of the run, if it has moved."),
]
_COMPLETIONS = {"sensor": sensor_completions, "preset": preset_completions}


def _table(kind: type) -> dict[str, Any]:
    """The options that a dataclass declares, as those of a command, by name."""
    return {
        each.name: Annotated[
            each.text.typed or each.kind,
            typer.Option(
                *each.text.flags,
                help=each.text.help,
                metavar=each.text.metavar,
                min=each.text.least,
                autocompletion=_COMPLETIONS.get(each.name),
            ),
        ]
        for each in options_of(kind)
    }


SEQUENCE = _table(SequenceOptions)
"""Options of commands that open a sequence."""

METHOD = _table(MethodOptions)
"""Options of commands that start a method."""

RUN = _table(RunOptions)
"""Options of commands that run a method on a sequence."""

if TYPE_CHECKING:
    Record = str
    Review = Path | None
    Threads = int | None
else:
    Record = RUN["record"]
    Review = RUN["review"]
    Threads = RUN["threads"]

COMMON = ("frames", "poses", "settings", "record", "sensor", "preset")
"""Listed before the others in the help of a command."""

DEFAULTS = {
    each.name: each.default or None if each.name == "settings" else each.default
    for each in options_of(SequenceOptions, RunOptions)
}
"""Their defaults; None for no settings."""


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
                default=DEFAULTS[name],
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
