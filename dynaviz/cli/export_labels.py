"""dynaviz export-labels."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import progress, show
from dynaviz.cli.options import Deskew, PointsIn, Poses, open_sequence


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("export-labels")(export_labels)


def export_labels(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run, or its labels.npz.")],
    sequence: Annotated[str, typer.Argument(metavar="SEQ", help="Sequence of the run. FORMAT:PATH forces the format.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Output folder. Must not exist.")],
    frames: Annotated[str | None, typer.Option(metavar="A:B", help="Frames of the run, if it used only some.")] = None,
    stride: Annotated[int, typer.Option(metavar="N", help="Stride of the run.")] = 1,
    poses: Poses = None,
    points_in: PointsIn = None,
    deskew: Deskew = None,
) -> None:
    """Export the labels of a run as SemanticKITTI .label files.

    \b
    dynaviz export-labels recordings/semantickitti_08/dufomap kitti/sequences/08 -o labels
    dynaviz export-labels labels.npz kitti/sequences/08 --frames 0:100 -o sequences/08/predictions

    Writes one file per frame, NNNNNN.label with the frame number, and one uint32 per point in the order of the
    sequence: 9 for static and 251 for moving, as in SemanticKITTI's moving object segmentation task.
    """
    from dynaviz.runs.export import export_labels as write

    opened = open_sequence(sequence, frames=frames, stride=stride, poses=poses, points_in=points_in, deskew=deskew)
    with progress(f"export labels of {opened.name}") as report:
        moving = write(run, opened, out, report)
    show(f"Written to {out}: {len(opened):,} frames, {moving:,} points moving (251), all others static (9).")
