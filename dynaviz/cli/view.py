"""dynaviz view."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import progress, show
from dynaviz.cli.options import recording_in, refuse
from dynaviz.errors import UsageError


def view(
    recordings: Annotated[
        list[Path], typer.Argument(metavar="RUN...", help="Recordings, or folders of runs.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            help="Render a picture to this file, without a display; with several frames, one file "
            "per frame.",
        ),
    ] = None,
    frames: Annotated[
        list[int] | None,
        typer.Option(
            "--frame", metavar="N", help="Frame to render. Repeatable. [default: the last]"
        ),
    ] = None,
    case: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="Failure case to render, by its number in the recording's list."
        ),
    ] = None,
    clip: Annotated[
        Path | None,
        typer.Option(
            metavar="CLIP.mp4", help="Output video of the frames of a case; needs --case."
        ),
    ] = None,
    view_name: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Render only this view. [default: the whole window]"),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(metavar="WxH", help="Size of the picture in pixels. [default: 1600x900]"),
    ] = None,
    web: Annotated[
        bool,
        typer.Option("--web", help="Show them in a browser on this machine instead of a window."),
    ] = False,
    port: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=65534,
            metavar="PORT",
            help="Port of the page, with --web. The next port is also used.",
        ),
    ] = None,
) -> None:
    """Open recordings in the viewer, or render pictures and videos.

    \b
    dynaviz view recordings/demo/octomap/run.rrd
    dynaviz view a.rrd b.rrd --web
    dynaviz view recordings/demo/octomap --web --port 9090
    dynaviz view recordings/demo/octomap --frame 30 -o octomap.png
    dynaviz view run.rrd --frame 0 --frame 40 --view-name map -o map.png
    dynaviz view run.rrd --case 4 --size 3840x2160 -o case.png
    dynaviz view run.rrd --case 4 --clip case.mp4
    """
    if out is not None or clip is not None:
        refuse({"web": web, "port": port}, "-o or --clip")
        if len(recordings) > 1:
            raise UsageError("-o and --clip render one recording. Give one RUN")
        if clip is not None and case is None:
            raise UsageError("--clip shows the frames of a case. Give its number with --case N")
        if clip is not None and clip.suffix.lower() != ".mp4":
            raise UsageError(f"--clip {clip}: the name must end in .mp4")
        if out is not None and out.suffix.lower() == ".mp4":
            raise UsageError(f"-o {out}: is for images. Give --clip {out}")
        from dynaviz.views.read.shot import parse_size, shot

        file = recording_in(recordings[0])
        pixels = parse_size(size or "1600x900")
        files = []
        with progress("render", unit="images") as report:
            for target in filter(None, (out, clip)):
                files += shot(file, target, tuple(frames or ()), view_name, pixels, case, report)
        show(*(f"Written to {each}." for each in files))
        return
    refuse(
        {"frame": frames, "case": case is not None, "view_name": view_name, "size": size},
        "a window. Give -o IMAGE.png, or --case N --clip VIDEO.mp4",
    )
    from dynaviz.views.read.view import view as open_viewer

    open_viewer([recording_in(each) for each in recordings], web=web, port=port)
