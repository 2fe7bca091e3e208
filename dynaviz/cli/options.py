"""Options shared by the commands that open a sequence or write a run."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dynaviz.cli.console import set_quiet

if TYPE_CHECKING:
    from dynaviz.contracts.scan import Sequence


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

        return [handle.name for handle in registry.handles(kind) if handle.name.startswith(incomplete)]

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
    typer.Argument(metavar="METHOD", help="Method name; see 'dynaviz list methods'.", autocompletion=method_names),
]
Preset = Annotated[
    str | None,
    typer.Option(
        metavar="NAME", help="Published parameter set; see 'dynaviz list presets'.", autocompletion=preset_completions
    ),
]
Frames = Annotated[str | None, typer.Option(metavar="A:B", help="Use only these frames, as in a Python slice.")]
Stride = Annotated[int, typer.Option(metavar="N", help="Use every N-th frame.")]
SensorName = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|FILE.toml",
        help="Sensor, if the data do not define it; see 'dynaviz list sensors'.",
        autocompletion=sensor_completions,
    ),
]
Poses = Annotated[
    str | None,
    typer.Option(
        metavar="FILE|small-gicp",
        help="Sensor poses: a KITTI, TUM or CSV file, or an odometry that estimates them. For a bag also a topic or "
        "TF frame.",
    ),
]
RefinePoses = Annotated[
    bool, typer.Option("--refine-poses", help="Register each scan to the scans around it to refine its pose (open3d).")
]
Extrinsic = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,Z,ROLL,PITCH,YAW",
        help="Pose of the lidar on the vehicle, or a file with it, if the poses are those of the vehicle.",
    ),
]
PointsIn = Annotated[PointFrame | None, typer.Option(help="Coordinate frame of the stored points. [default: sensor]")]
Deskew = Annotated[
    bool | None,
    typer.Option("--deskew/--no-deskew", help="Compensate the motion during each sweep of a bag. [default: deskew]"),
]
Record = Annotated[RecordModeOption, typer.Option(help="How much to record in run.rrd.")]
RecordBudget = Annotated[
    str | None,
    typer.Option(metavar="SIZE", help="Size of the recordings, such as 2GB; states of the method are left out first."),
]
Workers = Annotated[int, typer.Option(min=1, metavar="N", help="Number of tiles that run at a time.")]
Scheduler = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Run the tiles on the workers of this Dask scheduler.")
]
Threads = Annotated[int | None, typer.Option(min=1, metavar="N", help="Threads for kernels. [default: all cores]")]


Json = Annotated[
    Path | None,
    typer.Option("--json", metavar="FILE", help="Also write the result as JSON to a file; - for standard output."),
]
Quiet = Annotated[bool, typer.Option("-q", "--quiet", help="Show no progress.", callback=set_quiet, expose_value=False)]


def recording_in(path: Path) -> Path:
    """The recording of a run, given the recording or the folder of the run."""
    return path / "run.rrd" if path.is_dir() else path


def open_sequence(path: str | list[str], **options: Any) -> Sequence:
    """``dynaviz.open``, imported on first use."""
    from dynaviz import api

    return api.open(path, **options)
