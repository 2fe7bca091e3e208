"""dynaviz export-labels."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import progress, show
from dynaviz.cli.options import Moved


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("export-labels")(export_labels)


def export_labels(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Output folder. Must not exist.")],
    sequence: Moved = None,
) -> None:
    """Export the labels of a run as SemanticKITTI .label files.

    \b
    dynaviz export-labels recordings/semantickitti_08/dufomap -o labels
    dynaviz export-labels recordings/drive/octomap --sequence moved/drive.bag -o sequences/08/predictions

    Writes one file per frame, NNNNNN.label with the frame number, and one uint32 per point in the order of the
    sequence: 9 for static and 251 for moving, as in SemanticKITTI's moving object segmentation task.
    """
    from dynaviz.runs.export import export_labels as write

    with progress("export labels") as report:
        frames, moving = write(run, out, sequence, report)
    show(f"Written to {out}: {frames:,} frames, {moving:,} points moving (251), all others static (9).")
