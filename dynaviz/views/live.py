"""Show a live session in a viewer, and keep a rolling recording of its last minutes, which survives
a kill.
"""

from __future__ import annotations

import contextlib
import math
import time
import uuid
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from dynaviz import colours
from dynaviz.arrays import F32, F64
from dynaviz.contracts.method import MethodInfo
from dynaviz.contracts.probe import State, Text, Value
from dynaviz.contracts.scan import Outcome
from dynaviz.errors import DataError
from dynaviz.online.player import Played
from dynaviz.views import keys, paths, viewer
from dynaviz.views.layout import CIRCLES, KEY_SHARE, blueprint, follow, solid
from dynaviz.views.record import states as drawing
from dynaviz.views.record.budget import Budget

SEGMENT = 20.0  # seconds of a file of the rolling recording
TRAIL = 5.0  # seconds: dynamic points of this time remain visible
FLUSH = 0.5  # seconds between writes to the file
STATE_POINTS = 8_000  # of each state and scan
STATES_EVERY = 1.0  # seconds between pictures of states, which some methods need long to prepare
KEPT_POINTS = 30_000  # static points drawn of each scan
MAP_EVERY = 2.0  # seconds between pictures of the static map
TRACE_POINTS = 2_000  # dynamic points of each scan that remain visible
REMOVED = "world/removed_now"
TRACES = "world/removed_lately"
LATENCY = "live/latency_ms"
DROPPED = "live/dropped_scans"
SUFFIX = ".rrd"
# brighter than the static map, which most of its points are in
SCAN_SHADE: colours.Colour = (
    200,
    200,
    208,
)
TITLE = (
    "scan (bright) in the static map (dark); dynamic points (pink), and those of the last "
    f"{TRAIL:.0f} s (small)"
)


