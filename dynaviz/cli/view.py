"""dynaviz view."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("view")(view)


def view(
    recordings: Annotated[list[Path], typer.Argument(metavar="RUN.rrd...", help="One or more recordings.")],
    web: Annotated[
        bool, typer.Option("--web", help="Show them in a browser on this machine instead of a window.")
    ] = False,
) -> None:
    """Open recordings in the viewer.

    \b
    dynaviz view recordings/demo/octomap/run.rrd
    dynaviz view a.rrd b.rrd --web
    """
    from dynaviz.viz.view import view as open_viewer

    open_viewer(recordings, web=web)
