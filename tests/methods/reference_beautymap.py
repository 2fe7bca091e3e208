"""BeautyMap, slow and obvious: a dictionary of columns, sets of slices, one point after another."""

from __future__ import annotations

import math
from collections import defaultdict
from itertools import pairwise
from statistics import median

import numpy as np

TOP = 30


class Reference:
    def __init__(self, points, dis_range, side, height):
        self.side, self.height, self.fine = side, height, max(0.1, height / 31)
        self.half = int(dis_range / side / 2)
        self.points = np.asarray(points, float)
        self.corner = self.points[:, :2].min(0)
        self.members = defaultdict(list)
        for p in self.points:
            self.members[self.column(p)].append(p[2])
        self.base, self.raised = {}, set()
        for c in sorted(self.members):
            self.base[c] = self.level(c)
        self.slices = {c: {self.slice(c, z) for z in heights} for c, heights in self.members.items()}
        self.removed = defaultdict(set)

    def column(self, p):
        return tuple(math.floor((p[a] - self.corner[a]) / self.side) for a in (0, 1))

    def slice(self, c, z):
        return min(max(math.floor((z - self.base[c]) / self.height), 0), TOP)

    def level(self, c):
        low = min(self.members[c])
        before = [(c[0] - a, c[1] - b) for a in range(1, 6) for b in range(1, 6)]
        near = [self.base[n] for n in before if n in self.base]
        if len(near) < 15:
            return low
        middle = median(near)
        spread = 3 * median(abs(z - middle) for z in near)
        if low < middle - spread:
            self.raised.add(c)
        return min(max(low, middle - spread), middle + spread)

    def observe(self, points, sensor):
        points = np.asarray(points, float)
        seen = defaultdict(set)
        slope = -math.inf
        for p in points:
            if self.column(p) in self.base:
                seen[self.column(p)].add(self.slice(self.column(p), p[2]))
            away = math.hypot(p[0] - sensor[0], p[1] - sensor[1])
            if away > 2:
                slope = max(slope, (p[2] - sensor[2]) / away)
        here = self.column(sensor)
        for c, slices in self.slices.items():
            if all(-self.half <= c[a] - here[a] < self.half for a in (0, 1)):
                self.removed[c] |= {k for k in slices if self.goes(c, k, seen, sensor, here, slope)}

    def goes(self, c, k, seen, sensor, here, slope):
        di, dj = c[0] - here[0], c[1] - here[1]
        blind = int(2 / self.side) + 1
        away = math.hypot(di, dj) * self.side
        if k in seen[c]:
            return False
        if -blind <= di < blind and -blind <= dj < blind:
            return False
        if 0 not in seen[c] and away >= 15:
            return False
        above = max(seen[c], default=0)
        if above == 0 or c in self.raised:
            above = math.floor((sensor[2] - self.base[c] + away * slope) / self.height)
        if k >= above or k == min(self.slices[c]):
            return False
        below = sorted(b for b in self.slices[c] if b <= k)
        if any(b - a > 2 for a, b in pairwise(below)):
            return False
        return not self.blocked(di, dj, k, seen, sensor, here, blind)

    def blocked(self, di, dj, k, seen, sensor, here, skip):
        if here not in self.base:
            return False
        start = (sensor[2] - self.base[here]) / self.height
        n = max(abs(di), abs(dj))
        for s in range(skip, n):
            at = here[0] + di * s // n, here[1] + dj * s // n
            if math.floor(start * (1 - s / n) + (k + 0.5) * (s / n) + 0.5) in seen[at]:
                return True
        return False

    def fine_bin(self, c, k, z):
        return max(math.floor((z - self.base[c] - k * self.height) / self.fine), 0)

    def label(self, p):
        p = np.asarray(p, float)
        c = self.column(p)
        k, removed = self.slice(c, p[2]), self.removed[c]
        if k in removed:
            return True
        if not removed or k != min(removed) - 1:
            return False
        bins = sorted(self.fine_bin(c, k, z) for z in self.members[c] if self.slice(c, z) == k)
        last = bins[math.ceil(0.85 * len(bins) - 1e-9) - 1]  # the bin in which 85 % of the points are reached
        return self.fine_bin(c, k, p[2]) > last
