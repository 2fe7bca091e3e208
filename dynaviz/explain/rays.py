"""Rays of the scans that touched points, to draw.

From the sensor to the point, or beyond it where they crossed it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F32, I64, U8, Intp
from dynaviz.colours import CROSSED, GRAZED, HIT
from dynaviz.explain.point_ledger import LedgerEntry, PointLedger
from dynaviz.scores.spans import Spans, spans_of
from dynaviz.spatial.surface import GRAZING

NAMES = {
    HIT: "hit: evidence for static",
    CROSSED: "crossed: evidence for dynamic",
    GRAZED: "grazed the surface: weak evidence for dynamic",
}
STRIPS = 15  # rays drawn of a case: more would hide it
BEYOND = 40.0  # metres behind a point at which drawn rays end at the latest


Strip = tuple[tuple[float, float, float], tuple[float, float, float]]


@dataclass(frozen=True, slots=True, eq=False)
class TouchingRays:
    """Rays that touched points.

    Attributes:
        frames: (K,) int64, positions in the run.
        kinds: (K,) uint8: ``HIT``, ``CROSSED`` or ``GRAZED``.
        strips: (K, 2, 3) float32, metres, world frame: start and end.
    """

    frames: I64
    kinds: U8
    strips: F32


def rays_of(ledgers: Sequence[PointLedger], most: int | None = None) -> TouchingRays:
    """The rays of ledgers; of many the ``most``, half of them hits if there are enough of each,
    spread over scans.
    """
    found = [ray for ledger in ledgers for entry in ledger.entries for ray in _rays(ledger, entry)]
    found.sort(key=lambda ray: ray[0])
    frames = np.array([frame for frame, *_ in found], np.int64)
    kinds = np.array([kind for _, kind, *_ in found], np.uint8)
    strips = np.array([ends for *_, ends in found], np.float32).reshape(-1, 2, 3)
    if most is None or len(found) <= most:
        return TouchingRays(frames, kinds, strips)
    hits = np.flatnonzero(kinds == HIT)
    passes = np.flatnonzero(kinds != HIT)
    many = min(len(hits), max(most // 2, most - len(passes)))
    chosen = np.sort(
        np.concatenate([hits[evenly(len(hits), many)], passes[evenly(len(passes), most - many)]])
    )
    return TouchingRays(frames[chosen], kinds[chosen], strips[chosen])


def _rays(ledger: PointLedger, entry: LedgerEntry) -> list[tuple[int, int, Strip]]:
    """At most two rays of a scan: frame, class and ends."""
    x, y, z = ledger.position
    rays: list[tuple[int, int, Strip]] = []
    if entry.hits:
        rays.append((entry.frame, HIT, (entry.sensor, ledger.position)))
    if entry.crossed:
        behind = min(entry.behind_m or 0.0, BEYOND)
        kind = GRAZED if entry.angle_deg is not None and entry.angle_deg < GRAZING else CROSSED
        further = behind / max(entry.range_m, 1e-6)
        from_x, from_y, from_z = entry.sensor
        end = (
            x + (x - from_x) * further,
            y + (y - from_y) * further,
            z + (z - from_z) * further,
        )
        rays.append((entry.frame, kind, (entry.sensor, end)))
    return rays


def evenly(count: int, most: int) -> Intp:
    """At most ``most`` indices below ``count``, evenly spread."""
    if count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).round().astype(np.intp)  # more than 1 apart: all differ


def spans_of_rays(ledgers: Sequence[PointLedger]) -> Spans:
    """When scans ``hit`` and ``crossed`` the place of points.

    A scan that did both counts as what most of them met.
    """
    balance: Counter[int] = Counter()
    for entry in (
        entry for ledger in ledgers for entry in ledger.entries if entry.hits or entry.crossed
    ):
        balance[entry.frame] += (entry.hits > 0) - (entry.crossed > 0)
    hit = {frame: count >= 0 for frame, count in sorted(balance.items())}
    return {
        name: spans_of(f for f in hit if hit[f] == (name == "hit")) for name in ("hit", "crossed")
    }
