"""Pictures and clips of a recording, without a screen."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rerun as rr
from rerun.experimental import ViewerClient

from dynaviz.errors import DynavizError, UsageError
from dynaviz.io.atomic import write_atomic
from dynaviz.progress import Progress, silent
from dynaviz.views import paths, viewer
from dynaviz.views.compare.compare_layout import CASE_TEXT
from dynaviz.views.read import clip
from dynaviz.views.read.reader import KINDS, AnyRecording, RunRecording, read, viewable

SIZE = (1600, 900)
BAR = 36  # pixels: height of the viewer's own bar, above the window
# pixels: limits of a window's edge
SMALLEST = 200
LARGEST = 7680
SECONDS_TO_LOAD = 120.0
SECONDS_OF_MESSAGES = 5.0  # the viewer shows its own messages over the window for this long

Picture = Callable[[], bytes]


def shot(
    recording: str | os.PathLike[str],
    out: str | os.PathLike[str],
    frames: Sequence[int] = (),
    view: str | None = None,
    size: tuple[int, int] = SIZE,
    case: int | None = None,
    progress: Progress = silent,
) -> list[Path]:
    """Render PNG pictures of a recording with its own layout, or an MP4 clip of a failure case.

    Args:
        recording: the file.
        out: the picture; with several frames, ``-NUMBER`` is inserted before its suffix. With the
            suffix ``.mp4``, a clip of ``case`` over its frames, by an eye that frames its box, or
            in ``view``.
        frames: positions in the run; if empty, the last one, but of the whole window the case at
            which the recording opens, if it has cases.
        view: name of a single view to show (``map``, ``frame``, a state's name); None for the whole
            window.
        size: width and height of the window, in pixels.
        case: number of a failure case in the recording's list, to show it instead of frames; None
            for frames.
        progress: called with ``render``, the number of finished pictures, and their total number.

    Returns:
        The files' paths.

    Raises:
        DataError: for a recording that cannot be read.
        UsageError: for a frame, case, view or size that does not exist.
        MissingDependency: without a graphics adapter.
    """
    out = Path(out)
    viewable(Path(recording))
    source = read(recording)
    if not all(SMALLEST <= edge <= LARGEST for edge in size):
        raise UsageError(
            f"--size {size[0]}x{size[1]}: each edge must have {SMALLEST} to {LARGEST} pixels"
        )
    if case is None and not frames and view is None and paths.CASE in _timelines(source):
        case = 1
    if case is None:
        return _frames(source, out, frames, view, size, progress)
    if frames:
        raise UsageError("--case and --frame cannot be combined. Give one of them")
    if not isinstance(source, RunRecording):
        return _difference(source, out, case, view, size)
    span = clip.case_span(source, case)
    if out.suffix.lower() != ".mp4":
        return _case(source, out, case, span, view, size)
    with _window(source, size, view or span.title) as client:
        if view is None:
            clip.show_alone(client, source, span)
        picture = _picture(client, view or span.title)
        pictures = _at_frames(client, span.frames, picture, progress)
        write_atomic(out, clip.encoded(pictures, span))
    return [out]


def parse_size(text: str) -> tuple[int, int]:
    """Width and height of ``1600x900``.

    Raises:
        UsageError: for another text.
    """
    if (match := re.fullmatch(r"(\d{1,5})[xX](\d{1,5})", text.strip())) is None:
        raise UsageError(f"--size {text}: give WIDTHxHEIGHT in pixels, for example 1600x900")
    return int(match[1]), int(match[2])


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
    while not viewer.patient(client.get_state).views:
        if time.monotonic() > end:
            raise DynavizError("the viewer did not load the recording in time")
        time.sleep(0.1)


@contextmanager
def _window(
    source: AnyRecording, size: tuple[int, int], view: str | None
) -> Iterator[ViewerClient]:
    """A viewer that shows a recording, without the messages that it shows at first."""
    with viewer.headless((size[0], size[1] + BAR * (view is None))) as client:
        start = time.monotonic()
        push(source.path, client)
        time.sleep(max(0.0, start + SECONDS_OF_MESSAGES - time.monotonic()))
        yield client


def _frames(
    source: AnyRecording,
    out: Path,
    frames: Sequence[int],
    view: str | None,
    size: tuple[int, int],
    progress: Progress,
) -> list[Path]:
    """Pictures of frames."""
    span = source.span or range(1)
    frames = tuple(frames) or (span[-1],)
    if wrong := [frame for frame in frames if frame not in span]:
        raise UsageError(
            f"--frame {wrong[0]}: {source.path} has the frames {span[0]} to {span[-1]}"
        )
    files = [
        out if len(frames) == 1 else out.with_name(f"{out.stem}-{frame:04d}{out.suffix}")
        for frame in frames
    ]
    with _window(source, size, view) as client:
        for file, png in zip(
            files, _at_frames(client, frames, _picture(client, view), progress), strict=True
        ):
            write_atomic(file, png)
    return files


def _case(
    source: RunRecording,
    out: Path,
    case: int,
    span: clip.CaseSpan,
    view: str | None,
    size: tuple[int, int],
) -> list[Path]:
    """A picture of a case: at its place on the timeline of cases, or of its worst frame without
    such a timeline.
    """
    with _window(source, size, view) as client:
        picture = _picture(client, view)
        if paths.CASE in _timelines(source):
            _go_to(client, paths.CASE, case)
        else:
            _go_to(client, paths.FRAME, span.worst)
        write_atomic(out, picture())
    return [out]


def _timelines(source: AnyRecording) -> set[str]:
    return {column.name for column in source.store.schema().index_columns()}


def _difference(
    source: AnyRecording, out: Path, case: int, view: str | None, size: tuple[int, int]
) -> list[Path]:
    """A picture of a case of a comparison."""
    count = sum(1 for _ in source.rows(CASE_TEXT, paths.CASE))
    if not count:
        raise UsageError(
            f"--case {case}: {source.path} contains {KINDS[source.kind]}, which has no cases. Give "
            "--frame"
        )
    if not 1 <= case <= count:
        raise UsageError(f"--case {case}: {source.path} has the cases 1 to {count}")
    if out.suffix.lower() == ".mp4":
        raise UsageError(
            f"--clip {out}: {source.path} contains a comparison. Give the run.rrd of a run"
        )
    with _window(source, size, view) as client:
        picture = _picture(client, view)
        _go_to(client, paths.CASE, case)
        write_atomic(out, picture())
    return [out]


def _at_frames(
    client: ViewerClient, frames: Sequence[int], picture: Picture, progress: Progress
) -> Iterator[bytes]:
    """A PNG of each frame."""
    for done, frame in enumerate(frames, 1):
        _go_to(client, paths.FRAME, frame)
        yield picture()
        progress("render", done, len(frames))


def _picture(client: ViewerClient, view: str | None) -> Picture:
    """What takes a picture of the whole window, or of a view, which gets the whole window.

    A view behind another's tab has no picture.
    """
    if view is None:
        return lambda: _without_bar(_drawn(client))
    views = viewer.patient(client.get_state).views
    ids = {shown.name: str(shown.view_id) for shown in views}
    view = view if view in ids else view.replace("_", " ")  # the name of a state
    if view not in ids:
        names = sorted(shown.name for shown in views if "/keys/" not in shown.origin)
        raise UsageError(f"--view-name {view}: choose from {', '.join(names)}")
    viewer.maximize(client, ids[view])
    return lambda: _drawn(client, ids[view])


def _go_to(client: ViewerClient, timeline: str, index: int) -> None:
    """Move the time cursor, and draw once.

    Data may be missing in the first picture after a jump.
    """
    viewer.patient(lambda: client.set_time(timeline, sequence=index, play_state="paused"))
    _drawn(client)


def _without_bar(png: bytes) -> bytes:
    """The picture of a window without the bar at its top, which has buttons and warnings."""
    import cv2

    window = np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR), np.uint8)
    return cv2.imencode(".png", window[BAR:])[1].tobytes()


def _drawn(client: ViewerClient, view_id: str | None = None) -> bytes:
    """A PNG of the window or of a view."""
    return viewer.patient(lambda: client.take_screenshot(view_id))
