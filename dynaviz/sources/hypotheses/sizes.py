"""Whether points or positions may have another unit than metres, by their size."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from dynaviz.arrays import F64
from dynaviz.sources.hypotheses.judge import Points, Reading

FAR_POINTS = 250.0  # metres; scans whose median range is larger may have another unit
LONG_STEPS = 20.0  # metres; median way between two frames
FACTORS = {"millimetres": 1000.0, "centimetres": 100.0}
SHOWN = 3  # scans whose range is measured


def in_smaller_units(readings: Mapping[str, Reading]) -> Iterator[dict[str, Reading]]:
    """The readings in smaller units, if their sizes are not those of metres.

    Args:
        readings: of the same scans, with the same points and positions.
    """
    first = next(iter(readings.values()))
    far = reach(first.points, len(first.poses)) >= FAR_POINTS
    long = step(first.poses) >= LONG_STEPS
    for factor in FACTORS.values() if far or long else ():
        points = factor if far else 1.0
        read = _divided(first.points, points)
        for positions in (factor, 1.0) if far else (factor,):
            yield {
                name: Reading(_moved(each.poses, positions), read)
                for name, each in readings.items()
            }


def reach(points: Points, scans: int) -> float:
    """Median range of the points of some scans, given units."""
    rows = np.unique(np.linspace(0, scans - 1, SHOWN).astype(int)).tolist() if scans else []
    return float(np.median([median_range(points(row)) for row in rows])) if rows else 0.0


def median_range(points: F64) -> float:
    """Median distance of the finite points (N, 3) from zero, given units."""
    finite = points[np.isfinite(points).all(1)]
    return float(np.median(np.linalg.norm(finite, axis=1))) if len(finite) else 0.0


def step(poses: F64 | Sequence[F64]) -> float:
    """Median way from one pose (4, 4) to the next, given units."""
    ways = np.linalg.norm(np.diff(np.asarray(poses)[:, :3, 3], axis=0), axis=1)
    return float(np.median(ways)) if len(ways) else 0.0


def _divided(points: Points, factor: float) -> Points:
    return lambda row: points(row) / factor


def _moved(poses: F64, factor: float) -> F64:
    poses = poses.copy()
    poses[:, :3, 3] /= factor
    return poses
