"""What the verbs that open a sequence share: the options that say how."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from dynaviz.scan import Sequence


class PointFrame(StrEnum):
    """Where points may be."""

    sensor = "sensor"
    world = "world"


Frames = Annotated[str | None, typer.Option(metavar="A:B", help="Only these frames, as in a Python slice.")]
Stride = Annotated[int, typer.Option(help="Only every K-th frame.")]
SensorName = Annotated[str | None, typer.Option(help="The sensor, where the data do not tell (dynaviz list sensors).")]
Poses = Annotated[
    str | None,
    typer.Option(
        metavar="FILE", help="Poses of a folder of scans (KITTI, TUM, CSV); of a bag also a topic or TF frame."
    ),
]
PointsIn = Annotated[PointFrame | None, typer.Option(help="Frame of the points in the files. [default: sensor]")]
Deskew = Annotated[
    bool | None,
    typer.Option("--deskew/--no-deskew", help="Whether to move points of a bag by their own times. [default: do]"),
]


def open_sequence(path: str, **how: Any) -> Sequence:
    """``dynaviz.open``, loaded when it is needed."""
    from dynaviz import api

    return api.open(path, **how)