class LiveRecording:
    """The sinks of a live session; also the probe of its method.

    Args:
        info: of the method.
        name: of the source, for display.
        folder: for the rolling recording, or None.
        minutes: how much of the past the rolling recording keeps.
        port: of a viewer on this machine, or None.
        period: seconds between scans.

    Raises:
        DataError: if the folder cannot be written.
    """

    def __init__(
        self,
        info: MethodInfo,
        name: str,
        folder: Path | None,
        minutes: float,
        port: int | None,
        period: float,
    ) -> None:
        self._info = info
        self._name = name
        self._folder = folder
        self._port = port
        self._period = period
        self._states = {state.name: state for state in info.emits}
        self._queue: list[tuple[State, Value]] = []
        self._segments: deque[Path] = deque()
        self._minutes = minutes
        self._viewer = self._started(None) if port is not None else None
        self._file: rr.RecordingStream | None = None
        self._segment_ends = 0.0
        self._flushed = 0.0
        self._mapped = -np.inf
        self._stated = -np.inf
        self._number = 0
        self._states_due = True
        if folder is not None:
            try:
                folder.mkdir(parents=True, exist_ok=True)
                self._number = 1 + max(
                    (int(path.stem[5:]) for path in folder.glob("live-[0-9]*.rrd")), default=-1
                )
                (folder / ".writable").write_bytes(b"")
                (folder / ".writable").unlink()
            except (OSError, ValueError) as error:
                raise DataError(
                    str(folder), f"cannot be written ({error})", hint="Choose another folder"
                ) from None

    def wants(self, name: str) -> bool:
        """True for every state of the method about once per second, from the first scan on."""
        return name in self._states and self._draws and self._states_due

    def emit(self, name: str, value: Value) -> None:
        """Keep a state of the scan that is being labelled; it is drawn with the scan."""
        if self.wants(name) and not isinstance(value, Text):
            self._queue.append((self._states[name], value))

    def wants_map(self) -> bool:
        """Whether it is time for a picture of the static map."""
        now = time.monotonic()
        rolls = self._folder is not None and now >= self._segment_ends  # each file has a map
        return self._draws and (rolls or now - self._mapped >= MAP_EVERY)

    def show(self, played: Played, dropped: int, static_map: F32 | F64 | None) -> None:
        """Draw a labelled scan, its states, and the static map if there is a new one."""
        if self._folder is not None:
            self._roll()
        scan = played.scan
        for stream in self._streams:
            stream.set_time(paths.FRAME, sequence=played.frame)
            if scan.stamp_ns is not None:
                stream.set_time(paths.SENSOR_TIME, timestamp=np.datetime64(scan.stamp_ns, "ns"))
        for path, drawn in self._drawn(played, dropped):
            self._log(path, drawn)
        budget = Budget(scan, STATE_POINTS)
        for state, value in self._queue:
            if (drawn := drawing.draw(value, state, scan, budget)) is not None:
                self._log(paths.state(self._info.name, state), drawn)
        now = time.monotonic()
        if self._queue:
            self._stated = now
        self._states_due = now - self._stated >= STATES_EVERY
        self._queue.clear()
        if static_map is not None:
            self._mapped = time.monotonic()
            shade = colours.UNSCORED[Outcome.UNLABELLED_KEPT]
            self._log(
                paths.MAP, rr.Points3D(static_map, colors=[shade], radii=rr.Radius.ui_points(1.0))
            )
        self._flush()

    def close(self) -> None:
        """Write everything, and leave the viewer open."""
        if self._viewer is not None:
            with contextlib.suppress(RuntimeError):  # it was closed
                self._viewer.flush(timeout_sec=5.0)
            self._viewer.disconnect()
        if self._file is not None:
            self._file.flush(timeout_sec=5.0)
            self._file.disconnect()

    @property
    def _draws(self) -> bool:
        """Whether anything is drawn: also before the first file, when the method begins."""
        return self._folder is not None or self._viewer is not None

    @property
    def _streams(self) -> list[rr.RecordingStream]:
        return [stream for stream in (self._viewer, self._file) if stream is not None]

    def _log(self, path: str, what: Any) -> None:
        for stream in self._streams:
            stream.log(path, what)

    def _drawn(self, played: Played, dropped: int) -> Iterator[tuple[str, Any]]:
        """What is drawn of a labelled scan."""
        scan = played.scan
        dynamic = played.labels.dynamic
        T = scan.T_world_sensor
        kept = np.flatnonzero(~dynamic & np.isfinite(scan.points).all(1))
        kept = kept[:: max(1, len(kept) // KEPT_POINTS)]
        reasons = [
            self._info.reasons[code].name for code in np.unique(played.labels.reasons[dynamic])
        ]
        shades = SCAN_SHADE, colours.BRIGHT[Outcome.UNLABELLED_REMOVED]
        yield paths.SENSOR, rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])
        yield (
            paths.SCAN,
            rr.Points3D(scan.points[kept], colors=[shades[0]], radii=rr.Radius.ui_points(1.5)),
        )
        traces = scan.points[dynamic][:: max(1, math.ceil(dynamic.sum() / TRACE_POINTS))]
        shade = colours.FIRM[Outcome.UNLABELLED_REMOVED]
        yield TRACES, rr.Points3D(traces, colors=[shade], radii=rr.Radius.ui_points(1.0))
        yield (
            REMOVED,
            rr.Points3D(scan.points[dynamic], colors=[shades[1]], radii=rr.Radius.ui_points(3.0)),
        )
        yield LATENCY, rr.Scalars(1000 * played.seconds)
        yield DROPPED, rr.Scalars(dropped)
        yield f"{paths.REMOVED_POINTS}/removed", rr.Scalars(int(dynamic.sum()))
        text = (
            f"{int(dynamic.sum()):,} dynamic points ({', '.join(reasons) or 'none'}), "
            f"{1000 * played.seconds:.0f} ms"
        )
        yield paths.LOG, rr.TextLog(text, level=rr.TextLogLevel.INFO)

    def _roll(self) -> None:
        """Start a new file if the last one is full, and delete those that are too old."""
        assert self._folder is not None
        now = time.monotonic()
        if now < self._segment_ends:
            return
        if self._file is not None:
            self._file.flush(timeout_sec=5.0)
            self._file.disconnect()
        path = self._folder / f"live-{self._number:06d}{SUFFIX}"
        self._number += 1
        self._file = self._started(path)
        self._segment_ends = now + SEGMENT
        self._segments.append(path)
        while len(self._segments) > self._room():
            with contextlib.suppress(OSError):
                self._segments.popleft().unlink()

    def _room(self) -> int:
        """Number of files: one more than the minutes need, because the last one is not full."""
        return math.ceil(60 * self._minutes / SEGMENT) + 1

    def _started(self, path: Path | None) -> rr.RecordingStream:
        """A stream with what does not change: to a file, or to the viewer if there is no path."""
        number = path.stem if path else "live"
        # The viewer keeps one layout per application: methods with other states need another.
        application = f"{paths.APPLICATION} live {self._info.name}"
        stream = rr.RecordingStream(
            application, recording_id=str(uuid.uuid4()), send_properties=False
        )
        layout = _layout(self._info, self._period)
        if path is not None:
            stream.save(str(path), default_blueprint=layout)
        else:
            assert self._port is not None
            stream.connect_grpc(viewer.url(self._port), default_blueprint=layout)
        stream.set_log_time_enabled(False)
        stream.send_recording_name(f"{self._name}: {self._info.name} {number}")
        values = rr.AnyValues(schema=paths.SCHEMA, method=self._info.name, source=self._name)
        stream.send_property(paths.LIVE, values)
        stream.log(paths.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        stream.log(paths.SENSOR, rr.TransformAxes3D(2.0), static=True)
        lines = rr.LineStrips3D(CIRCLES, colors=[90, 90, 100], radii=rr.Radius.ui_points(0.6))
        stream.log(paths.RINGS, lines, static=True)
        for state in self._states.values():
            if (context := drawing.legend(state)) is not None:
                stream.log(paths.state(self._info.name, state), context, static=True)
        for state in _shown(self._info):
            stream.log(paths.key(self._info.name, state), keys.strip([state]), static=True)
        return stream

    def _flush(self) -> None:
        now = time.monotonic()
        if now - self._flushed >= FLUSH:
            self._flushed = now
            if self._file is not None:
                self._file.flush(timeout_sec=5.0)
            if (
                self._viewer is not None
                and self._port is not None
                and not viewer.listens(self._port)
            ):
                self._viewer.disconnect()  # the window was closed
                self._viewer = None


def _shown(info: MethodInfo) -> list[State]:
    """The states that get a view."""
    return [state for state in info.emits if issubclass(state.kind, paths.SOLID)]


def _layout(info: MethodInfo, period: float) -> Any:
    """Left: the scan in the static map, with the dynamic points of the last seconds.

    Below it the method's states.
    """
    first = rrb.TimeRangeBoundary.cursor_relative
    now = rrb.TimeRangeBoundary.cursor_relative()
    # A range counts on its own timeline only; scans without stamps are on that of frames alone.
    past = [
        rrb.VisibleTimeRange(paths.FRAME, start=first(seq=-round(TRAIL / period)), end=now),
        rrb.VisibleTimeRange(paths.SENSOR_TIME, start=first(seconds=-TRAIL), end=now),
    ]
    drawn = [paths.MAP, paths.SCAN, REMOVED, TRACES, paths.RINGS, paths.SENSOR]
    trail = rrb.VisibleTimeRanges(past)
    live = solid(TITLE, drawn, follow(), overrides={f"/{TRACES}": trail})
    tabs = [_tab(info, state) for state in _shown(info)]
    columns = rrb.TextLogColumns(timeline_columns=[paths.FRAME], text_log_columns=["Body"])
    numbers = rrb.Vertical(
        _curve("time per scan [ms]", LATENCY),
        _curve("dropped scans", DROPPED),
        _curve("dynamic points per scan", f"{paths.REMOVED_POINTS}/removed"),
        rrb.TextLogView(name="log", origin=paths.LOG, columns=columns),
    )
    left = rrb.Vertical(live, rrb.Tabs(*tabs), row_shares=[3, 2]) if tabs else live
    layout = blueprint(rrb.Horizontal(left, numbers, column_shares=[3, 1]))
    layout.time_panel = rrb.TimePanel(
        state="collapsed", timeline=paths.FRAME, play_state="following"
    )
    return layout


def _tab(info: MethodInfo, state: State) -> Any:
    """A state in the static map, above its key."""
    path = paths.state(info.name, state)
    key = paths.key(info.name, state)
    view = solid(state.name, [path, paths.MAP, paths.RINGS, paths.SENSOR], follow())
    strip = rrb.Spatial2DView(
        name=keys.heading([state]), origin=key, background=[*colours.BACKGROUND, 255]
    )
    return rrb.Vertical(view, strip, name=state.name, row_shares=[KEY_SHARE, 1])


def _curve(name: str, path: str) -> Any:
    return rrb.TimeSeriesView(
        name=name, contents=[f"/{path}"], plot_legend=rrb.PlotLegend(visible=False)
    )
