"""The timeline ``case`` of a comparison.

Places where one run is right and the other wrong, costliest first.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
import rerun as rr

from dynaviz import colours
from dynaviz.arrays import F64
from dynaviz.contracts import registry
from dynaviz.contracts.method import MethodInfo
from dynaviz.contracts.metric import FrameBoxes, Labelled
from dynaviz.contracts.scan import Label, Outcome, Scan
from dynaviz.errors import PluginError, UsageError
from dynaviz.scores.comparison.frame_answers import FrameAnswers
from dynaviz.scores.failure_case import FailureCase
from dynaviz.scores.sections import Sections
from dynaviz.views import cases, drawn, keys, paths
from dynaviz.views.compare.compare_layout import (
    CASE_AROUND,
    CASE_BOX,
    CASE_KEY,
    CASE_STATES,
    CASE_TEXT,
    GAIN,
)
from dynaviz.views.read.reader import DrawnPoints, RunRecording
from dynaviz.views.record.case_timeline import HOW, above, circles, near
from dynaviz.views.record.scene import EDGES, NAME_STYLE, WIRES

LETTERS = "AB"
COPIED = (paths.SCAN, paths.SENSOR)
SHARED = 0.5  # of its area, by which a difference without an object is of a run's own case
AROUND = 0.01  # metres around the box of a case, whose corners are rounded


@dataclass(frozen=True, slots=True, eq=False)
class Difference:
    """A failure case of one run where the other run is right.

    Attributes:
        wrong: which run is wrong, 0 or 1.
        case: computed from the points that only this run got wrong.
        outcome: of these points.
        low, high: (3,) float64, metres, world frame: its box in its worst frame.
    """

    wrong: int
    case: FailureCase
    outcome: Outcome
    low: F64
    high: F64

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        return f"only {LETTERS[self.wrong]} {cases.DID[self.case.kind]} {self.case.what}"


def find(runs: tuple[RunRecording, RunRecording]) -> list[Difference]:
    """The costliest differences between two runs with ground truth and coordinates, at most
    ``cases.LISTED``.
    """
    found = [
        difference
        for wrong in (0, 1)
        for difference in _of_run(runs[wrong], runs[1 - wrong], wrong)
    ]
    found.sort(key=lambda difference: -difference.case.cost)
    return [d for d in found[: cases.LISTED] if d.case.cost >= cases.WORTH * found[0].case.cost]


def _of_run(run: RunRecording, other: RunRecording, wrong: int) -> Iterator[Difference]:
    p = run.properties
    metric = registry.load("metrics", "failures")(
        MethodInfo(p["method"], p["title"], "", run.reasons)
    )
    positions = {
        frame: parts["Transform3D:translation"][0] for frame, parts in run.rows(paths.SENSOR)
    }
    known = run.result.failures if run.result else ()
    objects = _Objects(run, known)
    for points, mine, others in zip(run.drawn(), run.answers(), other.answers(), strict=True):
        static, dynamic = (
            int((mine.truth == label).sum()) for label in (Label.STATIC, Label.DYNAMIC)
        )
        alone = _wrong_alone(points, mine, others, positions[points.frame])
        metric.add(objects.numbered(alone), static, dynamic)
    section = Sections.of(metric.finish()).failures
    boxes = metric.figures().get(cases.FAILURES)
    found = section.cases[: cases.LISTED] if section else ()
    for i, case in enumerate(found):
        assert isinstance(boxes, FrameBoxes)
        row = np.flatnonzero((boxes.case == i) & (boxes.frames == case.worst_frame))
        low, high = (
            (boxes.box_low[row[0]], boxes.box_high[row[0]]) if len(row) else (case.low, case.high)
        )
        corners = np.asarray(low, np.float64), np.asarray(high, np.float64)
        named = _named(case, objects.owner(case, *corners))
        yield Difference(wrong, named, Outcome(boxes.outcomes[i]), *corners)


class _Objects:
    """Which points are of the objects of the run's own cases, by their boxes in each frame.

    Earlier recordings do not say which case a box is of; their objects have no names.

    Args:
        run: the recording.
        known: its cases.
    """

    def __init__(self, run: RunRecording, known: Sequence[FailureCase]) -> None:
        self._known = known
        name = f"{paths.CASE_NUMBERS}:number"
        self._boxes = {
            frame: (row[name], row["Boxes3D:centers"], row["Boxes3D:half_sizes"])
            for frame, row in run.rows(paths.FAILURES)
            if name in row
        }

    def numbered(self, labelled: Labelled) -> Labelled:
        """The points, those of an object with the number of its costliest case."""
        scan = labelled.scan
        instances = np.zeros(len(scan), np.int32)
        boxes = self._boxes.get(labelled.frame, ((), (), ()))
        for number, middle, half in reversed(list(zip(*boxes, strict=True))):
            if self._known[number - 1].instance is not None:
                inside = (np.abs(scan.points - middle) <= half + AROUND).all(1)
                instances[inside & (scan.labels == Label.DYNAMIC)] = _first(self._known, number)
        numbered = dataclasses.replace(scan, instances=instances)
        return dataclasses.replace(labelled, scan=numbered)

    def owner(self, case: FailureCase, low: F64, high: F64) -> FailureCase | None:
        """The own case that a difference is of; None if none is known.

        Args:
            case: the difference; the number of its object is that of a case.
            low, high: (3,) metres: its box in its worst frame.
        """
        if case.instance is not None:
            return self._known[case.instance - 1]
        best = None
        most = SHARED * float(np.prod(high[:2] - low[:2] + AROUND))
        for number, middle, half in zip(*self._boxes.get(case.worst_frame, ((),) * 3), strict=True):
            own = self._known[number - 1]
            shared = np.minimum(high, middle + half) - np.maximum(low, middle - half) + AROUND
            area = float(np.prod(shared[:2])) if (shared > 0).all() else 0.0
            if own.kind == case.kind and area > most:
                best = own
                most = area
        return best


def _first(known: Sequence[FailureCase], number: int) -> int:
    """The number of the costliest case of the same object."""
    case = known[number - 1]
    own = (case.kind, case.class_, case.instance)
    numbers = enumerate(known, 1)
    return next(k for k, each in numbers if (each.kind, each.class_, each.instance) == own)


def _named(case: FailureCase, own: FailureCase | None) -> FailureCase:
    """A difference with the name, number, behaviour and cause of the run's own case."""
    if own is None:
        return case
    written = case.what if case.instance is None else f"{case.what} {case.instance}"
    named = own.instance is None or str(own.instance) in own.what
    what = own.what if named else f"{own.what} {own.instance}"
    return msgspec.structs.replace(
        case,
        class_=own.class_,
        instance=own.instance,
        what=what,
        behaviour=own.behaviour,
        cause=own.cause,
        sentence=case.sentence.replace(written, what, 1),
    )


