"""dynaviz rescore."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import show
from dynaviz.cli.options import Moved


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("rescore")(rescore)


def rescore(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder or result.json of a run.")],
    sequence: Moved = None,
) -> None:
    """Score a run again with the corrected ground truth of its corrections.json.

    Corrections are made in the explorer. The run's own files and its sequence stay as they are.

    \b
    dynaviz explore recordings/demo/octomap
    dynaviz rescore recordings/demo/octomap
    """
    from dynaviz.runs.relabelling import rescore as score_again

    show(str(score_again(run, sequence)))
