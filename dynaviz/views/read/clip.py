"""The frames of a failure case as an MP4 clip with a caption."""

from __future__ import annotations

import tempfile
import textwrap
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
from rerun.chunk import RrdReader
from rerun.experimental import ViewerClient

from dynaviz import colours
from dynaviz.arrays import F64, U8
from dynaviz.contracts.scan import ERRORS, Outcome
from dynaviz.errors import DynavizError, UsageError
from dynaviz.scores.failure_case import FailureCase
from dynaviz.scores.spans import LANES, Span, lane
from dynaviz.views import keys, paths, viewer
from dynaviz.views.cases import listed, suspicious
from dynaviz.views.layout import blueprint, solid
from dynaviz.views.read.focus import ASIDE, eye_on
from dynaviz.views.read.reader import RunRecording
from dynaviz.views.record.scene import EDGES, WIRES

BEFORE_AND_AFTER = 5  # frames around those of the case
MOST = 60  # frames of a clip; of longer cases every n-th is shown
SECONDS = 4.0  # a clip lasts about this long ...
# ... but shows this many frames per second at least and at most
SLOWEST = 4.0
FASTEST = 15.0
CODEC = "vp09"  # in every OpenCV wheel, and browsers play it
CLOSEST = 14.0  # metres: distance of the eye from the middle of a small case
SECONDS_TO_SHOW = 20.0
# pixels of a caption; ``NAMES``: left of its lanes
MARGIN = 8
LINE = 18
LETTER = 8
SWATCH = 14
NAMES = 64
LABELLED = (
    Outcome.FALSE_NEGATIVE,
    Outcome.FALSE_POSITIVE,
    Outcome.DYNAMIC_REMOVED,
    Outcome.STATIC_KEPT,
)
BOX = "world/clip"


@dataclass(frozen=True, slots=True, eq=False)
class CaseSpan:
    """Where and when a case is.

    Attributes:
        title: of its view.
        frames: positions in the run to show.
        worst: its worst frame.
        low, high: (3,) float64, metres, world frame: its box over all frames.
        sentence: what happened, and why.
        outcome: of its points.
        lanes: states over the frames of the run, by name of the lane.
        run: number of frames of the run.
    """

    title: str
    frames: range
    worst: int
    low: F64
    high: F64
    sentence: str
    outcome: Outcome
    lanes: Mapping[str, Sequence[tuple[str, Span]]]
    run: int


