"""A slow, simple OctoMap: a dict of log-odds, and a voxel traversal in double precision."""

from __future__ import annotations

import math

import numpy as np

from dynaviz.contracts.scan import Scan

Key = tuple[int, int, int]


def key(point: np.ndarray, resolution: float) -> Key:
    return tuple(math.floor(float(c) * (1.0 / resolution)) for c in point)


def walk(origin: np.ndarray, end: np.ndarray, resolution: float) -> list[Key]:
    """Voxels from the origin's up to, not including, the end's (Amanatides and Woo 1987).

    Ties in the order z, y, x.
    """
    o, e = ([float(c) * (1.0 / resolution) for c in p] for p in (origin, end))
    k, goal = list(key(origin, resolution)), key(end, resolution)
    d = [e[a] - o[a] for a in range(3)]
    crossed = []
    while tuple(k) != goal:
        crossed.append(tuple(k))
        times = [
            math.inf if k[a] == goal[a] else ((k[a] + (d[a] > 0)) - o[a]) / d[a] for a in range(3)
        ]
        axis = min((2, 1, 0), key=lambda a: times[a])
        k[axis] += 1 if d[axis] > 0 else -1
    return crossed


class Reference:
    def __init__(
        self,
        resolution: float,
        hit: float = 0.7,
        miss: float = 0.4,
        low: float = 0.12,
        high: float = 0.97,
    ):
        self.resolution = resolution
        self.hit, self.miss, self.low, self.high = (
            np.float32(math.log(p / (1 - p))) for p in (hit, miss, low, high)
        )
        self.log_odds: dict[Key, np.float32] = {}
        self.ever_crossed: set[Key] = set()

    def observe(self, scan: Scan) -> None:
        free, occupied = set(), set()
        for n, point in enumerate(scan.points):
            if not np.isfinite(point).all():
                continue
            free.update(walk(scan.origins[n % len(scan.origins)], point, self.resolution))
            occupied.add(key(point, self.resolution))
        for k in free:
            self.log_odds[k] = max(self.log_odds.get(k, np.float32(0)) + self.miss, self.low)
        for k in occupied:
            self.log_odds[k] = min(self.log_odds.get(k, np.float32(0)) + self.hit, self.high)
        self.ever_crossed |= free

    def label(self, scan: Scan) -> np.ndarray:
        found = [
            np.isfinite(p).all() and self.log_odds[key(p, self.resolution)] < 0 for p in scan.points
        ]
        return np.array(found, bool)
