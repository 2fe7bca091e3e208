"""THE loop: sequence x method x listeners -> Result. Two passes, or one in online mode; only the method is timed."""

from __future__ import annotations

import dataclasses
import resource
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dynaviz import kernels
from dynaviz.engine.packed_bits import PackedBits
from dynaviz.engine.summary import SequenceSummary, summarize
from dynaviz.errors import PluginError, UsageError
from dynaviz.method import Context, Method
from dynaviz.metric import Figure, Labelled, Metric
from dynaviz.probe import SILENT, MemoryProbe, Probe
from dynaviz.progress import Progress, silent
from dynaviz.results.result import Result, environment
from dynaviz.scan import Scan, Sequence, stream
from dynaviz.spatial.extent import Extent

MOST_IN_MAP = (1 << 31) - 1  # points that methods which need the raw map can number


@dataclass(frozen=True)
class RunSpec:
    """What a run is, before it starts.

    Attributes:
        method: a fresh method; it is told of its parameters already.
        sequence: what to run it on.
        params: the method's parameters, an instance of its ``Params``.
        metrics: fresh metrics.
        online: ask for labels right after each scan was observed.
        seed: for everything random in the method.
        variant: a short name for the parameters, for tables.
        threads: for kernels; None for all cores.
        command: what the user typed, for the record.
        scoring: how answers come about: ``mask`` or ``nn`` (``eval/README.md``).
        external: the answers are those of another program: nothing is observed here, and its runtime is unknown.
    """

    method: Method
    sequence: Sequence
    params: Any
    metrics: tuple[Metric, ...] = ()
    online: bool = False
    seed: int = 0
    variant: str = ""
    threads: int | None = None
    command: str = ""
    scoring: str = "mask"
    external: bool = False


class Listener:
    """Hears of every step of a run; its time is not the method's. Subclasses say what they care for."""

    def begin(self, run: RunSpec, summary: SequenceSummary) -> None:
        """Before the first frame."""

    def observing(self, frame: int, scan: Scan) -> None:
        """A scan is about to be observed; states emitted from here on are of this frame."""

    def observed(self, frame: int) -> None:
        """The method returned; its states of this frame are complete."""

    def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
        """A scan has its labels; curves hold the metrics' numbers at this frame."""

    def finish(self, result: Result, figures: Mapping[str, Figure]) -> None:
        """All frames are done."""


@dataclass
class Clock:
    """Seconds of the method, frame by frame."""

    frames: list[float] = field(default_factory=list)
    prepared: float = 0.0

    def prepare(self, call: Callable[[], None]) -> None:
        """Call, and remember the time as spent before the first frame."""
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

    def summary(self) -> dict[str, float | int]:
        """Mean and standard deviation over frames, as in the paper's runtime table."""
        seconds = np.array(self.frames)
        return {
            "mean_s": float(seconds.mean()),
            "std_s": float(seconds.std()),
            "frames": len(seconds),
            "prepare_s": self.prepared,
        }


def execute(
    run: RunSpec,
    listeners: Iterable[Listener] = (),
    probe: Probe = SILENT,
    progress: Progress = silent,
) -> Result:
    """Run a method over a sequence, score it, and tell the listeners.

    Args:
        run: what to run.
        listeners: recordings and other outputs, told in this order.
        probe: who looks at the method's states; ``SILENT`` for an honest timing.
        progress: called after each frame of each phase.

    Returns:
        The result; ``instrumented`` tells whether anybody looked at states.
    """
    listeners, total, clock, answer = tuple(listeners), len(run.sequence), Clock(), PackedBits()
    threads = kernels.set_threads(run.threads)
    seen = summarize(run.sequence, lambda done: progress("survey", done, total))
    if not run.external:
        _warm_up(run, probe)
    clock.prepare(lambda: run.method.begin(_context(run, seen, probe)))
    for listener in listeners:
        listener.begin(run, seen)

    def observe(frame: int, scan: Scan) -> None:
        for listener in listeners:
            listener.observing(frame, scan)
        clock.timed(frame, run.method.observe, scan.without_truth())
        for listener in listeners:
            listener.observed(frame)
        progress("observe", frame + 1, total)

    def label(frame: int, scan: Scan) -> None:
        bare = scan.without_truth()
        dynamic = clock.timed(frame, run.method.label, bare)
        _check(run.method.info.name, dynamic, len(scan))
        answer.append(dynamic)
        labelled = Labelled.of(frame, scan, dynamic, run.method.explain(bare))
        curves = {name: value for metric in run.metrics for name, value in metric.update(labelled).items()}
        for listener in listeners:
            listener.labelled(labelled, curves)
        progress("label", frame + 1, total)

    passes = ([label],) if run.external else ([observe, label],) if run.online else ([observe], [label])
    for passing in passes:
        for frame, scan in enumerate(stream(run.sequence)):
            for step in passing:
                step(frame, scan)

    runtime = _runtime(run, clock, threads)
    result = _result(run, seen, runtime, answer.sha256(), instrumented=probe is not SILENT and not run.external)
    figures = {path: figure for metric in run.metrics for path, figure in metric.figures().items()}
    for listener in listeners:
        listener.finish(result, figures)
    return result


