"""A slow, simple DUFOMap: sets of voxels, and voxel traversal in double precision."""

from __future__ import annotations

import math
from itertools import product

import numpy as np

from dynaviz.contracts.scan import Scan

Key = tuple[int, int, int]


def key(point: np.ndarray, resolution: float) -> Key:
    return tuple(math.floor(float(c) * (1.0 / resolution)) for c in point)


class Walk:
    """Voxels along a ray; start and direction in voxels. Ties in the order x, y, z."""

    def __init__(self, start: list[float], direction: list[float]):
        self.start, self.direction = start, direction
        self.voxel = [math.floor(s) for s in start]

    def next(self) -> tuple[int, float]:
        """The axis of the next border, and its distance from the start."""
        borders = [k + (d > 0) for k, d in zip(self.voxel, self.direction, strict=True)]
        away = [
            (b - s) / d if d else math.inf
            for b, s, d in zip(borders, self.start, self.direction, strict=True)
        ]
        axis = min(range(3), key=lambda a: away[a])
        return axis, away[axis]

    def step(self) -> int:
        axis, _ = self.next()
        self.voxel[axis] += 1 if self.direction[axis] > 0 else -1
        return axis


class Reference:
    def __init__(
        self, resolution=0.1, hit_margin=0.2, unknown_margin=1, min_range=0.2, max_range=math.inf
    ):
        self.resolution, self.hit_margin, self.unknown_margin = (
            resolution,
            hit_margin / resolution,
            unknown_margin,
        )
        self.min_range, self.max_range = min_range, max_range
        self.seen_free: set[Key] = set()
        self.crossed: set[Key] = set()

    def observe(self, scan: Scan) -> None:
        rays = {
            (tuple(scan.origins[n % len(scan.origins)]), key(p, self.resolution))
            for n, p in enumerate(scan.points)
            if self.min_range
            < np.linalg.norm(p - scan.origins[n % len(scan.origins)])
            < self.max_range
        }
        lines = []
        for origin, goal in rays:
            o = [float(c) * (1.0 / self.resolution) for c in origin]
            away = [k + 0.5 - c for k, c in zip(goal, o, strict=True)]
            length = math.sqrt(sum(a * a for a in away))
            lines.append(
                (o, [k + 0.5 for k in goal], [a / length if length else 0.0 for a in away], length)
            )
        self.hit = {k for line in lines for k in self.hits_of(*line)}
        self.observed = {k for line in lines for k in self.observed_of(*line)}
        around = list(product(range(-self.unknown_margin, self.unknown_margin + 1), repeat=3))
        self.void = {
            k
            for k in self.observed - self.hit
            if all((k[0] + x, k[1] + y, k[2] + z) in self.observed for x, y, z in around)
        }
        self.seen_free |= self.void
        self.crossed |= self.observed - self.hit

    def hits_of(self, o, goal, direction, length) -> list[Key]:
        walk = Walk(goal, [-d for d in direction])
        hits = [tuple(walk.voxel)]
        while walk.next()[1] <= min(self.hit_margin, length):
            walk.step()
            hits.append(tuple(walk.voxel))
        return hits

    def observed_of(self, o, goal, direction, length) -> list[Key]:
        walk = Walk(o, direction)
        observed = [tuple(walk.voxel)]
        while observed[-1] not in self.hit:
            walk.step()
            observed.append(tuple(walk.voxel))
        farther = [0, 0, 0]
        while length and max(farther) < self.unknown_margin:
            farther[walk.step()] += 1
            observed.append(tuple(walk.voxel))
        return observed

    def label(self, scan: Scan) -> np.ndarray:
        return np.array([key(p, self.resolution) in self.seen_free for p in scan.points], bool)
