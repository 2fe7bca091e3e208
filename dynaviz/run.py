"""THE loop: sequence x method x listeners -> Result. Two passes, or one in online mode; only the method is timed."""

from __future__ import annotations

import dataclasses
import resource
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from dynaviz import kernels
from dynaviz.method import Context, Method
from dynaviz.metric import FrameHistograms, Labelled, Metric
from dynaviz.probe import SILENT, Probe, Value
from dynaviz.result import Result, environment
from dynaviz.scan import F32, Scan, Sequence, stream
from dynaviz.survey import Survey, survey


@dataclass(frozen=True)
class Run:
    """What a run is, before it starts.

    Attributes:
        method: a fresh method; it is told of its parameters already.
        sequence: what to run it on.
        params: the method's parameters, an instance of its ``Params``.
        metrics: fresh metrics.
        online: ask for labels right after each scan was observed.
        seed: for everything random in the method.
        threads: for kernels; None for all cores.
        command: what the user typed, for the record.
    """

    method: Method
    sequence: Sequence
    params: Any
    metrics: tuple[Metric, ...] = ()
    online: bool = False
    seed: int = 0
    threads: int | None = None
    command: str = ""


class Listener(Protocol):
    """Hears of every step of a run; its time is not the method's."""

    def begin(self, run: Run, survey: Survey) -> None:
        """Before the first frame."""
        ...

    def observing(self, frame: int, scan: Scan) -> None:
        """A scan is about to be observed; states emitted from here on are of this frame."""
        ...

    def observed(self, frame: int) -> None:
        """The method returned; its states of this frame are complete."""
        ...

    def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
        """A scan has its labels; curves hold the metrics' numbers at this frame."""
        ...

    def finish(self, result: Result, histograms: Mapping[str, FrameHistograms]) -> None:
        """All frames are done."""
        ...


@dataclass
class Clock:
    """Seconds of the method, frame by frame."""

    frames: list[float] = field(default_factory=list)
    prepare: float = 0.0

    def timed(self, frame: int, call: Callable[[Scan], Any], scan: Scan) -> Any:
        """Call, and add the time to the frame's."""
        start = time.perf_counter()
        answer = call(scan)
        seconds = time.perf_counter() - start
        if frame == len(self.frames):
            self.frames.append(0.0)
        self.frames[frame] += seconds
        return answer


Progress = Callable[[str, int, int], None]
"""Called with a phase, and how many frames of how many are done."""


def execute(
    run: Run,
    listeners: Iterable[Listener] = (),
    probe: Probe = SILENT,
    progress: Progress = lambda phase, done, total: None,
) -> Result:
    """Run a method over a sequence, score it, and tell the listeners.

    Args:
        run: what to run.
        listeners: recordings and other outputs, in this order.
        probe: who looks at the method's states; ``SILENT`` for an honest timing.
        progress: called after each frame of each phase.

    Returns:
        The result; ``instrumented`` tells whether anybody looked at states.
    """
    listeners, total, clock = tuple(listeners), len(run.sequence), Clock()
    threads = kernels.set_threads(run.threads)
    seen = survey(run.sequence, lambda done: progress("survey", done, total))
    start = time.perf_counter()
    run.method.begin(_context(run, seen, probe))
    clock.prepare = time.perf_counter() - start
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
        labelled = Labelled.of(frame, scan, dynamic, run.method.explain(bare))
        curves = {name: value for metric in run.metrics for name, value in metric.update(labelled).items()}
        for listener in listeners:
            listener.labelled(labelled, curves)
        progress("label", frame + 1, total)

    steps = [[observe, label]] if run.online else [[observe], [label]]
    for phase in steps:
        for frame, scan in enumerate(stream(run.sequence)):
            for step in phase:
                step(frame, scan)

    sections = {key: value for metric in run.metrics for key, value in metric.finish().items()}
    result = _result(run, seen, sections, clock, threads, instrumented=probe is not SILENT)
    histograms = {path: h for metric in run.metrics for path, h in metric.histograms().items()}
    for listener in listeners:
        listener.finish(result, histograms)
    return result