def _check(method: str, dynamic: Any, points: int) -> None:
    """Refuse an answer that is no mask: integers would choose points by their numbers where files are written."""
    if not isinstance(dynamic, np.ndarray) or dynamic.dtype != np.bool_ or dynamic.shape != (points,):
        kind = f"{dynamic.dtype} {dynamic.shape}" if isinstance(dynamic, np.ndarray) else type(dynamic).__name__
        raise PluginError(
            f"{method}: label() answered with {kind}, not with bool ({points},). "
            "Try it with dynaviz.testing.check_method, which tells more"
        )


def _runtime(run: RunSpec, clock: Clock, threads: int) -> dict[str, Any]:
    """Seconds and memory, asked before the metrics finish, for what they need then is not the method's.

    Of another program only the number of frames is known.
    """
    known = {**clock.summary(), "threads": threads, "peak_rss_mb": peak_rss_mb()}
    return {**dict.fromkeys(known), "frames": known["frames"]} if run.external else known


def _result(
    run: RunSpec, seen: SequenceSummary, runtime: dict[str, Any], labels_sha256: str, instrumented: bool
) -> Result:
    return Result(
        method=run.method.info.name,
        parameters=dataclasses.asdict(run.params),
        sequence={"name": run.sequence.name, "digest": seen.digest, "frames": seen.frames, "points": seen.points},
        sections={key: value for metric in run.metrics for key, value in metric.finish().items()},
        runtime=runtime,
        online=run.online,
        seed=run.seed,
        variant=run.variant,
        scoring=run.scoring,
        labels_sha256=labels_sha256,
        instrumented=instrumented,
        environment=environment(),
        command=run.command,
    )


def peak_rss_mb() -> float:
    """The most memory this process ever held, in MB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return round(peak / (1e6 if sys.platform == "darwin" else 1e3), 1)


def _context(run: RunSpec, seen: SequenceSummary, probe: Probe) -> Context:
    raw_map = None
    if run.method.info.needs_map:
        if seen.points > MOST_IN_MAP:
            raise UsageError(
                f"{run.method.info.name} needs the map of all scans: {seen.points:,} points in {seen.frames:,} frames, "
                f"and {MOST_IN_MAP:,} is the most. Take fewer with --frames A:B or --stride K"
            )
        raw_map = np.empty((seen.points, 3), np.float32)
        end = 0
        for scan in stream(run.sequence):
            raw_map[end : end + len(scan)] = scan.points
            end += len(scan)
    return Context(seen.extent, run.sequence.sensor, probe, run.seed, raw_map)


def _warm_up(run: RunSpec, probe: Probe) -> None:
    """Let a copy of the method see one scan, so that no frame's time holds the loading or compiling of kernels."""
    scan = run.sequence[0].without_truth()
    copy = type(run.method)(run.params)
    listening = SILENT if probe is SILENT else MemoryProbe()
    raw_map = scan.points if run.method.info.needs_map else None
    copy.begin(Context(Extent.of(scan), run.sequence.sensor, listening, run.seed, raw_map))
    copy.observe(scan)
    copy.label(scan)
    copy.explain(scan)
