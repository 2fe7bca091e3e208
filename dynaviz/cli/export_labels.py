"""dynaviz export-labels."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import progress, show
from dynaviz.cli.options import Deskew, PointsIn, Poses, open_sequence


def add_to(app: typer.Typer) -> None:
    """Register the verb."""
    app.command("export-labels")(export_labels)


def export_labels(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="The folder of a run, or its labels.npz.")],
    sequence: Annotated[str, typer.Argument(metavar="SEQ", help="What it ran on; FORMAT:PATH forces its format.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for the label files; must not exist.")],
    frames: Annotated[str | None, typer.Option(metavar="A:B", help="Those of the run.")] = None,
    stride: Annotated[int, typer.Option(help="That of the run.")] = 1,
    poses: Poses = None,
    points_in: PointsIn = None,
    deskew: Deskew = None,
) -> None:
    """Write a run's answers as SemanticKITTI's .label files.

    \b
    dynaviz export-labels recordings/semantickitti_08/dufomap kitti/sequences/08 -o labels
    dynaviz export-labels labels.npz kitti/sequences/08 --frames 0:100 -o sequences/08/predictions

    One file a frame, NNNNNN.label as the frame's number; one uint32 a point, in the order of the sequence: 9 for static
    and 251 for moving, the numbers of SemanticKITTI's task of moving object segmentation.
    """
    from dynaviz.datasets.export import export_labels as write

    opened = open_sequence(sequence, frames=frames, stride=stride, poses=poses, points_in=points_in, deskew=deskew)
    with progress(f"labels of {opened.name}") as tell:
        removed = write(run, opened, out, tell)
    show(f"Written to {out}: {len(opened):,} frames, {removed:,} points are moving (251), all others static (9).")