def _wrong_alone(
    points: DrawnPoints, mine: FrameAnswers, others: FrameAnswers, position: F64
) -> Labelled:
    """A frame's dynamic points and those that only this run got wrong.

    Where both are wrong, as if it were right.
    """
    truth = mine.truth == Label.DYNAMIC
    labelled = mine.truth != Label.UNLABELLED
    alone = labelled & (mine.dynamic != truth) & (others.dynamic == truth)
    chosen = np.flatnonzero(((truth & labelled) | alone)[points.point])
    chosen = np.repeat(chosen, points.stands_for[chosen])
    rows = points.point[chosen]
    T_world_sensor = np.eye(4)
    T_world_sensor[:3, 3] = position
    scan = Scan(mine.index, points.xyz[chosen], T_world_sensor, labels=mine.truth[rows])
    answer = np.where(alone, mine.dynamic, truth)
    return Labelled.of(points.frame, scan, answer[rows], mine.reasons[rows])


def write(
    stream: rr.RecordingStream,
    sides: Sequence[str],
    runs: tuple[RunRecording, RunRecording],
    found: list[Difference],
) -> None:
    """Show each difference at its index.

    Its box, both runs' points and the state that shows most, and a text.

    Args:
        stream: the recording of the comparison.
        sides: roots of the runs.
        runs: the runs.
        found: the differences.
    """
    _style(stream)
    texts = _texts(runs, found)
    for number, difference in enumerate(found, 1):
        stream.reset_time()
        stream.set_time(paths.CASE, sequence=number)
        low = difference.low
        high = difference.high
        colour = colours.BRIGHT[difference.outcome]
        centre = [(low + high) / 2]
        half = [(high - low) / 2]
        name = f"{number} {difference.title}"
        stream.log(
            CASE_BOX,
            rr.Boxes3D.from_fields(centers=centre, half_sizes=half, labels=[name], colors=[colour]),
        )
        stream.log(
            paths.names(CASE_BOX),
            rr.Points3D.from_fields(positions=above(low[None], high[None]), labels=[name]),
        )
        stream.log(CASE_AROUND, rr.LineStrips3D.from_fields(strips=circles(low[None], high[None])))
        title = (
            f"#### {number} of {len(found)}: {difference.title}, {difference.case.cost:.2f} % of"
        )
        text = f"{title} {difference.case.metric}\n\n{texts[number - 1]}\n\n{HOW}"
        stream.log(CASE_TEXT, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))
    _write_curves(stream, sides, runs, found)
    for root, run in zip(sides, runs, strict=True):
        _copy(stream, root, run, found)


