"""HMM-MOS on dictionaries, one voxel at a time; slow."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.spatial import cKDTree

Key = tuple[int, int, int]
CUBE = list(product((-1, 0, 1), repeat=3))
UNKNOWN, OCCUPIED, FREE = 0, 1, 2
EPS = 0.005
# columns: from unknown, occupied, free; rows: to
A = np.array([[1 - 2 * EPS, 0, 0], [EPS, 1 - EPS, EPS], [EPS, EPS, 1 - EPS]])


@dataclass
class Voxel:
    belief: np.ndarray
    state: int = UNKNOWN
    changed: int = 0  # scan of the last change between occupied and free
    since: int = 0  # scan of the last change of any kind
    seen: int = 0


def line(start: Key, end: Key) -> list[Key]:
    """The voxels of an integer line, both ends included."""
    d = [abs(e - s) for s, e in zip(start, end, strict=True)]
    g = [1 if s < e else -1 for s, e in zip(start, end, strict=True)]
    m, c, voxels = max(d), list(start), []
    r = [m // 2] * 3
    for _ in range(m + 1):
        voxels.append(tuple(c))
        for axis in range(3):
            r[axis] -= d[axis]
            if r[axis] < 0:
                r[axis] += m
                c[axis] += g[axis]
    return voxels


def look(belief: np.ndarray, squared: float) -> np.ndarray:
    """The beliefs after a look; squared distance from the nearest source in voxels."""
    likelihood = math.exp(-squared / 2)
    x = np.array([0, likelihood, 1 - likelihood]) * (A @ belief)
    return x / x.sum()


def otsu(values: list[int], bins: int = 100) -> float:
    low, high = min(values), max(values)
    if low == high:
        return 0.0
    histogram = [0] * bins
    for w in values:
        b = math.ceil((w - low) / ((high - low) / bins)) - 1
        histogram[0 if w - low < 0.001 else bins - 1 if high - w < 0.001 else b] += 1
    total, moment = sum(histogram), sum(j * n for j, n in enumerate(histogram))
    below, below_moment, best, level = 0, 0.0, 0.0, 0
    for j in range(bins):
        above = total - below
        if below and above:
            between = below * above * (below_moment / below - (moment - below_moment) / above) ** 2
            if between >= best:
                best, level = between, j
        below += histogram[j]
        below_moment += j * histogram[j]
    return low + level * (high - low) / bins


class Reference:
    def __init__(self, params):
        self.p, self.scan, self.map = params, -1, {}
        self.before, self.window, self.last, self.threshold = [], [], set(), 0.0

    def key(self, point) -> Key:
        rounded = math.trunc if self.p.port else math.floor
        return tuple(rounded(float(c) / self.p.resolution) for c in point)

    def away(self, key: Key, origin) -> float:
        """Squared distance of a voxel's corner from the sensor, square metres."""
        return sum((k * self.p.resolution - c) ** 2 for k, c in zip(key, origin, strict=True))

    def observe(self, scan) -> list[str]:
        """The reason of each point."""
        p, origin = self.p, scan.position
        self.scan += 1
        used = [
            np.isfinite(q).all()
            and sum((float(a) - b) ** 2 for a, b in zip(q, origin, strict=True)) > p.min_range**2
            for q in scan.points
        ]
        keys = [self.key(q) if u else None for q, u in zip(scan.points, used, strict=True)]
        hit = sorted({key for key in keys if key is not None})
        self.filter(self.rays(hit, origin), hit)
        self.before = hit
        near = [key for key in hit if self.away(key, origin) <= p.max_range**2]
        self.forget(origin)
        codes = self.judge(near)
        return [codes.get(key, "out_of_range") for key in keys]

    def rays(self, hit: list[Key], origin) -> list[Key]:
        start = tuple(math.floor(c / self.p.resolution) for c in origin)
        cells = {cell for end in hit for cell in line(start, end)}
        size = self.p.resolution
        return [
            c
            for c in cells
            if sum(((a - b) * size) ** 2 for a, b in zip(c, start, strict=True))
            <= self.p.max_range**2
        ]

    def filter(self, observed: list[Key], hit: list[Key]) -> None:
        if not observed:
            return
        distances, _ = cKDTree(np.array(hit + self.before)).query(np.array(observed))
        for key, distance in zip(observed, distances, strict=True):
            voxel = self.map.setdefault(key, Voxel(np.array([1.0, 0, 0])))
            voxel.belief, voxel.seen = look(voxel.belief, round(distance**2)), self.scan
            best = FREE if voxel.belief[FREE] > voxel.belief[OCCUPIED] else OCCUPIED
            if voxel.belief[best] > self.p.belief and best != voxel.state:
                if voxel.state != UNKNOWN:
                    voxel.changed = self.scan
                voxel.state, voxel.since = best, self.scan

    def forget(self, origin) -> None:
        p = self.p
        for key, voxel in list(self.map.items()):
            old = voxel.seen < self.scan - p.forget_after and not (
                p.port and voxel.seen <= p.forget_after
            )
            if old or self.away(key, origin) > (1.5 * p.max_range) ** 2:
                del self.map[key]

    def judge(self, hit: list[Key]) -> dict[Key, str]:
        p = self.p
        if self.scan <= p.window:
            self.window = [*self.window, {}][-p.window :]
            return dict.fromkeys(hit, "warm_up")
        occupied = set(hit)
        known = {key: self.known_around(key) for key in hit}
        raw = {key: max(self.score(key, occupied), 0) for key in hit}
        self.window = [*self.window, {key: self.median(key, raw) for key in hit}][-p.window :]
        sums = {key: sum(medians.get(key, 0) for medians in self.window) for key in hit}
        self.threshold = otsu(list(sums.values())) if sums else 0.0
        differ = len(set(sums.values())) > 1
        above = {key for key in hit if differ and sums[key] > self.threshold}
        carried = {key for key in hit if key in self.last and sums[key] > p.min_score}
        grown = {key for key in hit if above.union(carried) & set(self.around(key))}
        self.last = grown
        return {key: self.reason(key, sums[key], known[key], above, carried, grown) for key in hit}

    def around(self, key: Key) -> list[Key]:
        return [(key[0] + x, key[1] + y, key[2] + z) for x, y, z in CUBE]

    def cube(self, key: Key) -> list[Key]:
        half = self.p.kernel // 2
        reach = range(-half, half + 1)
        return [(key[0] + x, key[1] + y, key[2] + z) for x, y, z in product(reach, repeat=3)]

    def sure(self, key: Key) -> bool:
        voxel = self.map.get(key)
        return (
            voxel is not None
            and voxel.state != UNKNOWN
            and self.scan - voxel.seen < self.p.forget_after
        )

    def known_around(self, key: Key) -> int:
        return sum(self.sure(other) for other in self.cube(key))

    def score(self, key: Key, occupied: set[Key]) -> int:
        total = 0
        for other in self.cube(key):
            if not self.sure(other):
                total -= 1
            elif self.map[other].changed == self.scan and other in occupied:
                total += 1
        return total

    def median(self, key: Key, raw: dict[Key, int]) -> int:
        return int(np.median([raw[other] for other in self.around(key) if other in raw]))

    def reason(self, key: Key, total: int, known: int, above, carried, grown) -> str:
        p, voxel = self.p, self.map.get(key)  # None if it is within range, but its index is not
        if key in grown and self.threshold <= p.min_score:
            return "scan_undecided"
        for reason, chosen in (
            ("above_threshold", above),
            ("carried", carried),
            ("beside_dynamic", grown),
        ):
            if key in chosen:
                return reason
        if total > 0:
            return "below_threshold"
        if 2 * known < p.kernel**3:
            return "unknown_around"
        if voxel is not None and voxel.state == OCCUPIED and self.scan - voxel.since >= p.window:
            return "long_occupied"
        return "no_change"
