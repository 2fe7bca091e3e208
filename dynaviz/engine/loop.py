"""The loop: sequence x labeller x listeners -> Result. Two passes, or one in online mode.

Only the method is timed.
"""

from __future__ import annotations

import dataclasses
import time
from array import array
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import msgspec
import numpy as np

from dynaviz import kernels
from dynaviz.arrays import U8, Bool, all_finite
from dynaviz.contracts.at_sensor import AtSensor, unjudged
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import AT_SENSOR, Context, Labeller, Labels, Method
from dynaviz.contracts.metric import Figure, Labelled, Metric
from dynaviz.contracts.options import RecordMode
from dynaviz.contracts.plugin_code import plugin
from dynaviz.contracts.probe import SILENT, MemoryProbe, Probe
from dynaviz.contracts.scan import Scan, Sequence, stream
from dynaviz.engine.packed_bits import PackedBits
from dynaviz.engine.updating import Updates
from dynaviz.errors import PluginError, UsageError
from dynaviz.progress import Progress, silent
from dynaviz.scores.account import PointAccount
from dynaviz.scores.answers import RunAnswers
from dynaviz.scores.labels import RunLabels
from dynaviz.scores.result import Result, environment
from dynaviz.scores.sections import Runtime, Sections, SequenceInfo
from dynaviz.sources.drive import Drive
from dynaviz.sources.origin import PoseFinding
from dynaviz.sources.pose_noise import PoseNoiseMeter
from dynaviz.sources.summary import SequenceSummary, summarize
from dynaviz.tasks.memory import peak_rss_mb

MAX_MAP_POINTS = (1 << 31) - 1  # methods that need the raw map number its points in int32


class Reviewing(Protocol):
    """Decisions of a person on a sequence (``dynaviz.reviews``)."""

    def answers(self, scan: Scan, dynamic: Bool) -> tuple[Bool, U8]:
        """(N,) bool answers with the decisions, and (N,) uint8 what they are."""
        ...

    def truth(self, scan: Scan) -> Scan:
        """The scan with the ground truth that the decisions state."""
        ...


@runtime_checkable
class LabelledEarlier(Labeller, Protocol):
    """The labels that a method gave in an earlier step, as those of tiles.

    Attributes:
        Params: of the method.
        runtime: its cost.
    """

    Params: type[Any]
    runtime: Runtime


@dataclass(frozen=True)
class LoopInput:
    """What the loop needs.

    Attributes:
        labeller: a fresh method, which already has its parameters; or the output of another
            program.
        sequence: what to run it on.
        params: the labeller's parameters, a dataclass; for a method an instance of its ``Params``.
        metrics: fresh metrics.
        online: ask for labels right after each scan was observed.
        seed: for all randomness in the method.
        threads: for kernels; None for all cores.
        summary: of the sequence if it is known, which saves a pass over it.
        review: decisions that ground truth and maps follow; labels do not.
    """

    labeller: Labeller
    sequence: Sequence
    params: Any
    metrics: tuple[Metric, ...] = ()
    online: bool = False
    seed: int = 0
    threads: int | None = None
    summary: SequenceSummary | None = None
    review: Reviewing | None = None

    @property
    def drive(self) -> Drive:
        """The sequence, which need not be a drive for tests of methods."""
        return Drive.of(self.sequence)

    @property
    def method(self) -> Method | None:
        """The labeller if it is a method, which observes scans and is timed.

        None for another program's output.
        """
        return self.labeller if isinstance(self.labeller, Method) else None

    @property
    def of_method(self) -> bool:
        """Whether the labels are those of a method, now or earlier, and not another program's."""
        return isinstance(self.labeller, Method | LabelledEarlier)


@dataclass(frozen=True)
class RunSpec(LoopInput):
    """What to run, and what its result and its files state about it.

    Attributes:
        variant: a short name for the parameter set, for tables.
        preset, parameter_origins: where the parameters come from, as in ``Result``.
        command: what the user typed, for the record.
        scoring: how labels are assigned to points: ``mask`` or ``nn`` (``eval/README.md``).
        pose_findings: what is likely wrong with the poses of the sequence, for the result.
        record: how much the recording contains; None without one.
        folder: for the files of the run; None if it writes none.
        recording: its file; None if there is none.
    """

    variant: str = ""
    preset: str | None = None
    parameter_origins: Mapping[str, str] = field(default_factory=dict)
    command: str = ""
    scoring: str = "mask"
    pose_findings: tuple[PoseFinding, ...] = ()
    record: RecordMode | None = None
    folder: Path | None = None
    recording: Path | None = None


class Listener:
    """Run callbacks; override those you need. Their time does not count as the method's."""

    def begin(self, run: RunSpec, summary: SequenceSummary) -> None:
        """Before the first frame."""

    def observing(self, frame: int, scan: Scan) -> None:
        """Before a scan is observed; states emitted from here on belong to this frame."""

    def observed(self, frame: int) -> None:
        """After a scan was observed; its states are complete."""

    def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
        """After a scan was labelled; curves are the metrics' values at this frame."""

    def sections(self) -> Mapping[str, Any]:
        """Further sections of the result, by name; called once, after the last frame."""
        return {}

    def finish(self, result: Result, figures: Mapping[str, Figure]) -> None:
        """After the last frame."""