def _write_curves(
    stream: rr.RecordingStream,
    sides: Sequence[str],
    runs: tuple[RunRecording, RunRecording],
    found: list[Difference],
) -> None:
    """What each difference costs the run that is wrong, and its scores if this one and all before
    it were fixed.
    """
    numbers = rr.TimeColumn(paths.CASE, sequence=np.arange(1, len(found) + 1))
    for i, (root, run, sign) in enumerate(zip(sides, runs, (-1, 1), strict=True)):
        gain = [sign * difference.case.cost * (difference.wrong != i) for difference in found]
        stream.send_columns(
            f"{GAIN}/{root}", indexes=[numbers], columns=rr.Scalars.columns(scalars=gain)
        )
        for name in ("SA", "DA"):
            score = run.result.metrics.get(name) if run.result else None
            if score is not None:
                lost = [d.case.cost * (d.wrong == i and d.case.metric == name) for d in found]
                path = f"{root}/{paths.SCORES}/{name}/so_far"
                fixed = score + np.cumsum(lost)
                stream.send_columns(
                    path, indexes=[numbers], columns=rr.Scalars.columns(scalars=fixed)
                )


def _style(stream: rr.RecordingStream) -> None:
    """What is the same for all differences."""
    stream.log(
        CASE_BOX,
        rr.Boxes3D.from_fields(radii=EDGES, fill_mode=WIRES, show_labels=False),
        static=True,
    )
    stream.log(paths.names(CASE_BOX), NAME_STYLE, static=True)
    thin = rr.LineStrips3D.from_fields(colors=[90, 90, 100], radii=rr.Radius.ui_points(0.5))
    stream.log(CASE_AROUND, thin, static=True)


