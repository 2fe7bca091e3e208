"""Looks, slowly: angles between a direction and all returns of a scan, one place at a time."""

from __future__ import annotations

import numpy as np

from dynaviz.contracts.looks import AROUND, MARGIN, Look
from dynaviz.contracts.scan import Scan

NEAREST = 4


def spacing(scan: Scan, count: int = 400) -> float:
    """The largest angle from a direction to a return that answers for it, radians."""
    ways, _ = directions(scan)
    chosen = np.random.default_rng(0).choice(len(ways), min(count, len(ways)), replace=False)
    return 1.5 * float(
        np.median([np.partition(chords(ways, ways[i]), NEAREST - 1)[NEAREST - 1] for i in chosen])
    )


def directions(scan: Scan, origin: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors and ranges of the returns of a scan."""
    away = scan.points.astype(float) - (scan.position if origin is None else origin)
    away = away[np.isfinite(away).all(1)]
    ranges = np.linalg.norm(away, axis=1)
    near = ranges > 0.05
    return away[near] / ranges[near, None], ranges[near]


def chords(ways: np.ndarray, way: np.ndarray) -> np.ndarray:
    return np.linalg.norm(ways - way, axis=1)


def look(
    scan: Scan, places: np.ndarray, cap: float, normals: np.ndarray | None = None
) -> np.ndarray:
    """(K,) the ``Look`` of a scan with one origin at each place."""
    ways, ranges = directions(scan)
    found = np.full(len(places), Look.OUTSIDE)
    for k, place in enumerate(places.astype(float)):
        away = place - scan.position
        distance = np.linalg.norm(away)
        gaps = chords(ways, away / distance)
        nearest = np.argsort(gaps)[:NEAREST]
        ends = ranges[nearest[gaps[nearest] < cap]]
        if not len(ends):
            if len(gaps) and gaps.min() <= np.radians(AROUND):
                found[k] = Look.BETWEEN
        elif (np.abs(ends - distance) < MARGIN).any():
            found[k] = Look.HIT
        elif (ends > distance).any():
            slope = 1.0 if normals is None else abs(normals[k] @ away) / distance
            found[k] = Look.GRAZING if slope < np.sin(np.radians(20)) else Look.THROUGH
        else:
            found[k] = Look.HIDDEN
    return found
