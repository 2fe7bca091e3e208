"""dynaviz convert."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Annotated, Any

import typer

from dynaviz.cli.console import program, progress, show
from dynaviz.cli.options import SEQUENCE, Moved, refuse, takes
from dynaviz.errors import UsageError


@takes(SEQUENCE)
def convert(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SEQ|RUN",
            help="Sequence folder or bag; FORMAT:PATH forces the format. A run with --labels. "
            "download:NAME for a "
            "sequence of the public benchmark: 00, 05, av2, semindoor; without ground truth: "
            "twofloor, kthcampus.",
        ),
    ],
    out: Annotated[
        Path,
        typer.Argument(
            metavar="OUT",
            help="Output folder. Must not exist. download:NAME is written to OUT/NAME.",
        ),
    ],
    labels: Annotated[
        bool,
        typer.Option("--labels", help="Write the labels of a run as SemanticKITTI .label files."),
    ] = False,
    sequence: Moved = None,
    *,
    options: dict[str, Any],
) -> None:
    """Convert a sequence to the public benchmark's layout.

    Or, with --labels, write the labels of a run as .label files.

    \b
    dynaviz convert kitti/sequences/08 out/08 --frames 0:100
    dynaviz convert path/to/scans out/mine --poses trajectory.tum --sensor vlp16
    dynaviz convert "drive.bag#/velodyne_points" out/drive --poses map
    dynaviz convert recordings/drive/octomap sequences/08/predictions --labels
    dynaviz convert download:00 data

    Writes pcd/NNNNNN.pcd (points in the world frame, sensor pose in VIEWPOINT), sequence.toml
    (name, sensor and classes) and, if there is ground truth, gt_cloud.pcd (intensity 0 static, 1
    dynamic, 255 unlabelled). The original licence still applies to the copy.

    With --labels: one file per frame, NNNNNN.label with the frame number, and one uint32 per point
    in the order of the sequence: 9 for static and 251 for moving, as in SemanticKITTI's moving
    object segmentation task, with the decisions of the run's review.json; 0 where a person could
    not tell. The upper 16 bits number the object, and boxes.csv has its box in each frame.

    An interrupted download resumes. The archive is verified, unpacked and deleted.
    DYNAVIZ_DOWNLOAD_URL sets the address of a mirror that serves NAME.zip.
    """
    if sequence is not None and not labels:
        raise UsageError("--sequence: only with --labels")
    if labels:
        refuse(options, "--labels")
        _write_labels(source, out, sequence)
    elif source.startswith("download:"):
        refuse(options, "download:NAME")
        _download(source.removeprefix("download:"), out)
    else:
        _write_sequence(source, out, options)


def _write_sequence(source: str, out: Path, options: dict[str, Any]) -> None:
    from dynaviz import api
    from dynaviz.sources.datasets.convert import convert as write

    opened = api.open(source, **options)
    with progress(f"convert {opened.name}") as report:
        done = write(opened, out, lambda frame, total: report("write", frame, total))
    for remark in done.remarks():
        warnings.warn(remark, stacklevel=1)
    accuracy = (
        "poses bit for bit" if done.pose_error == 0 else f"largest pose error {done.pose_error:.0e}"
    )
    show(f"Written to {out}: {done.frames:,} frames, {done.points:,} points, {accuracy}.")
    show(f"Next: {program()} run METHOD {out}")


def _write_labels(run: str, out: Path, sequence: str | None) -> None:
    from dynaviz.runs.export import export_labels

    with progress("write labels") as report:
        frames, moving = export_labels(run, out, sequence, report)
    show(
        f"Written to {out}: {frames:,} frames, {moving:,} points moving (251), all others static "
        "(9), or undecided (0); boxes of objects in boxes.csv."
    )


def _download(name: str, out: Path) -> None:
    from dynaviz.sources.datasets.download import BASE, SEQUENCES, download

    with progress(name, unit={"fetch": "MB", "unpack": "files"}) as report:
        folder = download(name, out, os.environ.get("DYNAVIZ_DOWNLOAD_URL") or BASE, report)
    remark = (
        "" if SEQUENCES[name].labelled else " It has no ground truth, so runs on it have no scores."
    )
    show(
        f"Written to {folder}: {SEQUENCES[name].title}.{remark}",
        f"Next: {program()} run METHOD {folder}",
    )
