"""dynaviz view."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.options import recording_in


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("view")(view)


def view(
    recordings: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Recordings, or folders of runs.")],
    web: Annotated[
        bool, typer.Option("--web", help="Show them in a browser on this machine instead of a window.")
    ] = False,
    port: Annotated[
        int | None,
        typer.Option(
            min=1, max=65534, metavar="PORT", help="Port of the page, with --web; the next port is used, too."
        ),
    ] = None,
) -> None:
    """Open recordings in the viewer.

    \b
    dynaviz view recordings/demo/octomap/run.rrd
    dynaviz view a.rrd b.rrd --web
    dynaviz view recordings/demo/octomap --web --port 9090
    """
    from dynaviz.views.read.view import view as open_viewer

    open_viewer([recording_in(each) for each in recordings], web=web, port=port)
