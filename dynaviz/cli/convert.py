"""dynaviz convert."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Annotated, Any

import typer

from dynaviz.cli.console import program, progress, show
from dynaviz.cli.options import SEQUENCE, takes


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("convert")(convert)


@takes(SEQUENCE)
def convert(
    sequence: Annotated[
        str, typer.Argument(metavar="SEQ", help="Sequence folder or bag. FORMAT:PATH forces the format.")
    ],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Output folder. Must not exist.")],
    *,
    options: dict[str, Any],
) -> None:
    """Convert a sequence to the public benchmark's layout.

    \b
    dynaviz convert kitti/sequences/08 out/08 --frames 0:100
    dynaviz convert path/to/scans out/mine --poses trajectory.tum --sensor vlp16
    dynaviz convert "drive.bag#/velodyne_points" out/drive --poses map

    Writes pcd/NNNNNN.pcd (points in the world frame, sensor pose in VIEWPOINT), sequence.toml (name, sensor and
    classes) and, if there is ground truth, gt_cloud.pcd (intensity 0 static, 1 dynamic, 255 unlabelled). The original
    licence still applies to the copy.
    """
    from dynaviz import api
    from dynaviz.sources.datasets.convert import convert as write

    opened = api.open(sequence, **options)
    with progress(f"convert {opened.name}") as report:
        done = write(opened, out, lambda frame, total: report("write", frame, total))
    for remark in done.remarks():
        warnings.warn(remark, stacklevel=1)
    accuracy = "poses bit for bit" if done.pose_error == 0 else f"largest pose error {done.pose_error:.0e}"
    show(f"Written to {out}: {done.frames:,} frames, {done.points:,} points, {accuracy}.")
    show(f"Next: {program()} run METHOD {out}")