def _copy(
    stream: rr.RecordingStream, root: str, run: RunRecording, found: Sequence[Difference]
) -> None:
    """What a run drew near each difference.

    Its points, and the state with the largest share of its points there.
    """
    prefix = f"{paths.WORLD}/{run.properties['method']}/"
    names = {path: path.removeprefix(prefix) for path in run.entities() if path.startswith(prefix)}
    targets = {path: f"{root}/{CASE_STATES}/{name}" for path, name in names.items()}
    with run.decoding():
        legends = run.store.stream().filter(content=[f"/{path}" for path in names], is_static=True)
        for chunk in legends:
            target = targets[str(chunk.entity_path).removeprefix("/")]
            rr.send_chunks([chunk.with_entity_path(f"/{target}")], recording=stream)
        content = [f"/{path}" for path in (*COPIED, *names)]
        chunks = run.store.stream().filter(content=content, has_timeline=paths.FRAME)
        rows = drawn.rows_of(chunks, {difference.case.worst_frame for difference in found})
    targets |= {path: f"{root}/{path}" for path in COPIED}
    drawn_keys = _keys(run)
    for number, difference in enumerate(found, 1):
        here = {
            path: row for (path, frame), row in rows.items() if frame == difference.case.worst_frame
        }
        shown = drawn.deciding(here, names, difference.low, difference.high)
        middle = (difference.low + difference.high) / 2
        stream.reset_time()
        stream.set_time(paths.CASE, sequence=number)
        for path in names:
            if path != shown:  # or the state of an earlier case would remain
                stream.log(targets[path], rr.Clear(recursive=False))
        stream.log(f"{root}/{CASE_KEY}", drawn_keys.get(shown or "", rr.Clear(recursive=False)))
        chosen = [path for path in (*COPIED, shown) if path in here]
        copies = [
            drawn.at_case(targets[path], number, near(path, here[path], middle)) for path in chosen
        ]
        rr.send_chunks(copies, recording=stream)


def _keys(run: RunRecording) -> dict[str, rr.EncodedImage]:
    """What the colours of each state mean, by its path; none if the method cannot be loaded."""
    method = run.properties["method"]
    try:
        tabs = keys.tabs(registry.load("methods", method).info)
    except (UsageError, PluginError):
        return {}
    strips = {states: keys.strip(states, run.parameters) for states in tabs}
    return {
        paths.state(method, state): drawn_key
        for states, drawn_key in strips.items()
        for state in states
    }


def _texts(runs: tuple[RunRecording, RunRecording], found: Sequence[Difference]) -> list[str]:
    """What each difference is, and the reasons of both runs there."""
    reasons: dict[int, list[str]] = {}
    frames = zip(
        runs[0].drawn(), runs[1].drawn(), runs[0].answers(), runs[1].answers(), strict=True
    )
    for drawn_points, *answers in ((frame[:2], *frame[2:]) for frame in frames):
        for i, difference in enumerate(found):
            points = drawn_points[difference.wrong]
            if points.frame == difference.case.worst_frame:
                inside = (points.xyz >= difference.low - 0.01) & (
                    points.xyz <= difference.high + 0.01
                )
                mine = points.point[inside.all(1) & (points.outcome == difference.outcome)]
                reasons[i] = [
                    _shares(run, part.reasons[mine])
                    for run, part in zip(runs, answers, strict=True)
                ]
    return [_text(difference, reasons.get(i, ["", ""])) for i, difference in enumerate(found)]


def _shares(run: RunRecording, codes: Iterable[int]) -> str:
    names = [reason.name for reason in run.reasons]
    counts = np.bincount(
        np.minimum(np.asarray(codes, np.intp), len(names)), minlength=len(names) + 1
    )
    order = np.argsort(-counts, kind="stable")
    return cases.shares(
        {[*names, "unknown code"][code]: int(counts[code]) for code in order if counts[code]}
    )


def _text(difference: Difference, reasons: Sequence[str]) -> str:
    case = difference.case
    span = f"{difference.case.first_frame} to {difference.case.last_frame}"
    lines = [
        f"- **{LETTERS[i]} {'wrong' if i == difference.wrong else 'right'}**: {reasons[i]}"
        for i in (0, 1)
        if reasons[i]
    ]
    return "\n".join(
        [case.sentence, "", *lines, f"- **Worst frame**: {case.worst_frame} of {span}"]
    )
