"""dynaviz run."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import print_json, program, progress, show, written
from dynaviz.cli.options import (
    Deskew,
    Extrinsic,
    Frames,
    Json,
    Method,
    PointsIn,
    Poses,
    Preset,
    Quiet,
    Record,
    RecordBudget,
    RecordModeOption,
    RefinePoses,
    Scheduler,
    SensorName,
    Stride,
    Threads,
    Workers,
    open_sequence,
)


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("run")(run)


def run(
    method: Method,
    sequence: Annotated[
        list[str],
        typer.Argument(
            metavar="SEQ",
            help="Sequence folder or bag; several drives in one world frame are one sequence. FORMAT:PATH forces the "
            "format.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="Output folder. [default: recordings/SEQUENCE/METHOD]"),
    ] = None,
    frames: Frames = None,
    stride: Stride = 1,
    online: Annotated[
        bool | None,
        typer.Option(
            "--online/--offline",
            help="Label each scan as soon as it is observed, or all scans at the end. [default: offline]",
        ),
    ] = None,
    preset: Preset = None,
    config: Annotated[
        Path | None, typer.Option(metavar="FILE", help="TOML file with parameters, such as config.toml of a run.")
    ] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Set one parameter. Repeatable.")
    ] = None,
    sensor: SensorName = None,
    poses: Poses = None,
    refine_poses: RefinePoses = False,
    points_in: PointsIn = None,
    deskew: Deskew = None,
    extrinsic: Extrinsic = None,
    record: Record = RecordModeOption.errors,
    record_budget: RecordBudget = None,
    view: Annotated[bool, typer.Option("--view", help="Show the run live in the viewer.")] = False,
    threads: Threads = None,
    seed: Annotated[
        int | None, typer.Option(min=0, metavar="N", help="Random seed of the method. [default: 0]")
    ] = None,
    tiles: Annotated[
        float | None,
        typer.Option(metavar="METRES", help="Divide the map into squares of this size, for drives of any length."),
    ] = None,
    workers: Workers = 1,
    scheduler: Scheduler = None,
    maps: Annotated[bool, typer.Option("--map/--no-map", help="Write static_map.pcd and dynamic_points.pcd.")] = True,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Run a method on a sequence.

    Writes labels, maps, scores and a recording.

    \b
    dynaviz run octomap_gf path/to/sequence
    dynaviz run octomap kitti/sequences/08 --frames 0:100 -o out/08
    dynaviz run octomap path/to/sequence --set resolution=0.2 --record scores
    dynaviz run dufomap path/to/scans --poses trajectory.tum
    dynaviz run dufomap "drive.bag#/velodyne_points" --poses map
    dynaviz run seethrough monday/ tuesday/ --tiles 200 --workers 4
    """
    from dynaviz import api

    opened = open_sequence(
        sequence if len(sequence) > 1 else sequence[0],
        frames=frames,
        stride=stride,
        sensor=sensor,
        poses=poses,
        points_in=points_in,
        deskew=deskew,
        extrinsic=extrinsic,
    )
    folder = out or Path("recordings") / opened.name / method
    with progress(f"{method} on {opened.name}") as report:
        result = api.run(
            method,
            opened,
            out=folder,
            record=record.value,
            view=view,
            refine_poses=refine_poses,
            preset=preset,
            config=config,
            settings=tuple(settings or ()),
            online=online,
            seed=seed,
            threads=threads,
            record_budget=record_budget,
            tiles=tiles,
            workers=workers,
            scheduler=scheduler,
            maps=maps,
            command=shlex.join(["dynaviz", *sys.argv[1:]]),
            progress=report,
        )
    if print_json(result.to_dict(), json):
        return
    from dynaviz.cli.cases import top_of

    command = f"{program()} failures {shlex.quote(str(folder / 'result.json'))}"
    show(result, *top_of(result, command), written(folder, record is not RecordModeOption.none))
