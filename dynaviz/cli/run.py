"""dynaviz run."""

from __future__ import annotations

import shlex
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import progress, show, written
from dynaviz.cli.options import Deskew, Frames, PointsIn, Poses, SensorName, Stride, open_sequence


class RecordModeOption(StrEnum):
    """How much a recording holds."""

    full = "full"
    errors = "errors"
    scores = "scores"
    none = "none"


def add_to(app: typer.Typer) -> None:
    """Register the verb."""
    app.command("run")(run)


def run(
    method: Annotated[str, typer.Argument(help="A method's name (dynaviz list methods).")],
    sequence: Annotated[str, typer.Argument(metavar="SEQ", help="A folder or bag; FORMAT:PATH forces its format.")],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="Folder for the files of the run. [default: recordings/SEQUENCE/METHOD]"),
    ] = None,
    frames: Frames = None,
    stride: Stride = 1,
    online: Annotated[
        bool | None,
        typer.Option("--online/--offline", help="Label each scan right after it was seen, or after all were."),
    ] = None,
    preset: Annotated[str | None, typer.Option(help="Published parameters (dynaviz list presets).")] = None,
    config: Annotated[Path | None, typer.Option(help="TOML file with parameters, as config.toml of a run.")] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="One parameter; may be repeated.")
    ] = None,
    sensor: SensorName = None,
    poses: Poses = None,
    points_in: PointsIn = None,
    deskew: Deskew = None,
    record: Annotated[RecordModeOption, typer.Option(help="How much run.rrd holds.")] = RecordModeOption.errors,
    view: Annotated[bool, typer.Option("--view", help="Show the run in a viewer while it goes on.")] = False,
    threads: Annotated[int | None, typer.Option(min=1, help="Threads for kernels. [default: all cores]")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="For everything random in the method. [default: 0]")] = None,
) -> None:
    """Run a method on a sequence: labels, scores and a recording.

    \b
    dynaviz run octomap_gf path/to/sequence
    dynaviz run octomap kitti/sequences/08 --frames 0:100 -o out/08
    dynaviz run octomap path/to/sequence --set resolution=0.2 --record scores
    dynaviz run dufomap path/to/scans --poses trajectory.tum
    dynaviz run dufomap "drive.bag#/velodyne_points" --poses map
    """
    from dynaviz import api

    opened = open_sequence(
        sequence, frames=frames, stride=stride, sensor=sensor, poses=poses, points_in=points_in, deskew=deskew
    )
    folder = out or Path("recordings") / opened.name / method
    with progress(f"{method} on {opened.name}") as tell:
        result = api.run(
            method,
            opened,
            out=folder,
            record=record.value,
            view=view,
            preset=preset,
            config=config,
            settings=tuple(settings or ()),
            online=online,
            seed=seed,
            threads=threads,
            command=shlex.join(["dynaviz", *sys.argv[1:]]),
            progress=tell,
        )
    show(result, written(folder, record is not RecordModeOption.none))
