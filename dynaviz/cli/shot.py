"""dynaviz shot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import progress, show
from dynaviz.cli.options import recording_in
from dynaviz.errors import UsageError


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("shot")(shot)


def shot(
    recording: Annotated[Path, typer.Argument(metavar="RUN", help="Recording or folder of a run.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "-o", "--out", help="Output image. With several frames, the frame number is inserted before .png."
        ),
    ] = None,
    frames: Annotated[
        list[int] | None, typer.Option("--frame", metavar="N", help="Frame to render. Repeatable. [default: the last]")
    ] = None,
    case: Annotated[
        int | None, typer.Option(metavar="N", help="Failure case to render, by its number in the recording's list.")
    ] = None,
    clip: Annotated[
        Path | None, typer.Option(metavar="CLIP.mp4", help="Output video of the frames of a case; needs --case.")
    ] = None,
    view_name: Annotated[
        str | None, typer.Option(metavar="NAME", help="Render only this view. [default: the whole window]")
    ] = None,
    size: Annotated[str, typer.Option(metavar="WxH", help="Size of the window in pixels.")] = "1600x900",
) -> None:
    """Render images of a recording without a display, or a video of a failure case.

    \b
    dynaviz shot recordings/demo/octomap/run.rrd --frame 30 -o octomap.png
    dynaviz shot run.rrd --frame 0 --frame 40 --view-name map -o map.png
    dynaviz shot run.rrd --case 4 --size 3840x2160 -o case.png
    dynaviz shot run.rrd --case 4 --clip case.mp4
    """
    from dynaviz.views.read.shot import parse_size
    from dynaviz.views.read.shot import shot as render

    if out is None and clip is None:
        raise UsageError("nothing to write. Give -o IMAGE.png, or --case N --clip VIDEO.mp4")
    if clip is not None and case is None:
        raise UsageError("--clip shows the frames of a case. Give its number with --case N")
    if clip is not None and clip.suffix.lower() != ".mp4":
        raise UsageError(f"--clip {clip}: the name must end in .mp4")
    if out is not None and out.suffix.lower() == ".mp4":
        raise UsageError(f"-o {out}: is for images. Give --clip {out}")
    source = recording_in(recording)
    with progress("shot", unit="images") as report:
        files = [
            file
            for target in (out, clip)
            if target is not None
            for file in render(source, target, tuple(frames or ()), view_name, parse_size(size), case, report)
        ]
    for file in files:
        show(f"Written to {file}.")
