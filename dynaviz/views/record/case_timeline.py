"""The timeline ``case``: an arrow key flies from case to case, each shown as in its worst frame.

At the index of a case: its box, the scan and the states as they were drawn in its worst frame, the
rays that touched it, and a text. On the timeline of frames, the box and the text are those of the
costliest case in the frame.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr

from dynaviz import colours
from dynaviz.arrays import F32, F64, I64, Bool
from dynaviz.contracts.method import MethodInfo
from dynaviz.contracts.metric import FrameBoxes
from dynaviz.contracts.scan import Outcome
from dynaviz.explain import rays
from dynaviz.explain.case_evidence import evidence_text
from dynaviz.explain.point_ledger import PointLedger
from dynaviz.scores.spans import LANES, lane
from dynaviz.views import classes, drawn, object_lanes, paths, stored_ledgers
from dynaviz.views.cases import POINTS, ShownCase, middle_of
from dynaviz.views.layout import CIRCLE
from dynaviz.views.record import outlines
from dynaviz.views.record.outlines import FlatStates
from dynaviz.views.record.scene import NAME_STYLE, WIRES
from dynaviz.views.record.sink import RecordingFile

NEAR = 25.0  # metres from the middle of a case: the part of a state that is shown with it
SCENE = 40.0  # metres: the part of the scan
# metres: radius of the circle around a case; the eye tracks it, and its size sets the distance
AROUND = (
    7.0,
    13.0,
)
AIM_LINES = 3
BACK = 11.0  # metres: the same for the frame around the line from the sensor to the case
PICTURES = 8  # cases with range images and polar grids, which cannot be cut to a part
FURTHER = 3  # cases with those that frames do not show
LIFT = 0.22  # of this radius: height of the label above the box, so that it hides nothing
EDGES = rr.Radius.ui_points(1.2)
POINTS_ASKED = 64  # of a case: those whose evidence is stored
APART = 0.1  # metres: two of them are not in one cube of this edge
THIN = rr.Radius.ui_points(0.5)
RAYS = rr.Radius.ui_points(0.35)
OPACITY = 150  # of rays, of 255: the object behind them remains visible
HOW = "*Arrow keys: next and previous case. To replay the run, choose `frame` in the bar below.*"

Repeat = Callable[[Sequence[tuple[int, Sequence[int]]]], list[tuple[PointLedger, ...]]]
Members = Callable[[ShownCase, I64, F64], Bool]


class CaseTimeline:
    """Shows cases on their timeline.

    Args:
        sink: where to draw.
        info: of the method.
        cases: at least one.
    """

    def __init__(self, sink: RecordingFile, info: MethodInfo, cases: Sequence[ShownCase]) -> None:
        self._sink = sink
        self._info = info
        self._cases = cases
        self._names = object_lanes.names([object_of(case) for case in cases])

    def write_texts(self) -> None:
        """The texts alone, for recordings without coordinates."""
        for case in self._cases:
            self._sink.at_case(case.number)
            self._text(f"{case.text}\n\n{HOW}")
            self._lanes(case)

    def write_curves(self, scores: Mapping[str, float | None]) -> None:
        """What each case costs, and the scores if the cases up to each were right, as curves over
        the cases.

        Args:
            scores: of the run, in percent.
        """
        numbers = [case.number for case in self._cases]
        for name in sorted({name for case in self._cases for name in case.lost}):
            lost = [case.lost.get(name, np.nan) for case in self._cases]
            score = scores.get(name)
            colour = colours.SCORES.get(name, colours.NEUTRAL)
            path = f"{paths.CASE_COST}/{name}"
            label = "removed points" if name == POINTS else f"% of {name} lost"
            self._sink.log(
                path,
                rr.SeriesPoints(colors=colour, markers="circle", marker_sizes=4, names=label),
                static=True,
            )
            self._sink.case_columns(path, numbers, rr.Scalars.columns(scalars=lost))
            if score is not None:
                path = f"{paths.CASE_SCORE}/{name}"
                fixed = score + np.nancumsum(lost)
                self._sink.log(
                    path,
                    rr.SeriesLines(colors=colour, widths=1.5, names=f"{name} if fixed"),
                    static=True,
                )
                self._sink.case_columns(path, numbers, rr.Scalars.columns(scalars=fixed))

    def draw(
        self, repeat: Repeat, members: Members, poses: F64, boxes: FrameBoxes, flat: FlatStates
    ) -> tuple[str | None, dict[str, F32]]:
        """Draw the cases, on both timelines, and store the evidence on their points.

        Args:
            repeat: repeats the run.
            members: tells which of the recorded points belong to a case, by their rows and places.
            poses: (frames, 4, 4) T_world_sensor of each frame.
            boxes: of the cases, by frame.
            flat: the pictures of the method's states.

        Returns:
            Of the first case: the state that shows most about it, None if no state was drawn there;
            and by path, the lines that cameras track.
        """
        sensor = poses[:, :3, 3]
        states = [f"{paths.WORLD}/{self._info.name}/**", f"{self._info.name}/**"]
        drawn_boxes = [paths.FAILURES, paths.CLUSTERS]
        scan = [paths.SCAN, paths.SCAN_ROWS, paths.SENSOR]
        contents = [*scan, *drawn_boxes, *map(paths.names, drawn_boxes), *states]
        rows = drawn.rows_of(self._sink.written(contents), {case.frame for case in self._cases})
        self._styles(flat)
        asked = [points_of(case, scan_of(rows, case.frame), members) for case in self._cases]
        ledgers = repeat(
            [(case.frame, points) for case, points in zip(self._cases, asked, strict=True)]
        )
        room = stored_ledgers.MOST_BYTES
        deciding = []
        for case, found in zip(self._cases, ledgers, strict=True):
            self._sink.at_case(case.number)
            here = {
                path: row
                for (path, frame), row in rows.items()
                if frame == case.frame and path != paths.SCAN_ROWS
            }
            deciding.append(self._deciding(here, case))
            self._outline(case.label, case.outcome, case.low, case.high, sensor[case.frame])
            self._rays(rays.rays_of(found, rays.STRIPS))
            self._lanes(case)
            evidence = f"- **Evidence**: {evidence_text(found, case.failure)}\n" if found else ""
            self._text(f"{case.text}\n{evidence}{see(self._info, deciding[-1])}\n{HOW}")
            packed = stored_ledgers.pack(found)
            if (room := room - len(packed)) >= 0:
                self._sink.log(paths.CASE_LEDGERS, stored_ledgers.component(packed))
            self._sink.chunks(
                drawn.at_case(path, case.number, near(path, row, (case.low + case.high) / 2))
                for path, row in here.items()
                if case.number <= self._shown_until(path)
            )
            self._mark(flat, case, poses[case.frame])
            for path in {path for path, _ in rows if path != paths.SCAN_ROWS}:
                if case.number == self._shown_until(path) + 1:
                    # or the picture of an earlier case would remain
                    self._sink.log(path, rr.Clear(recursive=False))
        self._by_frame(poses, boxes, flat)
        return deciding[0], _tracked(
            self._cases[0].low, self._cases[0].high, sensor[self._cases[0].frame]
        )

    def _shown_until(self, path: str) -> int:
        """The last case with what is drawn at a path."""
        if path.startswith(f"{paths.WORLD}/"):
            return len(self._cases)
        further = {paths.state(self._info.name, each) for each in self._info.emits if each.at_cases}
        return FURTHER if path in further else PICTURES

    def _deciding(self, here: dict[str, drawn.Row], case: ShownCase) -> str | None:
        """The name of the state with the largest share of its points or voxels in a case."""
        names = {paths.state(self._info.name, state): state.name for state in self._info.emits}
        path = drawn.deciding(here, list(names), case.low, case.high)
        return None if path is None else names[path]

    def _outline(self, label: str, outcome: Outcome, low: F64, high: F64, sensor: F64) -> None:
        box = rr.Boxes3D.from_fields(
            centers=[(low + high) / 2],
            half_sizes=[(high - low) / 2],
            labels=[label],
            colors=[colours.BRIGHT[outcome]],
        )
        self._sink.log(paths.CASE_BOX, box)
        self._sink.log(
            paths.CASE_NAME,
            rr.Points3D.from_fields(positions=above(low[None], high[None]), labels=[label]),
        )
        for path, lines in _tracked(low, high, sensor).items():
            self._sink.log(path, rr.LineStrips3D.from_fields(strips=lines))

    def _styles(self, flat: FlatStates) -> None:
        """What is the same for all cases."""
        log = self._sink.log
        lines = rr.LineStrips3D.from_fields
        box = rr.Boxes3D.from_fields(radii=EDGES, fill_mode=WIRES, show_labels=False)
        log(paths.CASE_BOX, box, static=True)
        log(paths.CASE_NAME, NAME_STYLE, static=True)
        log(paths.CASE_AROUND, lines(colors=[90, 90, 100], radii=THIN), static=True)
        log(paths.CASE_AIM, lines(colors=[70, 70, 80], radii=THIN), static=True)
        legend = [(kind, name, (*colours.RAYS[kind], OPACITY)) for kind, name in rays.NAMES.items()]
        log(paths.RAY_CLASSES, rr.AnnotationContext(legend), static=True)
        log(paths.CASE_RAYS, lines(radii=RAYS), static=True)
        for path in flat.paths:
            log(paths.in_state(path), outlines.STYLE, static=True)

    def _rays(self, touching: rays.TouchingRays) -> None:
        kinds = touching.kinds.astype(np.uint16)
        self._sink.log(
            paths.CASE_RAYS, rr.LineStrips3D.from_fields(strips=touching.strips, class_ids=kinds)
        )

    def _lanes(self, case: ShownCase) -> None:
        """The object or place of a case over time; on the timeline of frames."""
        if case.number > object_lanes.MOST or not case.spans:
            return
        parts = {name: lane(case.spans, name) for name in LANES}
        ghost = case.outcome == Outcome.FALSE_NEGATIVE
        name = self._names[case.number - 1]
        for path, style, frames, states in object_lanes.lanes(name, ghost, parts):
            self._sink.log(path, style, static=True)
            self._sink.columns(path, frames, [None], states)

    def _text(self, text: str) -> None:
        self._sink.log(paths.CASE_TEXT, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))

    def _mark(self, flat: FlatStates, case: ShownCase, T_world_sensor: F64) -> None:
        """Outline a case in the pictures that it shows."""
        for path in flat.paths:
            last = self._shown_until(path)
            if case.number > last + 1:
                continue
            mark: Any = rr.Clear(recursive=False)
            if case.number <= last:
                outline = flat.outline(path, case.low, case.high, T_world_sensor)
                if outline is not None:
                    mark = outlines.drawn(outline, case.outcome)
            self._sink.log(paths.in_state(path), mark)

    def _by_frame(self, poses: F64, boxes: FrameBoxes, flat: FlatStates) -> None:
        """Show in each frame the costliest of its cases."""
        sensor = poses[:, :3, 3]
        each = [case.cost_of_point for case in self._cases]
        shown = np.flatnonzero(boxes.case < len(self._cases))
        of = boxes.case[shown]
        cost = np.zeros(len(shown)) if boxes.points is None else np.array(each)[of]
        if boxes.points is not None:
            cost *= boxes.points[shown]
        rows = shown[np.lexsort((of, -cost, boxes.frames[shown]))]
        frames, first = np.unique(boxes.frames[rows], return_index=True)
        rows = rows[first]
        cases = [self._cases[case] for case in boxes.case[rows]]
        low = boxes.box_low[rows].astype(np.float64)
        high = boxes.box_high[rows].astype(np.float64)
        middle = (low + high) / 2
        size = high - low
        box = rr.Boxes3D.columns(
            centers=middle, half_sizes=size / 2, labels=[case.label for case in cases],
            colors=[colours.BRIGHT[case.outcome] for case in cases],
        )  # fmt: skip
        names = rr.Points3D.columns(
            positions=above(low, high), labels=[case.label for case in cases]
        )
        aims = rr.LineStrips3D.columns(strips=_aims(sensor[frames], middle))
        self._sink.columns(paths.CASE_BOX, frames.tolist(), [None], box)
        self._sink.columns(paths.CASE_NAME, frames.tolist(), [None], names)
        self._sink.columns(
            paths.CASE_AROUND,
            frames.tolist(),
            [None],
            rr.LineStrips3D.columns(strips=circles(low, high)),
        )
        self._sink.columns(
            paths.CASE_AIM, frames.tolist(), [None], aims.partition([AIM_LINES] * len(frames))
        )
        boxes_of = list(zip(frames.tolist(), low, high, strict=True))
        for path in flat.paths:
            found = [flat.outline(path, low, high, poses[frame]) for frame, low, high in boxes_of]
            self._marks_by_frame(path, frames, cases, found)
        last = None
        for frame, case in zip(frames.tolist(), cases, strict=True):
            if case is not last:
                self._sink.at(frame, None)
                self._text(f"{case.text}\n\n{HOW}")
                last = case

    def _marks_by_frame(
        self, path: str, frames: I64, cases: Sequence[ShownCase], found: Sequence[F32 | None]
    ) -> None:
        """Outline cases in a picture, each in its frame; out of view none."""
        columns = rr.LineStrips2D.columns(
            strips=[outline for outline in found if outline is not None],
            colors=[
                colours.BRIGHT[case.outcome]
                for case, outline in zip(cases, found, strict=True)
                if outline is not None
            ],
        )
        counts = [int(outline is not None) for outline in found]
        if any(counts):
            self._sink.columns(
                paths.in_state(path), frames.tolist(), [None], columns.partition(counts)
            )


def object_of(case: ShownCase) -> str:
    """The object or place of a case: ``van 9``, ``ground``."""
    failure = case.failure
    if failure is None:
        return case.title
    number = "" if failure.instance is None else str(failure.instance)
    return failure.what if number in failure.what else f"{failure.what} {number}"


def see(info: MethodInfo, state: str | None) -> str:
    """Which state of a method shows a case, as Markdown; empty if the method has none."""
    meaning = {known.name: known.meaning for known in info.emits}
    if state is not None:
        return f"- **State**: the tab *{state}* shows this place: {meaning[state]}.\n"
    if any(issubclass(known.kind, paths.FLAT) for known in info.emits):
        return "- **State**: pictures of what the method saw, in the tabs next to the frame.\n"
    none = (
        "- **State**: none was recorded here, because it is too far from the sensor or nothing was "
        "found.\n"
    )
    return none if meaning else ""


def _tracked(low: F64, high: F64, sensor: F64) -> dict[str, F32]:
    """The lines of a case that cameras track, by path."""
    aim = _aims(sensor[None], (low + high)[None] / 2)
    return {paths.CASE_AROUND: circles(low[None], high[None]), paths.CASE_AIM: aim}


def circles(low: F64, high: F64) -> F32:
    """(N, 73, 3): a circle on the ground around each box."""
    centre = np.concatenate([(low + high)[:, :2] / 2, low[:, 2:]], 1)
    circles: F32 = (centre[:, None] + _radius(low, high)[:, None, None] * CIRCLE).astype(np.float32)
    return circles


def above(low: F64, high: F64) -> F32:
    """(N, 3): the place of the label of each box."""
    places = np.concatenate([(low + high)[:, :2] / 2, high[:, 2:]], 1)
    places[:, 2] += LIFT * _radius(low, high)
    return places.astype(np.float32)


def _radius(low: F64, high: F64) -> F64:
    """(N,) metres, of the circle around each box."""
    radius: F64 = np.clip(0.8 * np.linalg.norm((high - low)[:, :2], axis=1), *AROUND)
    return radius


def _aims(sensor: F64, middle: F64) -> F32:
    """(3 N, 2, 3): a line from the sensor to each case, and two specks that keep an eye that tracks
    them away.
    """
    centre = (sensor + middle) / 2
    reach = np.array([BACK, BACK, 0.0])
    specks = [np.stack([end, end + 0.01], 1) for end in (centre - reach, centre + reach)]
    lines: F32 = (
        np.stack([np.stack([sensor, middle], 1), *specks], 1).astype(np.float32).reshape(-1, 2, 3)
    )
    return lines


def scan_of(rows: Mapping[tuple[str, int], drawn.Row], frame: int) -> drawn.Row | None:
    """The points of a frame, with their rows in its scan."""
    points = rows.get((paths.SCAN, frame))
    return None if points is None else {**rows.get((paths.SCAN_ROWS, frame), {}), **points}


def points_of(case: ShownCase, scan: drawn.Row | None, members: Members) -> list[int]:
    """Rows in the scan of a case's worst frame.

    Its middle point, and others that are spread over it.
    """
    if scan is None or (xyz := drawn.positions(scan)) is None or not len(xyz):
        return []
    inside = ((xyz >= case.low - 0.01) & (xyz <= case.high + 0.01)).all(1)
    mine = np.flatnonzero(
        inside & (classes.outcomes(drawn.values(scan, "Points3D:class_ids")) == case.outcome)
    )
    if not len(mine):
        return []
    rows = (
        drawn.values(scan, "dynaviz.Scan:point").astype(np.int64)
        if "dynaviz.Scan:point" in scan
        else np.arange(len(xyz))
    )
    of_case = members(case, rows[mine], xyz[mine])
    mine = mine[of_case] if of_case.any() else mine  # other points may stand for its own
    middle = mine[middle_of(xyz[mine])]
    _, first = np.unique(np.floor(xyz[mine] / APART), axis=0, return_index=True)
    mine = mine[np.sort(first)]
    mine = np.union1d(mine[rays.evenly(len(mine), POINTS_ASKED - 1)], middle)
    chosen: list[int] = rows[mine].tolist()
    return chosen


def near(path: str, row: drawn.Row, middle: F64) -> drawn.Row:
    """The part of an entity near a case."""
    xyz = drawn.positions(row)
    if xyz is None:
        return row
    reach = SCENE if path == paths.SCAN else NEAR
    chosen: I64 = np.flatnonzero(((xyz - middle) ** 2).sum(1) < reach**2)
    return row if len(chosen) == len(xyz) else drawn.only(row, chosen)
