"""Repeat a run for the ledgers of some points."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial

from dynaviz import kernels
from dynaviz.arrays import Intp
from dynaviz.contracts.at_sensor import AtSensor
from dynaviz.contracts.probe import SILENT
from dynaviz.contracts.scan import Scan, stream
from dynaviz.engine.ledger import Ledger
from dynaviz.engine.loop import Clock, Listener, RunSpec, context_of, execute, labelled_by
from dynaviz.engine.point_ledger import PointLedger
from dynaviz.sources.summary import SequenceSummary


def replay(
    run: RunSpec, summary: SequenceSummary, asked: Sequence[tuple[int, Sequence[int]]]
) -> tuple[list[tuple[PointLedger, ...]], float]:
    """The ledgers of points, from repeating a run with the same labeller.

    Args:
        run: its labeller forgets what it knows, and then knows it again.
        summary: of its sequence.
        asked: frames with rows of their scans; a frame may occur several times.

    Returns:
        For each of ``asked`` the ledgers of its points; and the seconds that a whole run takes
        without any.

    Raises:
        PluginError: if the evidence of the method contradicts its labels.
        DataError: for data that cannot be read.
    """
    rows: dict[int, list[int]] = {}
    for frame, points in asked:
        if points:
            rows.setdefault(frame, []).extend(points)
    ledger = Ledger(rows)
    run = dataclasses.replace(run, metrics=(), summary=summary)
    if run.method:
        seconds = _repeat(run, ledger, rows, ledger.needed)
        ledger.finish()
    else:
        begin = time.perf_counter()
        execute(run, [ledger])
        seconds = time.perf_counter() - begin
    left = {frame: iter(found) for frame, found in ledger.ledgers.items()}
    return [
        tuple(next(left[frame]) for _ in points) for frame, points in asked
    ], summary.seconds + seconds


def _repeat(
    run: RunSpec, listener: Listener, frames: Iterable[int], needed: Callable[[Scan], Intp | None]
) -> float:
    """Let the method of a run observe all scans again, for a listener.

    Only some of them are labelled.

    Args:
        run: of a method, which forgets what it knows, and then knows it again; with the summary of
            its sequence.
        listener: notified of all scans, and of the labels of some; it gets no curves and no result.
        frames: those to label.
        needed: rows of a scan that the method has to observe, if it is not labelled; None for all.

    Returns:
        Seconds that the method would take to observe and label all scans as a whole.

    Raises:
        PluginError, DataError: as ``execute``.
    """
    method = run.method
    summary = run.summary
    near = AtSensor(run.sequence.sensor)
    assert method is not None
    assert summary is not None
    clock = Clock()
    total = len(run.sequence)
    # From the first on, as in a run, so that no method takes the scan that it observed last for
    # that of an online run.
    chosen = range(total) if run.online else sorted({0, *frames})
    kernels.set_threads(run.threads)
    method.begin(context_of(run, summary, SILENT))
    listener.begin(run, summary)

    def label(frame: int, scan: Scan) -> None:
        timed = partial(clock.timed, len(clock.frames) - 1, method.label)
        listener.labelled(labelled_by(run, near, frame, scan, timed), {})

    for frame, scan in enumerate(stream(run.sequence)):
        listener.observing(frame, scan)
        seen = near.hidden(scan)[0]
        if frame in chosen:
            clock.timed(len(clock.frames), method.observe, seen)
        else:
            method.observe(seen if (rows := needed(seen)) is None else seen.chosen(rows))
        listener.observed(frame)
        if run.online:
            label(frame, scan)
    if not run.online:
        for frame in chosen:
            label(frame, run.sequence[frame])
    return sum(clock.frames) * total / len(chosen)
