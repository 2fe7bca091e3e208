"""dynaviz clean."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import print_json, program, progress, show, warn
from dynaviz.cli.options import (
    Deskew,
    Extrinsic,
    Frames,
    Json,
    PointsIn,
    Poses,
    Preset,
    Quiet,
    Record,
    RecordModeOption,
    RefinePoses,
    Scheduler,
    SensorName,
    Stride,
    Threads,
    Workers,
    method_names,
)


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("clean")(clean)


def clean(
    sequence: Annotated[
        str, typer.Argument(metavar="SEQ", help="Bag, folder of scans or sequence. FORMAT:PATH forces the format.")
    ],
    out: Annotated[
        Path,
        typer.Option("-o", "--out", metavar="MAP", help="Clean map: pcd, ply, las, laz or npz; a folder for tiles."),
    ],
    method: Annotated[
        str, typer.Option("-m", "--method", metavar="METHOD", help="Method.", autocompletion=method_names)
    ] = "seethrough",
    region: Annotated[
        str | None,
        typer.Option(
            metavar="BOX|FILE",
            help="Write only points inside: X0,Y0,X1,Y1 or X0,Y0,Z0,X1,Y1,Z1, or a file with the corners of a polygon.",
        ),
    ] = None,
    voxel_size: Annotated[
        float | None, typer.Option(metavar="METRES", help="Write one point per voxel of this size.")
    ] = None,
    tiles: Annotated[
        str | None,
        typer.Option(
            metavar="METRES|autoware",
            help="Run on squares of this size, for drives of any length, and write a file for each into a folder, "
            "or Autoware's divided map if MAP has no suffix; 'autoware' writes that without dividing the run.",
        ),
    ] = None,
    workers: Workers = 1,
    scheduler: Scheduler = None,
    keep_dynamic: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the removed points to this file.")
    ] = None,
    mark: Annotated[
        bool, typer.Option("--mark", help="Write all points, with the attributes 'dynamic' and 'reason'.")
    ] = False,
    drop_unposed: Annotated[
        bool, typer.Option("--drop-unposed", help="Leave out points that no pose covers, instead of keeping them.")
    ] = False,
    accept: Annotated[
        bool, typer.Option("--accept", help="Exit with 0 even if much was removed or the poses are likely wrong.")
    ] = False,
    frames: Frames = None,
    stride: Stride = 1,
    poses: Poses = None,
    refine_poses: RefinePoses = False,
    points_in: PointsIn = None,
    deskew: Deskew = None,
    extrinsic: Extrinsic = None,
    sensor: SensorName = None,
    preset: Preset = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Set one parameter. Repeatable.")
    ] = None,
    record: Record = RecordModeOption.errors,
    threads: Threads = None,
    json: Json = None,
    quiet: Quiet = False,
) -> None:
    """Clean a map of moving objects: from raw data to a map, in one command.

    Poses are estimated with small-gicp if there are none. Intensity, ring, time and all other attributes are kept.
    Writes the map, and next to it a folder with a summary, the labels and a recording. Exit code 3: the map is written,
    but more than 30 % of its points were removed, or the poses are likely wrong; --accept gives 0 instead.

    \b
    dynaviz clean drive.bag -o clean.laz
    dynaviz clean scans/ --poses trajectory.tum -o clean.pcd --voxel-size 0.1
    dynaviz clean drive.mcap -o map --tiles autoware --keep-dynamic removed.pcd
    dynaviz clean city/ -o city.laz --tiles 200 --workers 4
    dynaviz clean survey.laz --poses trajectory.csv -o clean.laz --region 500100,5400200,500300,5400400
    """
    from dynaviz import cleaning

    with progress(f"clean {sequence}") as report:
        cleaned = cleaning.clean(
            sequence,
            out,
            method=method,
            region=region,
            voxel_size=voxel_size,
            tiles=tiles,
            workers=workers,
            scheduler=scheduler,
            keep_dynamic=keep_dynamic,
            mark=mark,
            drop_unposed=drop_unposed,
            frames=frames,
            stride=stride,
            poses=poses,
            points_in=points_in,
            deskew=deskew,
            extrinsic=extrinsic,
            sensor=sensor,
            refine_poses=refine_poses,
            preset=preset,
            settings=tuple(settings or ()),
            record=record.value,
            threads=threads,
            command=shlex.join(["dynaviz", *sys.argv[1:]]),
            progress=report,
        )
    if not print_json(cleaned.to_dict(), json):
        show(cleaned, f"Written to {cleaned.maps[0].path} and {cleaned.folder}.")
        if record is not RecordModeOption.none:
            recording = shlex.quote(str(cleaned.folder / "run.rrd"))
            show(f"Check what was removed with: {program()} view {recording}")
        show(f"Points: {cleaned.account}")
    if cleaned.doubt and not accept:
        warn(cleaned.doubt)
        raise typer.Exit(3)
