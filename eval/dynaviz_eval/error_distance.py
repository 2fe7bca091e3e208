"""Distances from wrong points to the nearest correct point of the same ground truth (paper,
"Metric" and Fig. 5).
"""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Mapping

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import I32, I64
from dynaviz.contracts.method import MethodInfo
from dynaviz.contracts.metric import Figure, FrameHistograms, Labelled
from dynaviz.contracts.scan import Outcome
from dynaviz.scores.sections import ErrorDistances
from dynaviz.spatial.nearest import nearest_distance
from dynaviz_eval.spool import PointSpool

LIMIT = 2.0  # metres: larger distances are only counted
BIN = 0.05  # metres
_STEP = 1e-4  # metres: percentiles are rounded up to it
_HALO = LIMIT + 0.1  # metres: a margin above rounding errors far from the origin
_BLOCK = 300_000  # points in a slab, and at most wrong ones in memory at once, for each thread

EDGES = np.append(np.arange(round(LIMIT / BIN) + 1) * BIN, np.inf)
_FINE = round(LIMIT / _STEP)

_PAIRS = {
    "false_negative": (
        Outcome.FALSE_NEGATIVE,
        Outcome.DYNAMIC_REMOVED,
        "false negative to the nearest true positive",
    ),
    "false_positive": (
        Outcome.FALSE_POSITIVE,
        Outcome.STATIC_KEPT,
        "false positive to the nearest true negative",
    ),
}


class ErrorDistance:
    """Section ``error_distance``: distances from wrong points to correct ones.

    From each false negative to the nearest true positive of the whole run, and from each false
    positive to the nearest true negative. Points are stored on disk until the run is over: the
    nearest correct point may be in any later frame.
    """

    def __init__(self, info: MethodInfo) -> None:
        self._spools = {
            outcome: PointSpool()
            for wrong, correct, _ in _PAIRS.values()
            for outcome in (wrong, correct)
        }
        self._frames = 0
        self._by_frame: dict[str, I32] = {}

    def update(self, labelled: Labelled) -> Mapping[str, float]:
        """Store the points of one scan; points with non-finite coordinates have no distance."""
        self._frames = labelled.frame + 1
        for outcome, spool in self._spools.items():
            spool.append(
                labelled.frame, np.compress(labelled.outcome == outcome, labelled.scan.points, 0)
            )
        return {}

    def finish(self) -> Mapping[str, Mapping[str, ErrorDistances]]:
        """The section. Deletes the temporary files."""
        section = {}
        for name, (wrong, correct, _) in _PAIRS.items():
            fine, by_frame = distances(self._spools[wrong], self._spools[correct], self._frames)
            section[name] = summary(fine)
            if fine.any():
                # half the memory until the recording is written
                self._by_frame[name] = by_frame.astype(np.int32)
        for spool in self._spools.values():
            spool.close()
        return {"error_distance": section}

    def figures(self) -> Mapping[str, Figure]:
        """Distances of the wrong points of each frame."""
        return {
            name: FrameHistograms(
                f"distance from a {_PAIRS[name][2]}", "m", EDGES, counts.astype(np.int64)
            )
            for name, counts in self._by_frame.items()
        }


def distances(
    wrong: PointSpool, correct: PointSpool, frames: int, block: int = _BLOCK
) -> tuple[I64, I64]:
    """Exact distances from each wrong point to the nearest correct one, as histograms.

    The world is divided into slabs along its longest side, and each thread works on one. Correct
    points are read from a box around the wrong points of a slab, two blocks at a time, and each
    wrong point keeps its smallest distance.

    Returns:
        fine: counts in bins of 0.1 mm up to the limit, and one last bin for larger distances; all
            zero if there are no wrong or no correct points.
        by_frame: (frames, 41) counts in the bins of ``EDGES``.
    """
    fine = np.zeros(_FINE + 1, np.int64)
    by_frame = np.zeros((frames, len(EDGES) - 1), np.int64)
    if not wrong.points or not correct.points:
        return fine, by_frame
    low, high = wrong.bounds()
    axis = int(np.argmax(high - low))

    def add(slab: tuple[float, float]) -> None:
        low = np.full(3, -np.inf)
        high = np.full(3, np.inf)
        low[axis], high[axis] = slab
        for queries, of_frame in wrong.blocks(low, high, block):
            distance = np.full(len(queries), np.inf, np.float32)
            around = [column.astype(np.float64) for column in (queries.min(0), queries.max(0))]
            near = kernels.touching.reached(queries, math.ceil(_HALO))
            for reference, _ in correct.blocks(
                around[0] - _HALO, around[1] + _HALO, 2 * block, near
            ):
                np.minimum(distance, nearest_distance(queries, reference, LIMIT), out=distance)
            bins = np.minimum(distance.astype(np.float64) / _STEP, _FINE).astype(np.int64)
            # frames are in order
            first = int(of_frame[0])
            last = int(of_frame[-1]) + 1
            shape = last - first, by_frame.shape[1]
            coarse = (of_frame.astype(np.int64) - first) * shape[1] + bins // round(BIN / _STEP)
            counts = (
                np.bincount(bins, minlength=len(fine)),
                np.bincount(coarse, minlength=math.prod(shape)),
            )
            with lock:
                np.add(fine, counts[0], out=fine)
                by_frame[first:last] += counts[1].reshape(shape)

    lock = threading.Lock()
    kernels.each(add, _slabs(wrong, correct, axis, block))
    return fine, by_frame


def _slabs(
    wrong: PointSpool, correct: PointSpool, axis: int, size: int
) -> list[tuple[float, float]]:
    """Intervals that cover a whole axis and contain about ``size`` points each."""
    step = max(64, (wrong.points + correct.points) // size)
    sample = np.concatenate([wrong.sample(axis, step), correct.sample(axis, step)])
    count = -(-(wrong.points + correct.points) // size)
    cuts = np.unique(np.quantile(sample.astype(np.float64), np.arange(1, count) / count))
    edges = [-np.inf, *cuts.tolist(), np.inf]
    return list(itertools.pairwise(edges))


def summary(fine: I64) -> ErrorDistances:
    """Percentiles, shares and the histogram of the distances counted by ``distances``.

    All None without wrong points, or without correct points to measure to. A percentile beyond 2 m
    is None as well.
    """
    count = int(fine.sum())
    cumulative = np.cumsum(fine)

    def percentile(percent: int) -> float | None:
        index = int(np.searchsorted(cumulative, count * percent / 100))
        return round((index + 1) * _STEP, 4) if count and index < _FINE else None

    def share(metres: float) -> float | None:
        return 100.0 * float(cumulative[round(metres / _STEP) - 1]) / count if count else None

    coarse = np.append(fine[:-1].reshape(len(EDGES) - 2, -1).sum(1), fine[-1])
    return ErrorDistances(
        p10=percentile(10),
        p50=percentile(50),
        p90=percentile(90),
        within_01=share(0.1),
        within_03=share(0.3),
        within_10=share(1.0),
        histogram=tuple(coarse.tolist()) if count else None,
        count=count,
    )
