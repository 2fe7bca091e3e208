"""dynaviz shot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import show


def add_to(app: typer.Typer) -> None:
    """Register the verb."""
    app.command("shot")(shot)


def shot(
    recording: Annotated[Path, typer.Argument(metavar="RUN.rrd")],
    out: Annotated[
        Path, typer.Option("-o", "--out", help="The picture; with several frames, the number is put before .png.")
    ],
    frames: Annotated[
        list[int] | None, typer.Option("--frame", metavar="N", help="A frame; may be repeated. [default: the last]")
    ] = None,
    view_name: Annotated[str | None, typer.Option(help="Only this view. [default: the whole window]")] = None,
) -> None:
    """Render pictures of a recording without a screen.

    \b
    dynaviz shot recordings/demo/octomap/run.rrd --frame 30 -o octomap.png
    dynaviz shot run.rrd --frame 0 --frame 40 --view-name map -o map.png
    """
    from dynaviz.viz.shot import shot as render

    for path in render(recording, out, frames=tuple(frames or ()), view=view_name):
        show(f"Written to {path}.")
