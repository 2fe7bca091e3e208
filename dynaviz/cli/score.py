"""dynaviz score."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import progress, show, written
from dynaviz.cli.options import Frames, PointsIn, Poses, Stride, open_sequence
from dynaviz.cli.run import RecordModeOption


def add_to(app: typer.Typer) -> None:
    """Register the verb."""
    app.command("score")(score)


def score(
    map: Annotated[
        Path,
        typer.Argument(
            metavar="MAP", help="A cleaned map in the sequence's frame: pcd, ply, las, laz, npy; or labels.npz."
        ),
    ],
    sequence: Annotated[
        str, typer.Argument(metavar="SEQ", help="A folder with ground truth; FORMAT:PATH forces its format.")
    ],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="Folder for the files of the run. [default: recordings/SEQUENCE/NAME]"),
    ] = None,
    radius: Annotated[
        float, typer.Option(help="Metres around a point of the map in which points count as kept.")
    ] = 0.05,
    name: Annotated[str | None, typer.Option(help="For tables. [default: the map's file name]")] = None,
    frames: Frames = None,
    stride: Stride = 1,
    poses: Poses = None,
    points_in: PointsIn = None,
    record: Annotated[RecordModeOption, typer.Option(help="How much run.rrd holds.")] = RecordModeOption.errors,
    threads: Annotated[int | None, typer.Option(min=1, help="Threads for kernels. [default: all cores]")] = None,
) -> None:
    """Score a cleaned map that any other program wrote, with a recording.

    \b
    dynaviz score erasor_output.pcd path/to/sequence
    dynaviz score cleaned.laz path/to/sequence --radius 0.1 -o out/cleaned
    dynaviz score recordings/demo/octomap/labels.npz path/to/demo --name again
    """
    from dynaviz import api

    opened = open_sequence(sequence, frames=frames, stride=stride, poses=poses, points_in=points_in)
    called = map.stem if name is None else name
    folder = out or Path("recordings") / opened.name / called
    with progress(f"{called} on {opened.name}") as tell:
        result = api.score(
            map,
            opened,
            radius=radius,
            name=name,
            out=folder,
            record=record.value,
            threads=threads,
            command=shlex.join(["dynaviz", *sys.argv[1:]]),
            progress=tell,
        )
    show(result, written(folder, record is not RecordModeOption.none))
