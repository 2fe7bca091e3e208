"""What the explorer adds to a recording that is open in the viewer.

A layout for a question, and marks in the world.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import RrdReader

from dynaviz import colours
from dynaviz.arrays import F64
from dynaviz.contracts.method import MethodInfo
from dynaviz.contracts.probe import Voxels
from dynaviz.contracts.scan import Outcome
from dynaviz.explain.rays import TouchingRays
from dynaviz.views import drawn, keys, paths
from dynaviz.views.layout import CLEAR, blueprint, follow, solid, with_key
from dynaviz.views.read.reader import RunRecording
from dynaviz.views.record.scene import EDGES, WIRES

BOX = "world/explore/box"
POINT = "world/explore/point"
RAYS = "world/explore/rays"
LOADING = "explore/loading"
MARKS = (BOX, POINT, RAYS)
CLOSEST = 12.0  # metres: distance of the eye from a small case
ASIDE: F64 = np.array([-0.55, -0.4, 0.73])  # direction from the case to the eye
FIELD_OF_VIEW = 55.0  # degrees: vertical, of the viewer's eye
ABOVE: F64 = np.array([-0.2, -0.15, 0.97])
CASE = "case"
FRAME = "frame"
MAP = "map"
LAYOUTS = (CASE, FRAME, MAP)
SHARES = [3, 2]  # of the height: the first view of a case, and those below
DIMMED = 4  # the colours of other rays are divided by this


class Focus:
    """Writes what to send to a viewer that has a recording open.

    Args:
        recording: of a run.
        info: of its method, if that is installed: which states are voxels, and where their keys
            are.
    """

    def __init__(self, recording: RunRecording, info: MethodInfo | None = None) -> None:
        self._recording = recording
        self._entry = RrdReader(recording.path).recordings()[0]
        self._states = _states(recording)
        self._voxels: set[str] = set()
        self._keys: dict[str, tuple[str, str]] = {}  # of each state: path and heading
        if info is not None:
            self._voxels = {
                paths.state(info.name, state) for state in info.emits if state.kind is Voxels
            }
            for states in keys.tabs(info):
                key = paths.key(info.name, states[0]), keys.heading(states)
                self._keys |= dict.fromkeys(
                    (paths.state(info.name, state) for state in states), key
                )

    def loading(self) -> bytes:
        """A layout that is drawn fast, for the time in which the viewer loads the recording.

        The viewer reads 10 ms after each picture that it draws. Without a graphics card, those of a
        case take seconds.

        Returns:
            The content of an ``.rrd`` file.
        """
        stream, sink = self._open()
        stream.log(LOADING, rr.TextDocument("Loading the recording ..."), static=True)
        body = rrb.TextDocumentView(origin=LOADING, name="loading")
        stream.send_blueprint(blueprint(body), make_active=True, make_default=False)
        return _content(stream, sink)

    def layout(
        self,
        kind: str,
        title: str,
        frame: int,
        low: F64,
        high: F64,
        colour: Outcome | None,
        eye: F64 | None = None,
        first: bool = False,
    ) -> bytes:
        """A layout, with the box of a case.

        Args:
            kind: one of ``LAYOUTS``: a case (its frame, the map and the state that decided it), the
                frame alone, or the map alone.
            title: of the first view.
            frame: position in the run.
            low, high: (3,) metres, world frame: the box.
            colour: outcome whose colour the box has; None for no box.
            eye: (3,) metres, world frame: from where a case is seen; None for obliquely from above.
            first: whether only the first view of a case shows points, to draw it sooner; the others
                follow later.

        Returns:
            The content of an ``.rrd`` file.
        """
        stream, sink = self._open()
        if colour is not None:
            look: dict[str, Any] = {
                "colors": [colours.BRIGHT[colour]],
                "radii": EDGES,
                "fill_mode": WIRES,
            }
            stream.log(BOX, rr.Boxes3D(mins=[low], sizes=[high - low], **look), static=True)
        body = self._body(kind, title, frame, low, high, eye, first)
        stream.send_blueprint(blueprint(body), make_active=True, make_default=False)
        return _content(stream, sink)

    def marks(self, point: F64 | None, rays: TouchingRays, lit: int | None) -> bytes:
        """A mark at a point, and its rays; they replace the earlier ones.

        Args:
            point: (3,) metres, world frame; None for no mark.
            rays: to draw.
            lit: frame whose rays stand out; None if none do.

        Returns:
            The content of an ``.rrd`` file.
        """
        stream, sink = self._open()
        at = np.zeros((0, 3)) if point is None else point[None]
        stream.log(
            POINT,
            rr.Points3D(at, colors=[255, 255, 255], radii=rr.Radius.ui_points(5.0)),
            static=True,
        )
        shades = np.array([colours.RAYS[kind] for kind in rays.kinds.tolist()], np.uint8).reshape(
            -1, 3
        )
        widths = np.full(len(shades), -0.8)  # negative: in points of the screen
        if lit is not None:
            here = rays.frames == lit
            shades[~here] //= DIMMED
            widths[here] = -2.5
        look: dict[str, Any] = {"colors": shades, "radii": widths} if len(shades) else {}
        stream.log(RAYS, rr.LineStrips3D(rays.strips, **look), static=True)
        return _content(stream, sink)

    def _open(self) -> tuple[rr.RecordingStream, rr.BinaryStream]:
        """A stream that adds to the recording in the viewer."""
        entry = self._entry
        stream = rr.RecordingStream(
            entry.application_id, recording_id=entry.recording_id, send_properties=False
        )
        stream.set_log_time_enabled(False)
        stream.set_log_tick_enabled(False)
        return stream, rr.binary_stream(stream)

    def _body(
        self, kind: str, title: str, frame: int, low: F64, high: F64, eye: F64 | None, first: bool
    ) -> Any:
        common = [paths.SENSOR, paths.TRAJECTORY, *MARKS]
        clouds = [f"{paths.MAP}/**", f"{paths.REMOVED}/**"]
        if kind == MAP:
            return solid("map", [*clouds, *common], eye_on(low, high, ABOVE, 45.0))
        if kind == FRAME:
            return solid("frame", [paths.SCAN, paths.MAP, paths.RINGS, *common], follow())
        near = eye_on(low, high, ASIDE, CLOSEST, eye)
        case = solid(title, [paths.SCAN, paths.MAP, *common], near)
        if first:
            return rrb.Vertical(
                case, rrb.TextDocumentView(origin=LOADING, name="whole run"), row_shares=SHARES
            )
        whole = solid("whole run", [*clouds, *common], eye_on(low, high, ABOVE, 30.0))
        below: list[Any] = [whole]
        if (state := self._deciding(frame, low, high)) is not None:
            path = f"/{state}"
            overrides = (
                {path: rr.VoxelGridMap.from_fields(opacity=CLEAR)}
                if state in self._voxels
                else None
            )
            name = f"state: {state.split('/')[-1]}"
            view = solid(name, [state, paths.SCAN, *common], near, overrides=overrides)
            below.append(with_key([view], *self._keys[state]) if state in self._keys else view)
        return rrb.Vertical(case, rrb.Horizontal(*below), row_shares=SHARES)

    def _deciding(self, frame: int, low: F64, high: F64) -> str | None:
        """The state with the largest share of its points or voxels in a box.

        None if none has any.
        """
        if not self._states:
            return None
        content = [f"/{path}" for path in self._states]
        with self._recording.decoding():
            chunks = self._recording.store.stream().filter(
                content=content, has_timeline=paths.FRAME
            )
            rows = drawn.rows_of(chunks, [frame])
        best = None
        most = 0.0
        for (path, _), row in rows.items():
            xyz = drawn.positions(row)
            if xyz is not None and len(xyz):
                share = float(((xyz >= low) & (xyz <= high)).all(1).mean())
                best, most = (path, share) if share > most else (best, most)
        return best


def _states(recording: RunRecording) -> list[str]:
    """Paths of the method's states in the world."""
    start = f"{paths.WORLD}/{recording.properties['method']}/"
    return [path for path in recording.entities() if path.startswith(start)]


def distance_to(low: F64, high: F64, closest: float = CLOSEST) -> float:
    """Metres from which a box fills the view."""
    return max(closest, 1.3 * float(np.linalg.norm(high - low)))


def eye_on(
    low: F64, high: F64, direction: F64, closest: float, place: F64 | None = None
) -> rrb.EyeControls3D:
    """An eye on a box, at a place, or in a direction from it at the distance that frames it."""
    middle = (low + high) / 2
    position = middle + distance_to(low, high, closest) * direction if place is None else place
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=position, look_target=middle, eye_up=[0.0, 0.0, 1.0]
    )


def _content(stream: rr.RecordingStream, sink: rr.BinaryStream) -> bytes:
    content = sink.read() or b""
    stream.disconnect()
    return content
