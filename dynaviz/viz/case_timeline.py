"""The timeline ``case``: an arrow key flies from case to case, each shown as in its worst frame.

At the index of a case: its box, the scan and the states as they were drawn in its worst frame, the rays that touched
it, and a text. On the timeline of frames, the box and the text are those of the costliest case in the frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr

from dynaviz import colours
from dynaviz.arrays import F32, F64, I64
from dynaviz.method import MethodInfo
from dynaviz.metric import FrameBoxes
from dynaviz.scan import Outcome
from dynaviz.scan import Sequence as Scans
from dynaviz.viz import classes, drawn, paths, witnesses
from dynaviz.viz.cases import ShownCase
from dynaviz.viz.sink import RecordingFile

NEAR = 25.0  # metres from the middle of a case: the part of a state that is shown with it
SCENE = 40.0  # metres: the part of the scan
AROUND = (7.0, 10.0)  # metres: radius of the circle around a case; the eye tracks it, and its size sets the distance
BACK = 11.0  # metres: the same for the frame around the line from the sensor to the case
PICTURES = 8  # cases with range images and polar grids, which cannot be cut to a part
EDGES = rr.Radius.ui_points(1.6)
THIN = rr.Radius.ui_points(0.5)
WIRES = rr.components.FillMode.MajorWireframe  # the content of a box must stay visible
TURN = np.linspace(0.0, 2 * np.pi, 49)
CIRCLE = np.stack([np.cos(TURN), np.sin(TURN), 0 * TURN], 1)
RAY_COLOURS: dict[int, colours.Colour] = {
    witnesses.HIT: (60, 205, 140),
    witnesses.CROSSED: (225, 70, 160),
    witnesses.GRAZED: (120, 75, 120),
}
HOW = "*Arrow keys: next and previous case. To replay the run, choose `frame` in the bar below.*"


class CaseTimeline:
    """Shows cases on their timeline.

    Args:
        sink: where to draw.
        info: of the method.
        cases: at least one.
    """

    def __init__(self, sink: RecordingFile, info: MethodInfo, cases: Sequence[ShownCase]) -> None:
        self._sink, self._info, self._cases = sink, info, cases

    def write_texts(self) -> None:
        """The texts alone, for recordings without coordinates."""
        for case in self._cases:
            self._sink.at_case(case.number)
            self._text(f"{case.text}\n\n{HOW}")

    def write_curves(self, scores: Mapping[str, float | None]) -> None:
        """What each case costs, and the scores if the cases up to each were right, as curves over the cases.

        Args:
            scores: of the run, in percent.
        """
        numbers = [case.number for case in self._cases]
        for name in ("SA", "DA"):
            lost, score = [case.lost.get(name, np.nan) for case in self._cases], scores.get(name)
            if np.isnan(lost).all() or score is None:
                continue
            colour = colours.SCORES[name]
            marks = rr.SeriesPoints(colors=colour, markers="circle", marker_sizes=4, names=f"% of {name} lost")
            line = rr.SeriesLines(colors=colour, widths=1.5, names=f"{name} if fixed")
            fixed = score + np.nancumsum(lost)
            for path, style, values in (
                (f"{paths.CASE_COST}/{name}", marks, lost),
                (f"{paths.CASE_SCORE}/{name}", line, fixed.tolist()),
            ):
                self._sink.log(path, style, static=True)
                self._sink.case_columns(path, numbers, rr.Scalars.columns(scalars=values))

    def draw(self, scans: Scans, sensor: F64, boxes: FrameBoxes) -> str | None:
        """Draw the cases, on both timelines.

        Args:
            scans: the frames of the run.
            sensor: (frames, 3) metres, world frame: its positions.
            boxes: of the cases, by frame.

        Returns:
            The state that shows most about the first case; None if no state was drawn there.

        Raises:
            DataError: for a scan that cannot be read.
        """
        contents = [paths.SCAN, paths.SENSOR, *(f"{paths.WORLD}/{part}/**" for part in (self._info.name,))]
        contents += [paths.FAILURES, paths.CLUSTERS, f"{self._info.name}/**"]
        rows = drawn.rows_of(self._sink.written(contents), {case.frame for case in self._cases})
        places = [_place(case, rows.get((paths.SCAN, case.frame))) for case in self._cases]
        legend = [(kind, name, RAY_COLOURS[kind]) for kind, name in witnesses.NAMES.items()]
        self._sink.log(paths.CASE_RAYS, rr.AnnotationContext(legend), static=True)
        states = []
        for case, place, evidence in zip(self._cases, places, witnesses.find(scans, sensor, places), strict=True):
            self._sink.at_case(case.number)
            here = {path: row for (path, frame), row in rows.items() if frame == case.frame}
            states.append(self._deciding(here, place))
            self._outline(case.label, case.outcome, case.low, case.high, sensor[case.frame])
            self._rays(evidence)
            self._text(f"{case.text}\n- **Evidence**: {evidence.text()}\n{self._see(states[-1])}\n{HOW}")
            self._sink.chunks(
                drawn.at_case(path, case.number, _near(path, row, (case.low + case.high) / 2))
                for path, row in here.items()
                if case.number <= PICTURES or path.startswith(paths.WORLD)
            )
        self._by_frame(sensor, boxes)
        return states[0]

    def _deciding(self, here: dict[str, drawn.Row], place: witnesses.Place) -> str | None:
        """The state with the largest share of its points or voxels at a place; None if none has any."""
        best, most = None, 0.0
        for state in self._info.emits:
            row = here.get(paths.state(self._info.name, state), {})
            if (xyz := drawn.positions(row)) is not None and len(xyz):
                share = float(((xyz >= place.low) & (xyz <= place.high)).all(1).mean())
                if share > most:
                    best, most = state.name, share
        return best

    def _see(self, state: str | None) -> str:
        meaning = {known.name: known.meaning for known in self._info.emits}
        return f"- **State**: the tab *{state}* shows this place: {meaning[state]}.\n" if state else ""

    def _outline(self, label: str, outcome: Outcome, low: F64, high: F64, sensor: F64) -> None:
        middle, size = (low + high) / 2, high - low
        box = rr.Boxes3D(
            centers=[middle], half_sizes=[size / 2], labels=[label], colors=[colours.BRIGHT[outcome]], radii=EDGES,
            fill_mode=WIRES, show_labels=True,
        )  # fmt: skip
        self._sink.log(paths.CASE_BOX, box)
        self._sink.log(paths.CASE_AROUND, rr.LineStrips3D([_circle(low, high)], colors=[90, 90, 100], radii=THIN))
        self._sink.log(paths.CASE_AIM, rr.LineStrips3D(_aim(sensor, middle), colors=[70, 70, 80], radii=THIN))

    def _rays(self, evidence: witnesses.Witnesses) -> None:
        labels = [
            f"frame {frame}: {witnesses.NAMES[kind]}"
            for frame, kind in zip(evidence.frames.tolist(), evidence.kinds.tolist(), strict=True)
        ]
        strips = rr.LineStrips3D(
            evidence.strips, class_ids=evidence.kinds.astype(np.uint16), labels=labels, show_labels=False, radii=THIN
        )
        self._sink.log(paths.CASE_RAYS, strips)

    def _text(self, text: str) -> None:
        self._sink.log(paths.CASE_TEXT, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))

    def _by_frame(self, sensor: F64, boxes: FrameBoxes) -> None:
        """Show in each frame the costliest of its cases."""
        first = np.lexsort((boxes.case, boxes.frames))
        first = first[boxes.case[first] < len(self._cases)]
        frames, at = np.unique(boxes.frames[first], return_index=True)
        last = None
        for frame, row in zip(frames.tolist(), first[at].tolist(), strict=True):
            case = self._cases[boxes.case[row]]
            self._sink.at(frame, None)
            low, high = boxes.box_low[row].astype(np.float64), boxes.box_high[row].astype(np.float64)
            self._outline(case.label, case.outcome, low, high, sensor[frame])
            if case is not last:
                self._text(f"{case.text}\n\n{HOW}")
                last = case


def _circle(low: F64, high: F64) -> F32:
    """A circle on the ground around a box."""
    middle, reach = (low + high) / 2, np.linalg.norm((high - low)[:2])
    circle: F32 = (np.array([*middle[:2], low[2]]) + np.clip(0.8 * reach, *AROUND) * CIRCLE).astype(np.float32)
    return circle


def _aim(sensor: F64, middle: F64) -> list[F64]:
    """A line from the sensor to a case, and two specks that keep an eye that tracks them at a distance."""
    centre, reach = (sensor + middle) / 2, np.array([BACK, BACK, 0.0])
    return [np.array([sensor, middle]), *(np.array([end, end + 0.01]) for end in (centre - reach, centre + reach))]


def _place(case: ShownCase, scan: drawn.Row | None) -> witnesses.Place:
    """Where to look for evidence: the middle of the case's points in its worst frame."""
    if scan is not None and (xyz := drawn.positions(scan)) is not None:
        inside = (xyz >= case.low - 0.01) & (xyz <= case.high + 0.01)
        mine = inside.all(1) & (classes.outcomes(drawn.values(scan, "Points3D:class_ids")) == case.outcome)
        if mine.any():
            return witnesses.Place.of(xyz[mine].astype(np.float32))
    corners: F32 = np.array([case.low, case.high], np.float32)
    return witnesses.Place.of(corners.mean(0, keepdims=True))


def _near(path: str, row: drawn.Row, middle: F64) -> drawn.Row:
    """The part of an entity near a case."""
    xyz = drawn.positions(row)
    if xyz is None:
        return row
    reach = SCENE if path == paths.SCAN else NEAR
    chosen: I64 = np.flatnonzero(((xyz - middle) ** 2).sum(1) < reach**2)
    return row if len(chosen) == len(xyz) else drawn.only(row, chosen)
