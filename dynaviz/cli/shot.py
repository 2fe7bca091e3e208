"""dynaviz shot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import show


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("shot")(shot)


def shot(
    recording: Annotated[Path, typer.Argument(metavar="RUN.rrd", help="Recording of a run.")],
    out: Annotated[
        Path,
        typer.Option(
            "-o", "--out", help="Output image. With several frames, the frame number is inserted before .png."
        ),
    ],
    frames: Annotated[
        list[int] | None, typer.Option("--frame", metavar="N", help="Frame to render. Repeatable. [default: the last]")
    ] = None,
    view_name: Annotated[
        str | None, typer.Option(metavar="NAME", help="Render only this view. [default: the whole window]")
    ] = None,
) -> None:
    """Render images of a recording without a display.

    \b
    dynaviz shot recordings/demo/octomap/run.rrd --frame 30 -o octomap.png
    dynaviz shot run.rrd --frame 0 --frame 40 --view-name map -o map.png
    """
    from dynaviz.viz.shot import shot as render

    for path in render(recording, out, frames=tuple(frames or ()), view=view_name):
        show(f"Written to {path}.")
