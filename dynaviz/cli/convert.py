"""dynaviz convert."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import program, progress, show
from dynaviz.cli.options import Deskew, Frames, PointsIn, Poses, SensorName, Stride, open_sequence


def add_to(app: typer.Typer) -> None:
    """Register the verb."""
    app.command("convert")(convert)


def convert(
    sequence: Annotated[str, typer.Argument(metavar="SEQ", help="A folder or bag; FORMAT:PATH forces its format.")],
    out: Annotated[Path, typer.Argument(help="Folder for the copy; must not exist.")],
    frames: Frames = None,
    stride: Stride = 1,
    sensor: SensorName = None,
    poses: Poses = None,
    points_in: PointsIn = None,
    deskew: Deskew = None,
) -> None:
    """Write any sequence in the public benchmark's layout, for other tools and for sharing.

    \b
    dynaviz convert kitti/sequences/08 out/08 --frames 0:100
    dynaviz convert path/to/scans out/mine --poses trajectory.tum --sensor vlp16
    dynaviz convert "drive.bag#/velodyne_points" out/drive --poses map

    It has pcd/NNNNNN.pcd (points in the world frame, the sensor's pose in VIEWPOINT), gt_cloud.pcd where there is
    ground truth (intensity 0 static, 1 dynamic, 255 unlabelled), and sequence.toml with the name, sensor and classes.
    The data do not lose the licence they came under.
    """
    from dynaviz.datasets.convert import convert as write

    opened = open_sequence(
        sequence, frames=frames, stride=stride, sensor=sensor, poses=poses, points_in=points_in, deskew=deskew
    )
    with progress(f"converting {opened.name}") as tell:
        done = write(opened, out, lambda frame, total: tell("frames", frame, total))
    for remark in done.remarks():
        warnings.warn(remark, stacklevel=1)
    poses_ = "poses bit for bit" if done.pose_error == 0 else f"poses to {done.pose_error:.0e}"
    show(f"Written to {out}: {done.frames:,} frames, {done.points:,} points, {poses_}.")
    show(f"Next: {program()} run octomap_gf {out}")