def case_span(recording: RunRecording, number: int) -> CaseSpan:
    """Where and when the case with a number is.

    Raises:
        UsageError: if the recording does not list it.
    """
    result = recording.result
    cases = [] if result is None else listed(result) or suspicious(result)
    if not 1 <= number <= len(cases):
        known = f"lists the cases 1 to {len(cases)}" if cases else "lists no case"
        raise UsageError(f"--case {number}: {recording.path} {known}")
    case = cases[number - 1]
    first = max(0, case.first_frame - BEFORE_AND_AFTER)
    end = min(recording.frames, case.last_frame + BEFORE_AND_AFTER + 1)
    frames = range(first, end, -(-(end - first) // MOST))
    failure = case if isinstance(case, FailureCase) else None
    outcome = ERRORS[failure.kind] if failure else Outcome.UNLABELLED_REMOVED
    spans = failure.spans if failure else {}
    lanes = {name: parts for name in LANES if (parts := lane(spans, name))}
    box = np.array(case.low), np.array(case.high)
    title = f"case {number}: {case.what}"
    return CaseSpan(
        title, frames, case.worst_frame, *box, case.sentence, outcome, lanes, recording.frames
    )


def show_alone(client: ViewerClient, recording: RunRecording, span: CaseSpan) -> None:
    """Replace the layout by one view, whose eye rests on the case.

    Raises:
        DynavizError: if the viewer does not show it in time.
    """
    contents = [paths.SCAN, paths.MAP, BOX, paths.SENSOR, paths.RINGS, paths.TRAJECTORY]
    entry = RrdReader(recording.path).recordings()[0]
    stream = rr.RecordingStream(
        entry.application_id, recording_id=entry.recording_id, send_properties=False
    )
    stream.connect_grpc(client.url)
    box = rr.Boxes3D(
        mins=[span.low],
        sizes=[span.high - span.low],
        colors=colours.NEUTRAL,
        radii=EDGES,
        fill_mode=WIRES,
    )
    # that of this case alone; the recording draws those of all cases
    stream.log(BOX, box, static=True)
    stream.send_blueprint(
        blueprint(solid(span.title, contents, eye_on(span.low, span.high, ASIDE, CLOSEST))),
        make_default=False,
    )
    stream.flush(timeout_sec=SECONDS_TO_SHOW)
    stream.disconnect()
    end = time.monotonic() + SECONDS_TO_SHOW
    while span.title not in {view.name for view in viewer.patient(client.get_state).views}:
        if time.monotonic() > end:
            raise DynavizError("the viewer did not show the case in time")
        time.sleep(0.1)


def encoded(pictures: Iterator[bytes], span: CaseSpan) -> bytes:
    """An MP4 file with a caption, the colours of points, and the case over time below each picture.

    Args:
        pictures: PNG files of equal size, one for each frame of ``span``.
        span: the case.

    Raises:
        DynavizError: if OpenCV cannot encode.
    """
    import cv2

    speed = float(np.clip(len(span.frames) / SECONDS, SLOWEST, FASTEST))
    with tempfile.TemporaryDirectory() as folder:
        # OpenCV takes the format from the suffix
        file = Path(folder) / "clip.mp4"
        writer = None
        for frame, png in zip(span.frames, pictures, strict=True):
            picture = np.asarray(
                cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR), np.uint8
            )
            picture = np.vstack([picture, caption(span, frame, picture.shape[1])[:, :, ::-1]])
            # the codec needs even edges
            height, width = (edge - edge % 2 for edge in picture.shape[:2])
            if writer is None:
                writer = cv2.VideoWriter(
                    str(file), cv2.VideoWriter.fourcc(*CODEC), speed, (width, height)
                )
            writer.write(picture[:height, :width])
        if writer is not None:
            writer.release()
        if not file.is_file() or not file.stat().st_size:
            raise DynavizError(
                "OpenCV cannot write MP4 here. Reinstall opencv-python-headless with pip, or give "
                "a .png"
            )
        return file.read_bytes()


def caption(span: CaseSpan, frame: int, width: int) -> U8:
    """(rows, width, 3) uint8 RGB.

    The case in words, the colours of its points, and its lanes with a cursor.
    """
    words = textwrap.wrap(span.sentence, max(20, (width - 2 * MARGIN) // LETTER))
    if span.outcome == Outcome.UNLABELLED_REMOVED:
        legend = [
            (colours.UNSCORED[span.outcome], "removed"),
            (colours.UNSCORED[Outcome.UNLABELLED_KEPT], "kept"),
        ]
    else:
        legend = [
            (colours.BRIGHT[outcome], paths.NAMES[outcome].split(": ")[-1]) for outcome in LABELLED
        ]
    shades = colours.span_colours(span.outcome == Outcome.FALSE_NEGATIVE)
    used = dict.fromkeys(state for parts in span.lanes.values() for state, _ in parts)
    legend += [(shades[state], state) for state in used if state not in ("kept", "removed")]
    places = []
    row = len(words)
    at = MARGIN
    for _, name in legend:
        wide = SWATCH + 20 + LETTER * len(name)
        row, at = (row + 1, MARGIN) if at + wide > width else (row, at)
        places.append((row, at))
        at += wide
    rows = (row + 1 + len(span.lanes)) * LINE + 2 * MARGIN
    pixels: U8 = np.full((rows, width, 3), colours.BACKGROUND, np.uint8)
    for k, text in enumerate(words):
        _write(pixels, text, MARGIN, k)
    for (colour, name), (k, at) in zip(legend, places, strict=True):
        _row(pixels, k)[3:-3, at : at + SWATCH] = colour
        _write(pixels, name, at + SWATCH + 5, k)
    step = (width - NAMES - MARGIN) / max(span.run, 1)
    for k, (name, parts) in enumerate(span.lanes.items(), row + 1):
        _write(pixels, name, MARGIN, k)
        for state, (first, last) in parts:
            ends = slice(
                NAMES + int(step * first),
                NAMES + max(int(step * (last + 1)), int(step * first) + 1),
            )
            _row(pixels, k)[2:-2, ends] = shades[state]
    if span.lanes:
        cursor = NAMES + int(step * (frame + 0.5))
        pixels[-MARGIN - LINE * len(span.lanes) : -MARGIN, cursor - 1 : cursor + 1] = 255
    return pixels


def _row(pixels: U8, line: int) -> U8:
    return pixels[MARGIN + line * LINE : MARGIN + (line + 1) * LINE]


def _write(pixels: U8, text: str, left: int, line: int) -> None:
    import cv2

    plain = text.replace("°", " degrees")  # OpenCV's letters are ASCII
    base = MARGIN + (line + 1) * LINE - 5
    cv2.putText(
        pixels, plain, (left, base), cv2.FONT_HERSHEY_SIMPLEX, 0.45, keys.TEXT, 1, cv2.LINE_AA
    )
