"""Whether poses are late or early by a constant time: as the delay of a filter, or leap seconds.

Each delay is tried on pairs of scans; with the right one, the scans of a pair coincide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F64
from dynaviz.sources.hypotheses.views import ScanView
from dynaviz.spatial import geometry
from dynaviz.spatial.trajectory import PosesOverTime

SHORT = np.round(np.arange(-10, 11) * 0.1, 3)  # seconds
KNOWN = (-37.0, -27.0, -19.0, -18.0, 18.0, 19.0, 27.0, 37.0)  # leap seconds, and those of TAI
FINE = np.round(np.arange(-4, 5) * 0.02, 3)  # seconds around the best one
SAME = 0.03  # overlap by which a known delay may be worse than one near it
POINTS = 2500  # of a scan


@dataclass(frozen=True)
class Delay:
    """The delay that fits best.

    Attributes:
        seconds: positive if poses are late.
        given, overlap: mean share of a scan on the surfaces of the other one of its pair, with the
            given times and with this delay.
    """

    seconds: float
    given: float
    overlap: float


def estimate_delay(pairs: Sequence[tuple[ScanView, ScanView]], path: PosesOverTime) -> Delay | None:
    """The delay with which the scans of pairs coincide best; None without times.

    Args:
        pairs: placed by the given poses.
        path: the poses over time, by which they were placed.
    """
    timed = [(a, b) for a, b in pairs if a.stamp is not None and b.stamp is not None]
    if not timed:
        return None
    given = overlap_with(timed, path, 0.0)
    found = {d: overlap_with(timed, path, d) for d in (*SHORT.tolist(), *KNOWN)}
    coarse = max(found, key=lambda d: found[d])
    around = {coarse + d: overlap_with(timed, path, coarse + d) for d in FINE.tolist()}
    best = max(around, key=lambda d: around[d])
    if coarse in KNOWN and around[best] - around[coarse] < SAME:
        best = coarse
    return Delay(round(best, 3), given, around[best])


def overlap_with(
    pairs: Sequence[tuple[ScanView, ScanView]], path: PosesOverTime, seconds: float
) -> float:
    """Mean overlap with a delay; zero if poses do not cover the scans then."""
    first, last = path.span
    shift = round(seconds * 1e9)
    shares = []
    for a, b in pairs:
        stamps = np.array([a.stamp, b.stamp], np.int64) + shift
        if stamps.min() < first or stamps.max() > last:
            continue
        here, there = path.at(stamps)
        points = b.points[:: 1 + len(b.points) // POINTS]
        move: F64 = a.T @ geometry.inverse(here) @ there @ geometry.inverse(b.T)
        shares.append(a.surface.overlap(geometry.apply(move, points)))
    return float(np.mean(shares)) if len(shares) >= max(1, len(pairs) // 2) else 0.0