@dataclass
class Clock:
    """Seconds of the method, frame by frame."""

    frames: array[float] = field(default_factory=lambda: array("d"))
    prepared: float = 0.0

    def prepare(self, call: Callable[[], None]) -> None:
        """Call, and keep the time as spent before the first frame."""
        start = time.perf_counter()
        call()
        self.prepared = time.perf_counter() - start

    def timed(self, frame: int, call: Callable[[Scan], Any], scan: Scan) -> Any:
        """Call, and add the time to the frame's."""
        start = time.perf_counter()
        answer = call(scan)
        seconds = time.perf_counter() - start
        if frame == len(self.frames):
            self.frames.append(0.0)
        self.frames[frame] += seconds
        return answer

    def runtime(self, threads: int) -> Runtime:
        """Mean and standard deviation over frames, as in the paper's runtime table."""
        seconds = np.array(self.frames)
        mean = float(seconds.mean())
        std = float(seconds.std())
        return Runtime(mean, std, len(seconds), self.prepared, threads, peak_rss_mb())


def execute(
    run: RunSpec,
    listeners: Iterable[Listener] = (),
    probe: Probe = SILENT,
    progress: Progress = silent,
) -> Result:
    """Label a sequence, score the labels, and notify the listeners.

    Args:
        run: what to run.
        listeners: recordings and other outputs, called in this order.
        probe: receives the method's states; use ``SILENT`` for an honest timing.
        progress: called after each frame of each phase.

    Returns:
        The result; ``instrumented`` says whether states were recorded.

    Raises:
        UsageError: for a sequence with too many points for the method.
        PluginError: for a method whose labels have the wrong type or shape.
        DataError: for data that cannot be read.
    """
    listeners = tuple(listeners)
    total = len(run.sequence)
    clock = Clock()
    answer = PackedBits()
    counts = array("q")
    removed = 0
    not_finite = 0
    at_sensor = 0
    labeller = run.labeller
    method = run.method
    threads = kernels.set_threads(run.threads)
    summary = run.summary or summarize(
        run.sequence,
        lambda done: progress("survey", done, total),
        PoseNoiseMeter(len(run.sequence)),
    )
    near = AtSensor(run.sequence.sensor)
    info = labeller.info
    updates = Updates(run.metrics)
    if method:
        _warm_up(method, run, probe)
    clock.prepare(lambda: labeller.begin(context_of(run, summary, probe)))
    for listener in listeners:
        listener.begin(run, summary)

    def observe(frame: int, scan: Scan) -> None:
        for listener in listeners:
            listener.observing(frame, scan)
        if method:
            clock.timed(frame, method.observe, near.hidden(scan)[0])
        for listener in listeners:
            listener.observed(frame)
        progress("observe", frame + 1, total)

    def label(frame: int, scan: Scan) -> None:
        nonlocal removed, not_finite, at_sensor
        labelled = labelled_by(run, near, frame, scan, partial(clock.timed, frame, labeller.label))
        answer.append(labelled.dynamic)
        counts.append(len(scan))
        finite = all_finite(scan.points)
        removed = removed + int((labelled.dynamic & finite).sum())
        not_finite = not_finite + int((~finite).sum())
        at_sensor += int(np.count_nonzero(labelled.reasons == info.reasons.index(AT_SENSOR)))
        curves = updates.update(labelled)
        for listener in listeners:
            listener.labelled(labelled, curves)
        progress("label", frame + 1, total)

    for steps in _passes(run, observe, label):
        for frame, scan in enumerate(stream(run.sequence)):
            for step in steps:
                step(frame, scan)

    # Before the metrics finish: the memory they need then is not the method's.
    runtime = Runtime(frames=total)
    if method:
        runtime = clock.runtime(threads)
    elif isinstance(labeller, LabelledEarlier):
        runtime = labeller.runtime
    updates.look()
    sections = _sections(run.metrics)
    for listener in listeners:
        sections = msgspec.structs.replace(sections, **listener.sections())
    labels = RunLabels(answer.packed(), np.array(counts, np.int64))
    unposed = sum(each.number for each in run.drive.unposed())
    judged = sum(counts) - not_finite
    account = PointAccount(
        points=sum(counts) + unposed,
        kept=judged - removed,
        removed=removed,
        unposed_left_out=unposed,
        not_finite=not_finite,
    )
    answers = RunAnswers(run.drive, labels, run.folder, run.recording)
    instrumented = method is not None and probe is not SILENT
    result = _result(
        run, summary, at_sensor, sections, runtime, answers, account, answer.sha256(), instrumented
    )
    figures = {path: figure for metric in run.metrics for path, figure in metric.figures().items()}
    for listener in listeners:
        listener.finish(result, figures)
    return result


