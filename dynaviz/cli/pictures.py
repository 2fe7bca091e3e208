"""Pictures and videos of a recording, without a display."""

from __future__ import annotations

from pathlib import Path

from dynaviz.cli.console import progress, show
from dynaviz.errors import UsageError


def render_pictures(
    recording: Path,
    out: Path | None,
    clip: Path | None,
    frames: tuple[int, ...],
    case: int | None,
    view_name: str | None,
    size: str,
) -> None:
    """Write images of a recording, a video of a failure case, or both.

    Args:
        recording: the file.
        out: image; with several frames, the frame number is inserted before ``.png``.
        clip: video of the frames of a case.
        frames: frames to render; empty for the last.
        case: number of a failure case.
        view_name: renders only this view; None for the whole window.
        size: of the window in pixels, ``WxH``.
    """
    from dynaviz.views.read.shot import parse_size, shot

    if clip is not None and case is None:
        raise UsageError("--clip shows the frames of a case. Give its number with --case N")
    if clip is not None and clip.suffix.lower() != ".mp4":
        raise UsageError(f"--clip {clip}: the name must end in .mp4")
    if out is not None and out.suffix.lower() == ".mp4":
        raise UsageError(f"-o {out}: is for images. Give --clip {out}")
    with progress("render", unit="images") as report:
        files = [
            file
            for target in (out, clip)
            if target is not None
            for file in shot(recording, target, frames, view_name, parse_size(size), case, report)
        ]
    for file in files:
        show(f"Written to {file}.")
