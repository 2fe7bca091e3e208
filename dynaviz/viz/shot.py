"""Pictures of a recording, without a screen."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path

import rerun as rr
from rerun.experimental import ViewerClient

from dynaviz.errors import DynavizError, UsageError
from dynaviz.io.atomic import write_atomic
from dynaviz.viz import paths, viewer
from dynaviz.viz.reader import AnyRecording, viewable

SIZE = (1600, 900)
SECONDS_TO_LOAD = 120.0
SECONDS_OF_MESSAGES = 5.0  # the viewer shows its own messages over the window for this long


def shot(
    recording: str | os.PathLike[str],
    out: str | os.PathLike[str],
    frames: Sequence[int] = (),
    view: str | None = None,
    size: tuple[int, int] = SIZE,
) -> list[Path]:
    """Render PNG pictures of a recording with its own layout.

    Args:
        recording: the file.
        out: the picture; with several frames, ``-NUMBER`` is inserted before its suffix.
        frames: positions in the run; the last one if empty.
        view: name of a single view to show (``map``, ``frame``, a state's name); None for the whole window.
        size: of the window, in pixels.

    Returns:
        The pictures' paths.

    Raises:
        DataError: for a recording that cannot be read.
        UsageError: for a frame or view that does not exist.
        MissingDependency: without a graphics adapter.
    """
    viewable(Path(recording))
    source, out = AnyRecording(recording), Path(out)
    count = source.frames
    frames = tuple(frames) or (max(count - 1, 0),)
    if wrong := [frame for frame in frames if not 0 <= frame < max(count, 1)]:
        raise UsageError(f"--frame {wrong[0]}: {source.path} has the frames 0 to {count - 1}")
    pictures = [out if len(frames) == 1 else out.with_name(f"{out.stem}-{frame:04d}{out.suffix}") for frame in frames]
    with viewer.headless(size) as client:
        start = time.monotonic()
        push(source.path, client)
        view_id = None if view is None else _alone(view, client)
        time.sleep(max(0.0, start + SECONDS_OF_MESSAGES - time.monotonic()))
        for frame, picture in zip(frames, pictures, strict=True):
            client.set_time(paths.FRAME, sequence=frame, play_state="paused")
            client.take_screenshot()  # data may still be missing in the first picture after a jump
            write_atomic(picture, client.take_screenshot(view_id))
    return pictures


def push(path: Path, client: ViewerClient) -> None:
    """Send a recording and its layout, and wait until they are shown.

    A viewer that opens the file itself would load it piece by piece, and leave pictures blank.

    Raises:
        DynavizError: where the viewer does not show it in time.
    """
    with rr.RecordingStream(paths.APPLICATION, send_properties=False) as stream:
        stream.connect_grpc(client.url)
        stream.log_file_from_path(path)
        stream.flush(timeout_sec=SECONDS_TO_LOAD)
    end = time.monotonic() + SECONDS_TO_LOAD
    while not client.get_state().views:
        if time.monotonic() > end:
            raise DynavizError("the viewer did not load the recording in time")
        time.sleep(0.1)


def _alone(view: str, client: ViewerClient) -> str:
    """Give a view the whole window, for one behind another's tab has no picture; returns its id."""
    ids = {shown.name: str(shown.view_id) for shown in client.get_state().views}
    if view not in ids:
        raise UsageError(f"--view-name {view}: choose from {', '.join(sorted(ids))}")
    blueprint = client.get_blueprint().blueprint
    blueprint["/viewport"]["ViewportBlueprint"]["maximized"] = ids[view]
    client.set_blueprint(blueprint, of="recording")
    return ids[view]