def labelled_by(
    run: LoopInput, near: AtSensor, frame: int, scan: Scan, call: Callable[[Scan], Any]
) -> Labelled:
    """A scan with the labels that a call returns for the scan as methods receive it.

    Raises:
        PluginError: for labels of the wrong type or shape.
    """
    info = run.labeller.info
    seen, found = near.hidden(scan) if run.method else (scan.without_truth(), None)
    labels = call(seen)
    _check(info.name, labels, len(scan))
    labels = labels if found is None else unjudged(labels, found, info)
    if run.review is not None and run.sequence.has_labels:
        scan = run.review.truth(scan)
    return Labelled.of(frame, scan, labels.dynamic, labels.reasons, labels.answered)


Step = Callable[[int, Scan], None]


def _passes(run: LoopInput, observe: Step, label: Step) -> list[list[Step]]:
    """What happens to each scan, pass by pass."""
    if run.method is None:
        return [[label]]
    return [[observe, label]] if run.online else [[observe], [label]]


def _check(method: str, labels: Any, points: int) -> None:
    """Reject labels of another type.

    Integers would select points by number where files are written.
    """
    if not isinstance(labels, Labels):
        expected = "dynaviz.contracts.method.Labels"
        raise PluginError(
            f"{method}: label() returned {type(labels).__name__}, not {expected}. {_KIT}"
        )
    for name, values, dtype in (
        ("dynamic", labels.dynamic, np.bool_),
        ("reasons", labels.reasons, np.uint8),
    ):
        if not isinstance(values, np.ndarray) or values.dtype != dtype or values.shape != (points,):
            found = (
                f"{values.dtype} {values.shape}"
                if isinstance(values, np.ndarray)
                else type(values).__name__
            )
            expected = f"{np.dtype(dtype)} ({points},)"
            raise PluginError(
                f"{method}: label() returned {name} as {found}, not {expected}. {_KIT}"
            )


_KIT = "Check the method with dynaviz.testing.check_method"


def _sections(metrics: Iterable[Metric]) -> Sections:
    sections = Sections()
    try:
        for (
            metric
        ) in metrics:  # one by one, because plain values of many frames need much more memory
            sections = sections.joined(metric.finish())
    except msgspec.ValidationError as error:
        raise PluginError(f"a metric returned an invalid section: {error}") from None
    return sections


def _result(
    run: RunSpec,
    summary: SequenceSummary,
    at_sensor: int,
    sections: Sections,
    runtime: Runtime,
    answers: RunAnswers,
    account: PointAccount,
    labels_sha256: str,
    instrumented: bool,
) -> Result:
    name = run.labeller.info.name
    return Result(
        method=name,
        parameters=dataclasses.asdict(run.params),
        sequence=SequenceInfo(
            run.sequence.name, summary.digest, summary.frames, summary.points, at_sensor
        ),
        sections=sections,
        runtime=runtime,
        online=run.online,
        seed=run.seed,
        variant=run.variant,
        preset=run.preset,
        parameter_origins=run.parameter_origins,
        scoring=run.scoring,
        labels_sha256=labels_sha256,
        record=run.record,
        instrumented=instrumented,
        environment=environment(),
        command=run.command,
        pose_noise=summary.pose_noise,
        pose_refinement=run.drive.refinement,
        pose_findings=run.pose_findings,
        reading=None if run.drive.exact else run.drive.reading,
        origin=run.drive.provenance,
        plugin=plugin("methods", name) if run.of_method else None,
        account=account,
        answers=answers,
    )


def context_of(run: LoopInput, summary: SequenceSummary, probe: Probe) -> Context:
    """What a method is given before the first scan.

    Raises:
        UsageError: for a sequence with too many points for the method.
    """
    info = run.labeller.info
    raw_map = None
    if info.needs_map:
        if summary.points > MAX_MAP_POINTS:
            raise UsageError(
                f"{info.name} needs the map of all scans, at most {MAX_MAP_POINTS:,} points: "
                f"{run.sequence.name} has "
                f"{summary.points:,} in {summary.frames:,} frames. Use fewer with --frames A:B or "
                "--stride N"
            )
        raw_map = np.empty((summary.points, 3), np.float32)
        end = 0
        near = AtSensor(run.sequence.sensor)
        for scan in stream(run.sequence):
            raw_map[end : end + len(scan)] = near.hidden(scan)[0].points
            end += len(scan)
    return Context(summary.extent, run.sequence.sensor, probe, run.seed, raw_map)


def of_one_scan(run: LoopInput, probe: Probe = SILENT) -> tuple[Scan, Context]:
    """The first scan, as methods receive it, and the context of a run on this scan only."""
    scan, _ = AtSensor(run.sequence.sensor).hidden(run.sequence[0])
    raw_map = scan.points if run.labeller.info.needs_map else None
    return scan, Context(Extent.of(scan), run.sequence.sensor, probe, run.seed, raw_map)


def _warm_up(method: Method, run: LoopInput, probe: Probe) -> None:
    """Run a copy of the method on one scan, so that loading and compiling of kernels counts in no
    frame's time.
    """
    scan, context = of_one_scan(run, SILENT if probe is SILENT else MemoryProbe())
    copy = type(method)(run.params)
    copy.begin(context)
    copy.observe(scan)
    copy.label(scan)
