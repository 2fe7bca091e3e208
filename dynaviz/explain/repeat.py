"""The only loop that repeats a run: for the ledgers of some points."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F64
from dynaviz.contracts.at_sensor import AtSensor
from dynaviz.contracts.probe import SILENT
from dynaviz.contracts.scan import Scan, stream
from dynaviz.engine.loop import Clock, RunSpec, context_of, labelled_by
from dynaviz.engine.packed_bits import PackedBits
from dynaviz.explain.ledger import Ledger
from dynaviz.explain.point_ledger import PointLedger
from dynaviz.explain.ray_geometry import touching
from dynaviz.explain.sample import Witnesses
from dynaviz.progress import Progress, silent
from dynaviz.sources.summary import summarize


@dataclass(frozen=True, slots=True, eq=False)
class Repeated:
    """What repeating a run gave.

    Attributes:
        ledgers: for each question the ledgers of its points.
        seconds: that repeating takes if all scans are observed and labelled as a whole.
        labels_sha256: of all labels, as in ``Result``; None if only some frames were labelled.
    """

    ledgers: list[tuple[PointLedger, ...]]
    seconds: float
    labels_sha256: str | None


def repeat(
    run: RunSpec,
    asked: Sequence[tuple[int, Sequence[int]]],
    *,
    whole: bool = False,
    witnesses: Witnesses | None = None,
    progress: Progress = silent,
) -> Repeated:
    """Let the labeller of a run see all scans again, and keep the ledgers of points.

    Unless the whole run is asked for, only the frames of the points are labelled, and the method
    observes of the other scans only the rays that can change what it knows about the points. Frames
    of witnesses are labelled too, unless their evidence is complete without.

    Args:
        run: its labeller forgets what it knows, and then knows it again.
        asked: frames with rows of their scans; a frame may occur several times.
        whole: observe and label everything.
        witnesses: of drawn points; they are asked after each scan.
        progress: called with a phase, the number of frames done and their total.

    Raises:
        UsageError: for a frame or a point that does not exist.
        PluginError: if the evidence of the method contradicts its labels.
        DataError: for data that cannot be read.
    """
    rows: dict[int, list[int]] = {}
    for frame, points in asked:
        if points:
            rows.setdefault(frame, []).extend(points)
    ledger = Ledger(rows)
    sequence = run.sequence
    total = len(sequence)
    summary = run.summary or summarize(sequence, lambda done: progress("survey", done, total))
    run = dataclasses.replace(run, metrics=(), summary=summary)
    method = run.method
    near = AtSensor(sequence.sensor)
    one_pass = run.online or method is None
    # From the first on, as in a run, so that no method takes the scan that it observed last for
    # that of an online run.
    chosen = range(total) if whole or one_pass else sorted({0, *rows})
    clock = Clock()
    answer = PackedBits()
    begin = time.perf_counter()
    kernels.set_threads(run.threads)
    run.labeller.begin(context_of(run, summary, SILENT))
    ledger.begin(run, summary)
    if witnesses is not None:
        witnesses.begin(run.labeller, sequence)

    def cells() -> F64 | None:
        """(K, 2, 3) metres, world frame: only rays that touch them can change what the method
        knows about the points; None if any ray can.
        """
        asking = ledger.asking() + ([] if witnesses is None else witnesses.asking())
        if not all(alone for alone, _ in asking):
            return None
        return np.concatenate([np.empty((0, 2, 3)), *(around for _, around in asking)])

    def observe(frame: int, scan: Scan) -> None:
        assert method is not None
        ledger.observing(frame, scan)
        seen = near.hidden(scan)[0]
        if frame in chosen:
            clock.timed(len(clock.frames), method.observe, seen)
        else:
            changing = cells()
            method.observe(seen if changing is None else seen.chosen(touching(seen, changing)))
        ledger.observed(frame)
        if witnesses is not None:
            witnesses.observed()
        progress("observe", frame + 1, total)

    def label(number: int, frame: int, scan: Scan) -> None:
        timed = partial(clock.timed, min(number, len(clock.frames)), run.labeller.label)
        labelled = labelled_by(run, near, frame, scan, timed)
        answer.append(labelled.dynamic)
        ledger.labelled(labelled, {})
        if witnesses is not None:
            witnesses.labelled(frame, run.online)
        progress("label", number + 1, len(chosen))

    for frame, scan in enumerate(stream(sequence)):
        if method is not None:
            observe(frame, scan)
        if one_pass:
            label(frame, frame, scan)
    if not one_pass:
        for number, frame in enumerate(chosen):
            label(number, frame, sequence[frame])
    if witnesses is not None:
        further = [] if cells() is not None else sorted({*witnesses.frames}.difference(chosen))
        for frame in further:
            labelled_by(run, near, frame, sequence[frame], run.labeller.label)
            witnesses.labelled(frame, run.online)
        witnesses.finish()
    ledger.finish()
    seconds = time.perf_counter() - begin
    if method is not None:
        seconds = sum(clock.frames) * total / len(chosen)
    left = {frame: iter(found) for frame, found in ledger.ledgers.items()}
    return Repeated(
        [tuple(next(left[frame]) for _ in points) for frame, points in asked],
        summary.seconds + seconds,
        answer.sha256() if len(chosen) == total else None,
    )
