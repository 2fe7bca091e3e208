"""Recorder: writes the recording of a run, frame by frame."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, get_args

import msgspec
import numpy as np
import rerun as rr

from dynaviz import colours
from dynaviz.arrays import F32, F64, I64, Bool, Intp
from dynaviz.contracts.evidence import Asked
from dynaviz.contracts.metric import Figure, FrameHistograms, Labelled
from dynaviz.contracts.options import RecordMode
from dynaviz.contracts.probe import PolarGrid, State, Text, Value
from dynaviz.contracts.scan import ERRORS, Scan
from dynaviz.engine.loop import Listener, RunSpec
from dynaviz.errors import PluginError, UsageError
from dynaviz.explain.dial import PointSample
from dynaviz.explain.judging import Judgeable, accepts, numbers_of, parameters_of
from dynaviz.explain.point_ledger import PointLedger
from dynaviz.explain.repeat import repeat
from dynaviz.explain.sample import Draw, Drawn, Witnesses, enters
from dynaviz.io.atomic import sha256
from dynaviz.scores.case_points import CasePoints
from dynaviz.scores.comparison import frame_answers
from dynaviz.scores.result import Result, environment
from dynaviz.sources.summary import SequenceSummary
from dynaviz.views import cases, classes, keys, paths, stored_points, viewer
from dynaviz.views.background import Background
from dynaviz.views.curves import WRONG_POINTS, Curves
from dynaviz.views.layout import Findings, layout
from dynaviz.views.record import case_table, sink, states, turns
from dynaviz.views.record.budget import Budget
from dynaviz.views.record.case_timeline import CaseTimeline
from dynaviz.views.record.outlines import FlatStates
from dynaviz.views.record.quota import Quota
from dynaviz.views.record.report import OutcomeCounts, before, failure_list, removed, report
from dynaviz.views.record.scene import MapDrawing

STATE_POINTS = 16_000  # per frame in ``errors`` mode, shared by all states with coordinates
STATES_PENDING = 0.5  # seconds between writes of states to the file


class Recorder(Listener):
    """Writes the recording of a run; a listener of the run and the probe of its method.

    ``with Recorder("run.rrd") as recorder: execute(run, listeners=[recorder], probe=recorder)``.
    The file appears when the run finishes. If the run ends early, ``.run.rrd.part`` in the same
    folder contains every frame so far; if it is killed, all but the last labelled frame and the
    states of the last half second.

    Args:
        path: the recording.
        mode: ``errors`` draws wrong and dynamic points, ``full`` every point, ``scores`` none. All
            modes store the label, ground truth and reason of every point.
        live: open a viewer that follows the run; it may be closed at any time.
        budget: bytes of the file, about; states are left out first, then drawn points. Labels,
            ground truth and reasons are always stored. None for any size.
        rows: of a scan of the run, (K,) the points that the recorder is given; None for all.

    Raises:
        UsageError: for an unknown mode, or ``live`` without a screen.
        DataError: if the folder cannot be written.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        mode: RecordMode = "errors",
        live: bool = False,
        budget: int | None = None,
        rows: Callable[[Scan], Intp] | None = None,
    ):
        if mode not in get_args(RecordMode):
            raise UsageError(f"--record {mode}: choose from {', '.join(get_args(RecordMode))}")
        self.path = Path(path)
        self.mode = mode
        self._port = viewer.open_window() if live else None
        self._sink: sink.RecordingFile | None = None
        self._states: dict[str, State] = {}
        self._queue: list[tuple[State, Value]] = []
        self._heading = keys.Heading()
        self._guided = set[str]()
        self._outcomes = OutcomeCounts()
        self._budget = budget
        self._quota = Quota(budget, 0, 0)
        self._rows = rows
        # Without states, the runtime of the method is reported as honest, so nothing else may run
        # next to it.
        self._background = Background(inline=mode == "scores")
        self._draw: Draw | None = None
        self._sample: PointSample | None = None

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        self._background.close()
        if self._sink is not None:
            self._curves.write()
            self._sink.close()
            if error is not None:
                error.add_note(
                    f"Salvage what was recorded with: dynaviz info {sink.part_of(self.path)}"
                )

    def sha256(self) -> str:
        """Digest of the finished recording."""
        return sha256(self.path)

    def wants(self, name: str) -> bool:
        """Declared states, unless the mode is ``scores``."""
        return self.mode != "scores" and (self._sink is None or name in self._states)

    def emit(self, name: str, value: Value) -> None:
        """Keep a reference; the state is drawn after the method returns, outside of its measured
        time.
        """
        if name in self._states:
            self._queue.append((self._states[name], value))

    def begin(self, run: RunSpec, summary: SequenceSummary) -> None:
        """Open the file and write the properties of the run."""
        info = run.labeller.info
        self._info = info
        self._run = run
        self._summary = summary
        drawn = self.mode != "scores"
        self._poses: list[F64] = []
        self._flat = FlatStates()
        self._given = numbers_of(dataclasses.asdict(run.params))
        self._quota = Quota(
            self._budget, summary.points, summary.frames, run.method is not None and not run.online
        )
        self._states = {state.name: state for state in info.emits} if drawn else {}
        solid = sum(issubclass(state.kind, paths.SOLID) for state in info.emits)
        self._most = None if self.mode == "full" else STATE_POINTS // max(solid, 1)
        name = run.sequence.name
        blueprint = layout(info, summary.extent, drawn, Findings(run.sequence.has_labels))
        self._sink = sink.RecordingFile(
            self.path,
            f"dynaviz {info.name} {name}",
            f"{info.title} on {name}",
            blueprint,
            self._port,
        )
        self._curves = Curves(self._sink)
        self._scene = (
            MapDrawing(self._sink, summary.extent, len(info.reasons), self.mode == "full")
            if drawn
            else None
        )
        params = dataclasses.asdict(run.params)
        self._sink.properties(**self._facts(run, summary, params), complete=False)
        self._write_legends()
        self._report(before(info, name, params, self.mode))
        self._sink.at(0, None)
        self._say(f"{info.title} on {name}: {summary.frames} frames, {summary.points:,} points")
        self._sink.flush()

    def observing(self, frame: int, scan: Scan) -> None:
        """Remember the scan of the next states."""
        self._scan = scan

    def observed(self, frame: int) -> None:
        """Draw the states emitted by ``observe``, in the background."""
        self._open_draw(frame, self._scan)
        if self._queue:
            self._background.run(self._write_states, frame, self._scan, self._taken())

    def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
        """Draw the states emitted by ``label``, and write the rest of the frame, in
        the background.
        """
        self._stamp_ns = labelled.scan.stamp_ns
        self._poses.append(labelled.scan.T_world_sensor)
        # The method may use its arrays again for the next scan.
        kept = dataclasses.replace(
            labelled, dynamic=labelled.dynamic.copy(), reasons=labelled.reasons.copy()
        )
        self._open_draw(labelled.frame, labelled.scan)
        self._background.run(self._write_frame, kept, dict(curves), self._taken())

    def _open_draw(self, frame: int, scan: Scan) -> None:
        """Have points drawn if they can be judged again with other parameters.

        Called right after the first scan was observed, and right after it was labelled.
        """
        known = self._run.sequence.has_labels and self._rows is None and self._scene is not None
        if frame or not known or self._draw is not None:
            return
        one = Asked(scan.without_truth(), np.arange(min(len(scan), 1)), 0)
        if enters(self._run.labeller, one, self._given):
            self._draw = Draw(self._summary.frames)

    def _taken(self) -> list[tuple[State, Value]]:
        """The queued states, with copies of their arrays, because the method may change them during
        the drawing.
        """
        queue = [(state, _copied(value)) for state, value in self._queue]
        self._queue.clear()
        return queue

    def _write_states(self, frame: int, scan: Scan, queue: list[tuple[State, Value]]) -> None:
        self._open.at(frame, scan.stamp_ns)
        if self._quota.states(self._open.size, frame):
            self._draw_states(queue, scan)
        self._open.flush(STATES_PENDING if self._budget is None else 0.0)

    def _write_frame(
        self, labelled: Labelled, curves: Mapping[str, float], queue: list[tuple[State, Value]]
    ) -> None:
        """Write a frame: its states, its points by outcome, the labels of all points, and the
        curves.
        """
        scan = labelled.scan
        self._open.at(labelled.frame, scan.stamp_ns)
        if queue and self._quota.states(self._open.size, labelled.frame, labels=True):
            self._draw_states(queue, scan, scan.points[np.isin(labelled.outcome, cases.WRONG)])
        if self._scene is not None:
            self._scene.pose(scan)
            self._scene.frame(labelled, self._quota.drawing(self._open.size))
        self._quota.answered(len(scan))
        packed = frame_answers.FrameAnswers.of(labelled).packed()
        self._open.log(
            paths.ANSWERS, rr.DynamicArchetype(frame_answers.ARCHETYPE, components=packed)
        )
        if self._draw is not None:
            self._draw.add(labelled)
        wrong = self._outcomes.add(labelled.frame, scan.index, labelled.outcome, labelled.reasons)
        for path, count in self._counts(labelled, wrong):
            self._curves.add(path, labelled.frame, scan.stamp_ns, count)
        for name, value in curves.items():
            self._curves.add(paths.curve(name), labelled.frame, scan.stamp_ns, value)
        self._open.flush()

    def finish(self, result: Result, figures: Mapping[str, Figure]) -> None:
        """Write the map, figures, cases and result, close the file, and give it its final name.

        Raises:
            DataError: if the file cannot be written, or a scan cannot be read again for the
                evidence.
        """
        self._background.wait()
        self._open.at(len(self._poses) - 1, self._stamp_ns)
        self._curves.write()
        if self._scene is not None:
            self._scene.finish()
        shown = {
            cases.FAILURES: len(cases.listed(result)),
            cases.CLUSTERS: len(cases.suspicious(result)),
        }
        for name, figure in figures.items():
            if isinstance(figure, FrameHistograms):
                self._histogram(paths.histogram(name), figure)
            elif self._scene is not None:
                self._scene.boxes(name, figure, shown.get(name, cases.LISTED))
        self._mark_worst()
        found = self._show_cases(result, figures)
        self._report(report(self._info, result, self._outcomes, self.mode))
        self._document(paths.FAILURE_LIST, failure_list(result))
        if not found.truth:
            self._document(paths.REMOVED_TEXT, removed(self._info, result, self._outcomes))
        self._open.layout(layout(self._info, self._summary.extent, self._scene is not None, found))
        self._say(
            "done: "
            + ", ".join(f"{k} {v:.2f} %" for k, v in result.metrics.items() if v is not None)
        )
        self._open.properties(complete=True, result_json=json.dumps(result.to_dict()))
        self._open.finish(self._by_frame(), self._only_at_cases())
        self._sink = None

    def _by_frame(self) -> list[str]:
        """Entities whose content makes up the frames."""
        name = self._info.name
        states = [f"{paths.WORLD}/{name}/**", f"{name}/**"]
        return [paths.SCAN, paths.SCAN_ROWS, paths.SENSOR, paths.ANSWERS, *states]

    def _only_at_cases(self) -> list[str]:
        """The states that a recording of errors shows at cases alone."""
        states = self._states.values() if self.mode == "errors" else ()
        return [paths.state(self._info.name, state) for state in states if state.at_cases]

    def _show_cases(self, result: Result, figures: Mapping[str, Figure]) -> Findings:
        """Write the timeline of cases; returns what the layout needs to know."""
        truth = self._run.sequence.has_labels
        curves = self._outcomes.curves(self._info)
        boxes = cases.boxes_of(result, figures)
        shown = [] if boxes is None else cases.shown(result, boxes)
        if boxes is None or not shown:
            return Findings(truth, reasons=curves)
        timeline = CaseTimeline(self._open, self._info, shown)
        timeline.write_curves(result.metrics)
        case_table.write(self._open, shown)
        if self._scene is None:
            timeline.write_texts()
            return Findings(truth, True, reasons=curves)
        repeat = partial(self._repeat, result.labels)
        if boxes.sample is not None:
            sample = stored_points.component(boxes.sample)
            self._open.log(paths.CASE_POINTS, sample, static=True)
        members = partial(self._members, CasePoints(result.failures, boxes.sample))
        state, tracked = timeline.draw(repeat, members, np.array(self._poses), boxes, self._flat)
        if self._sample is not None:
            turns.write(self._open, self._sample)
        return Findings(truth, True, tracked, state, curves, self._sample is not None)

    def _sampled(self, drawn: Drawn, judged: Judgeable | None) -> PointSample | None:
        """Drawn points that can be judged again; None if no parameter can be turned."""
        if judged is None:
            return None
        fits = accepts(self._run.params)
        turned = parameters_of(judged.names, judged.sums, self._given, fits)
        return PointSample(drawn, judged, tuple(turned), self._given) if turned else None

    def _members(self, every: CasePoints, case: cases.ShownCase, rows: I64, places: F64) -> Bool:
        """(K,) bool: which of the recorded points in its worst frame belong to a case."""
        if case.failure is None:
            return np.ones(len(rows), np.bool_)
        scan = self._run.sequence[case.frame]
        frames = np.full(len(rows), case.frame)
        owners = every.owners(case.failure.kind, frames, places)
        rows = rows if self._rows is None else self._rows(scan)[rows]
        of_case: Bool = cases.belong(case.failure, scan, rows) & (owners == case.number)
        return of_case

    def _repeat(
        self, labels: Sequence[Bool], asked: Sequence[tuple[int, Sequence[int]]]
    ) -> list[tuple[PointLedger, ...]]:
        """The ledgers of points with these labels; none if the evidence is faulty.

        That must not cost the recording.
        """
        recorded = asked
        scans = self._run.sequence
        if self._rows is not None:
            asked = [
                (frame, self._rows(scans[frame])[list(rows)].tolist()) for frame, rows in asked
            ]
        witnesses = None
        drawn = None if self._draw is None else self._draw.drawn()
        if self._draw is not None and drawn is not None:
            witnesses = Witnesses(drawn, self._draw.first, self._given)
        try:
            run = dataclasses.replace(self._run, summary=self._summary)
            repeated = repeat(run, asked, witnesses=witnesses)
            for each in (each for ledgers in repeated.ledgers for each in ledgers):
                if each.removed != labels[each.frame][each.point]:
                    name = self._info.name
                    raise PluginError(
                        f"{name}: labels point {each.point} of frame {each.frame} differently each "
                        "time"
                    )
        except PluginError as error:
            self._say(f"no evidence: {error}")
            return [()] * len(asked)
        self._open.properties(repeat_s=round(repeated.seconds, 3))
        if drawn is not None and witnesses is not None:
            self._sample = self._sampled(drawn, witnesses.judged())
        return [
            tuple(
                dataclasses.replace(each, point=row, case=case)
                for each, row in zip(ledgers, rows, strict=True)
            )
            for case, (ledgers, (_, rows)) in enumerate(
                zip(repeated.ledgers, recorded, strict=True), 1
            )
        ]

    @property
    def _open(self) -> sink.RecordingFile:
        if self._sink is None:
            raise RuntimeError(
                "a recorder records one run: call begin before, and nothing after finish"
            )
        return self._sink

    def _counts(self, labelled: Labelled, wrong: tuple[int, int]) -> Iterator[tuple[str, int]]:
        """The recorder's own curves at a frame.

        Wrong points, or without ground truth removed points.
        """
        if self._run.sequence.has_labels:
            yield from zip(
                (f"{paths.WRONG}/{kind}" for kind in WRONG_POINTS),
                wrong,
                strict=True,
            )
            return
        by_reason = np.bincount(
            labelled.reasons[labelled.dynamic], minlength=len(self._info.reasons)
        )
        yield f"{paths.REMOVED_POINTS}/removed", int(by_reason.sum())
        for code, reason in enumerate(self._info.reasons):
            yield f"{paths.REASONS}/removed/{reason.name}", int(by_reason[code])

    def _facts(
        self, run: RunSpec, summary: SequenceSummary, params: dict[str, Any]
    ) -> dict[str, Any]:
        info = run.labeller.info
        return {
            "schema": paths.SCHEMA,
            "mode": self.mode,
            "method": info.name,
            "title": info.title,
            "compares": info.compares or "",  # left out if it is false
            "reasons_json": json.dumps([dataclasses.asdict(reason) for reason in info.reasons]),
            "sequence": run.sequence.name,
            "digest": summary.digest,
            "has_labels": run.sequence.has_labels,
            "frames": summary.frames,
            "points": summary.points,
            "params_json": json.dumps(params),
            "seed": run.seed,
            "online": run.online,
            "command": run.command,
            "environment_json": json.dumps(msgspec.to_builtins(environment())),
        }

    def _write_legends(self) -> None:
        legend = classes.legend(
            self._info.reasons, self._run.sequence.has_labels, self._info.compares
        )
        self._open.log(paths.ROOT, rr.AnnotationContext(legend), static=True)
        for state in self._states.values():
            if (context := states.legend(state)) is not None:
                self._open.log(paths.state(self._info.name, state), context, static=True)
        for tab in keys.tabs(self._info) if self._states else ():
            key = keys.strip(tab, dataclasses.asdict(self._run.params))
            self._open.log(paths.key(self._info.name, tab[0]), key, static=True)
        if self._scene is not None:
            legend_strip = keys.legend(self._run.sequence.has_labels)
            self._open.log(paths.LEGEND, legend_strip, static=True)

    def _draw_states(
        self, queue: list[tuple[State, Value]], scan: Scan, errors: F32 | None = None
    ) -> None:
        """Draw states of a scan.

        If not all of each, then around the (K, 3) wrong points, if known.
        """
        budget = None if self._most is None else Budget(scan, self._most, errors)
        for state, value in queue:
            if isinstance(value, Text):
                self._say(f"{state.name}: {value.text}")
            elif (drawn := states.draw(value, state, scan, budget)) is not None:
                path = paths.state(self._info.name, state)
                self._open.log(path, drawn)
                self._flat.add(path, value)
                if isinstance(value, PolarGrid):
                    self._guide(path, value, scan)

    def _guide(self, path: str, grid: PolarGrid, scan: Scan) -> None:
        """Distances and the direction of travel in a polar grid."""
        if path not in self._guided:
            self._guided.add(path)
            self._open.log(f"{path}/rings", *keys.rings(grid, states.PICTURE), static=True)
        if (ahead := self._heading.of(scan)) is not None:
            self._open.log(f"{path}/travel", keys.arrow(ahead, states.PICTURE))

    def _histogram(self, path: str, histogram: FrameHistograms) -> None:
        """The histogram of the run with its 10 % line, and those of the frames on the timeline."""
        edges = histogram.edges.copy()
        total = histogram.counts.sum(0)
        if not np.isfinite(edges[-1]):  # the last bin is open: draw it as wide as the previous one
            edges[-1] = 2 * edges[-2] - edges[-3]
        bars = _bars(path, total, edges)
        self._open.log(f"{path}/run", bars, static=True)
        if total.sum():
            width = 0.003 * (edges[-1] - edges[0])
            line = rr.BarChart(
                [float(total.max())],
                abscissa=[_tenth(total, edges)],
                widths=[width],
                color=colours.NEUTRAL,
            )
            self._open.log(f"{path}/p10", line, static=True)
        for (frame, *_), counts in zip(self._outcomes.frames, histogram.counts, strict=True):
            self._open.at(frame, None)
            bars.values = counts  # the rest is converted only once
            self._open.log(path, bars)

    def _mark_worst(self) -> None:
        worst = sorted(
            (frame, float(kept + removed)) for frame, _, kept, removed in self._outcomes.worst()
        )
        style = rr.SeriesPoints(
            colors=colours.NEUTRAL, markers="diamond", marker_sizes=4, names="worst frames"
        )
        self._open.log(paths.WORST, style, static=True)
        if worst:
            frames, wrong = zip(*worst, strict=True)
            self._open.columns(paths.WORST, frames, [None], rr.Scalars.columns(scalars=wrong))

    def _report(self, text: str) -> None:
        self._document(paths.REPORT, text)

    def _document(self, path: str, text: str) -> None:
        self._open.log(path, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)

    def _say(self, text: str) -> None:
        self._open.log(paths.LOG, rr.TextLog(text, level=rr.TextLogLevel.INFO))


def _copied(value: Value) -> Value:
    """A state with copies of its arrays."""
    parts: dict[str, Any] = {
        field.name: getattr(value, field.name) for field in dataclasses.fields(value)
    }
    parts = {
        name: part.copy() if isinstance(part, np.ndarray) else part for name, part in parts.items()
    }
    return type(value)(**parts)


def _bars(path: str, counts: Any, edges: Any) -> rr.BarChart:
    kind = path.split("/")[1]
    outcome = next((outcome for name, outcome in ERRORS.items() if name == kind), None)
    colour = colours.NEUTRAL if outcome is None else colours.FIRM[outcome]
    middles = (edges[:-1] + edges[1:]) / 2
    widths = np.diff(edges)
    return rr.BarChart(counts, abscissa=middles, widths=0.92 * widths, color=colour)


def _tenth(counts: Any, edges: Any) -> float:
    """The value below which a tenth of the counts lies, interpolated within its bin."""
    below = np.concatenate([[0], np.cumsum(counts)])
    return float(np.interp(0.1 * below[-1], below, edges))
