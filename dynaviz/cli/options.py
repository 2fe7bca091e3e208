"""Options shared by the commands that open a sequence or write a run."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from dynaviz.scan import Sequence


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


Frames = Annotated[str | None, typer.Option(metavar="A:B", help="Use only these frames, as in a Python slice.")]
Stride = Annotated[int, typer.Option(metavar="N", help="Use every N-th frame.")]
SensorName = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Sensor, if the data do not define it; see 'dynaviz list sensors'."),
]
Poses = Annotated[
    str | None,
    typer.Option(
        metavar="FILE",
        help="Sensor poses of a folder of scans: KITTI, TUM or CSV file. For a bag also a topic or TF frame.",
    ),
]
PointsIn = Annotated[PointFrame | None, typer.Option(help="Coordinate frame of the stored points. [default: sensor]")]
Deskew = Annotated[
    bool | None,
    typer.Option("--deskew/--no-deskew", help="Compensate the motion during each sweep of a bag. [default: deskew]"),
]
Record = Annotated[RecordModeOption, typer.Option(help="How much to record in run.rrd.")]
Threads = Annotated[int | None, typer.Option(min=1, metavar="N", help="Threads for kernels. [default: all cores]")]


def open_sequence(path: str, **options: Any) -> Sequence:
    """``dynaviz.open``, imported on first use."""
    from dynaviz import api

    return api.open(path, **options)
