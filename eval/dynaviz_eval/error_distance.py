"""How far a wrong point lies from the right points of its kind (paper, "Metric" and Fig. 5)."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np

from dynaviz.arrays import F32, I64, Bool
from dynaviz.method import MethodInfo
from dynaviz.metric import Figure, FrameHistograms, Labelled
from dynaviz.scan import Outcome
from dynaviz.spatial.nearest import nearest_distance
from dynaviz_eval.spool import PointSpool

LIMIT = 2.0  # metres: beyond, only that a distance is larger
BIN = 0.05  # metres
_STEP = 1e-4  # metres: percentiles are rounded up to it
_HALO = LIMIT + 0.1  # metres: more than rounding can lose far from the origin
_BLOCK = 3_000_000  # points of each side in memory at once

EDGES = np.append(np.arange(round(LIMIT / BIN) + 1) * BIN, np.inf)
_FINE = round(LIMIT / _STEP)

_PAIRS = {
    "false_negative": (Outcome.FALSE_NEGATIVE, Outcome.DYNAMIC_REMOVED, "false negative to the nearest true positive"),
    "false_positive": (Outcome.FALSE_POSITIVE, Outcome.STATIC_KEPT, "false positive to the nearest true negative"),
}


class ErrorDistance:
    """Section ``error_distance``: how far wrong points lie from right ones.

    From each false negative to the nearest true positive of the whole run, and from each false positive to the nearest
    true negative. Points wait on disk until the run is over: the nearest right point may come in any later frame.
    """

    def __init__(self, info: MethodInfo) -> None:
        self._spills = {outcome: PointSpool() for wrong, right, _ in _PAIRS.values() for outcome in (wrong, right)}
        self._frames = 0
        self._by_frame: dict[str, I64] = {}

    def update(self, labelled: Labelled) -> Mapping[str, float]:
        """Put the points of one scan aside; those without finite coordinates have no distance."""
        self._frames = labelled.frame + 1
        for outcome, spill in self._spills.items():
            spill.append(labelled.frame, np.compress(labelled.outcome == outcome, labelled.scan.points, 0))
        return {}

    def finish(self) -> Mapping[str, Any]:
        """The section; the temporary files are gone afterwards."""
        section = {}
        for name, (wrong, right, _) in _PAIRS.items():
            fine, by_frame = distances(self._spills[wrong], self._spills[right], self._frames)
            section[name] = summary(fine)
            if fine.any():
                self._by_frame[name] = by_frame
        for spill in self._spills.values():
            spill.close()
        return {"error_distance": section}

    def figures(self) -> Mapping[str, Figure]:
        """Distances of the wrong points of each frame."""
        return {
            name: FrameHistograms(f"distance from a {_PAIRS[name][2]}", "m", EDGES, counts)
            for name, counts in self._by_frame.items()
        }


def distances(wrong: PointSpool, right: PointSpool, frames: int, block: int = _BLOCK) -> tuple[I64, I64]:
    """Exact distances from each wrong point to the nearest right one, as histograms.

    The world is cut into slabs across its longest side. Right points come from a slab widened by the limit, about
    ``block`` of them at a time, and a wrong point keeps the least of its distances.

    Returns:
        fine: counts by 0.1 mm up to the limit, and in the last bin of what lies farther; zero where either is empty.
        by_frame: (frames, 41) counts by ``EDGES``.
    """
    fine, by_frame = np.zeros(_FINE + 1, np.int64), np.zeros((frames, len(EDGES) - 1), np.int64)
    if not wrong.points or not right.points:
        return fine, by_frame
    low, high = wrong.bounds()
    axis = int(np.argmax(high - low))
    for left, end in _slabs(wrong, right, axis, block):
        for queries, of_frame in wrong.blocks(axis, left, end, block):
            distance = np.full(len(queries), np.inf, np.float32)
            for reference, _ in right.blocks(axis, left - _HALO, end + _HALO, block):
                near = _within(reference, queries.min(0) - _HALO, queries.max(0) + _HALO)
                np.minimum(distance, nearest_distance(queries, reference[near], LIMIT), out=distance)
            bins = np.minimum(distance.astype(np.float64) / _STEP, _FINE).astype(np.int64)
            fine += np.bincount(bins, minlength=len(fine))
            coarse = of_frame * by_frame.shape[1] + bins // round(BIN / _STEP)
            by_frame += np.bincount(coarse, minlength=by_frame.size).reshape(by_frame.shape)
    return fine, by_frame


def _slabs(wrong: PointSpool, right: PointSpool, axis: int, block: int) -> list[tuple[float, float]]:
    """Intervals along an axis that hold about as many points each, and together all of the line."""
    step = 64
    sample = np.concatenate([wrong.sample(axis, step), right.sample(axis, step)])
    count = -(-(wrong.points + right.points) // block)
    cuts = np.unique(np.quantile(sample.astype(np.float64), np.arange(1, count) / count))
    edges = [-np.inf, *cuts.tolist(), np.inf]
    return list(itertools.pairwise(edges))


def _within(points: F32, low: F32, high: F32) -> Bool:
    inside = np.ones(len(points), np.bool_)
    for axis in range(3):
        inside &= (points[:, axis] >= low[axis]) & (points[:, axis] <= high[axis])
    return inside


def summary(fine: I64) -> dict[str, Any]:
    """Percentiles, shares and the histogram of distances that were counted by ``distances``, as plain JSON values.

    All None without any wrong point, or without any right point to measure to. A percentile is None, too, where it lies
    beyond 2 m.
    """
    count = int(fine.sum())
    cumulative = np.cumsum(fine)

    def percentile(percent: int) -> float | None:
        index = int(np.searchsorted(cumulative, count * percent / 100))
        return round((index + 1) * _STEP, 4) if count and index < _FINE else None

    def share(metres: float) -> float | None:
        return 100.0 * float(cumulative[round(metres / _STEP) - 1]) / count if count else None

    coarse = np.append(fine[:-1].reshape(len(EDGES) - 2, -1).sum(1), fine[-1])
    return {
        **{f"p{percent}": percentile(percent) for percent in (10, 50, 90)},
        **{f"within_{metres}": share(metres) for metres in (0.1, 0.3, 1.0)},
        "histogram": coarse.tolist() if count else None,
        "count": count,
    }
