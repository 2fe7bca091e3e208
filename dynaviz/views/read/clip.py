"""The frames of a failure case as an MP4 clip."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import RrdReader
from rerun.experimental import ViewerClient

from dynaviz import colours
from dynaviz.arrays import F64
from dynaviz.errors import DynavizError, UsageError
from dynaviz.views import paths, viewer
from dynaviz.views.cases import listed, suspicious
from dynaviz.views.layout import blueprint, solid
from dynaviz.views.read.reader import RunRecording
from dynaviz.views.record.scene import EDGES, WIRES

BEFORE_AND_AFTER = 5  # frames around those of the case
MOST = 60  # frames of a clip; of longer cases every n-th is shown
SECONDS = 4.0  # a clip lasts about this long ...
SLOWEST, FASTEST = 4.0, 15.0  # ... but shows this many frames per second at least and at most
CODEC = "vp09"  # in every OpenCV wheel, and browsers play it
CLOSEST = 14.0  # metres: distance of the eye from the middle of a small case
ASIDE: F64 = np.array([-0.55, -0.4, 0.73])  # direction from the case to the eye
SECONDS_TO_SHOW = 20.0
BOX = "world/clip"


@dataclass(frozen=True, slots=True, eq=False)
class CaseSpan:
    """Where and when a case is.

    Attributes:
        title: of its view.
        frames: positions in the run to show.
        worst: its worst frame.
        low, high: (3,) float64, metres, world frame: its box over all frames.
    """

    title: str
    frames: range
    worst: int
    low: F64
    high: F64


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
    return CaseSpan(f"case {number}: {case.what}", frames, case.worst_frame, np.array(case.low), np.array(case.high))


def show_alone(client: ViewerClient, recording: RunRecording, span: CaseSpan) -> None:
    """Replace the layout by one view, whose eye rests on the case.

    Raises:
        DynavizError: if the viewer does not show it in time.
    """
    contents = [paths.SCAN, paths.MAP, BOX, paths.SENSOR, paths.RINGS, paths.TRAJECTORY]
    entry = RrdReader(recording.path).recordings()[0]
    stream = rr.RecordingStream(entry.application_id, recording_id=entry.recording_id, send_properties=False)
    stream.connect_grpc(client.url)
    box = rr.Boxes3D(
        mins=[span.low], sizes=[span.high - span.low], colors=colours.NEUTRAL, radii=EDGES, fill_mode=WIRES
    )
    stream.log(BOX, box, static=True)  # that of this case alone; the recording draws those of all cases
    stream.send_blueprint(blueprint(solid(span.title, contents, _eye(span))), make_default=False)
    stream.flush(timeout_sec=SECONDS_TO_SHOW)
    stream.disconnect()
    end = time.monotonic() + SECONDS_TO_SHOW
    while span.title not in {view.name for view in viewer.patient(client.get_state).views}:
        if time.monotonic() > end:
            raise DynavizError("the viewer did not show the case in time")
        time.sleep(0.1)


def _eye(span: CaseSpan) -> rrb.EyeControls3D:
    middle = (span.low + span.high) / 2
    distance = max(CLOSEST, 1.3 * float(np.linalg.norm(span.high - span.low)))
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=middle + distance * ASIDE, look_target=middle, eye_up=[0.0, 0.0, 1.0]
    )


def encoded(pictures: Iterator[bytes], count: int) -> bytes:
    """An MP4 file.

    Args:
        pictures: PNG files of equal size.
        count: number of pictures, which decides their speed.

    Raises:
        DynavizError: if OpenCV cannot encode.
    """
    import cv2

    speed = float(np.clip(count / SECONDS, SLOWEST, FASTEST))
    with tempfile.TemporaryDirectory() as folder:
        file, writer = Path(folder) / "clip.mp4", None  # OpenCV takes the format from the suffix
        for png in pictures:
            picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
            assert picture is not None
            height, width = (edge - edge % 2 for edge in picture.shape[:2])  # the codec needs even edges
            if writer is None:
                writer = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*CODEC), speed, (width, height))
            writer.write(picture[:height, :width])
        if writer is not None:
            writer.release()
        if not file.is_file() or not file.stat().st_size:
            raise DynavizError("OpenCV cannot write MP4 here. Install opencv-python-headless from PyPI, or give a .png")
        return file.read_bytes()
