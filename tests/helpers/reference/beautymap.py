"""A slow, simple BeautyMap: a dictionary of columns, sets of slices, one point after another."""

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
        self.slices = {
            c: {self.slice(c, z) for z in heights} - {None} for c, heights in self.members.items()
        }
        self.removed, self.split = defaultdict(set), defaultdict(set)

    def column(self, p):
        return tuple(math.floor((p[a] - self.corner[a]) / self.side) for a in (0, 1))

    def slice(self, c, z):
        k = int((z - self.base[c]) / self.height)  # towards 0
        return None if k < 0 else min(k, TOP)

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
        self.seen = defaultdict(set)
        slope = -math.inf
        for p in points:
            if self.column(p) in self.base:
                self.seen[self.column(p)] |= {self.slice(self.column(p), p[2])} - {None}
            away = math.hypot(p[0] - sensor[0], p[1] - sensor[1])
            if away > 0:
                slope = max(slope, (p[2] - sensor[2]) / away)
        self.here = self.column(sensor)
        self.sensor_base = self.base.get(self.here, self.points[:, 2].min())
        self.view = (sensor[2] - self.sensor_base) / self.height + 0.5
        self.rise = slope * self.side / self.height
        for c, slices in self.slices.items():
            if all(-self.half <= c[a] - self.here[a] < self.half for a in (0, 1)):
                gone = {k for k in slices if self.goes(c, k)}
                self.removed[c] |= gone
                if gone:
                    self.split[c].add(min(gone) - 1)

    def goes(self, c, k):
        di, dj = c[0] - self.here[0], c[1] - self.here[1]
        blind = int(2 / self.side) + 1
        seen = self.seen[c]
        if k in seen:
            return False
        if -blind <= di < blind and -blind <= dj < blind:
            return False
        if 0 not in seen and di**2 + dj**2 >= (15 / self.side) ** 2:
            return False
        above = max(seen, default=0)
        if above == 0 or c in self.raised:
            above = int(self.view + math.sqrt(di**2 + dj**2) * self.rise + 0.5)
        if k >= above or k == min(self.slices[c]) or gap_below(self.slices[c], k):
            return False
        return not self.blocked(di, dj, k)

    def blocked(self, di, dj, k):
        """Whether the line from the sensor to (di, dj) is blocked.

        X and y are columns from the edge of the window.
        """
        n, a = max(abs(di), abs(dj)), self.half
        step = di / n, dj / n
        x, y, t = a, a, 0.0
        while True:
            x, y, t = x + step[0], y + step[1], t + math.sqrt(step[0] ** 2 + step[1] ** 2)
            if not (0 < x < 2 * a and 0 < y < 2 * a):
                return False
            if int(abs(x - a)) + int(abs(y - a)) <= 3:
                continue
            at = int(x) - a + self.here[0], int(y) - a + self.here[1]
            if self.seen[at]:
                part = t / math.sqrt(di**2 + dj**2)
                height = self.base[at] - self.sensor_base + (k - self.view) * part + self.view + 0.5
                if int(height) in self.seen[at]:
                    return True
            if abs(x - a - di) <= 1 and abs(y - a - dj) <= 1:
                return False

    def fine_bin(self, c, k, z):
        return int((z - self.base[c] - k * self.height) / self.fine)  # towards 0

    def label(self, p):
        p = np.asarray(p, float)
        c = self.column(p)
        k = self.slice(c, p[2])
        if k in self.removed[c]:
            return True
        if k is None or k not in self.split[c]:
            return False
        bins = [self.fine_bin(c, k, z) for z in self.members[c] if self.slice(c, z) == k]
        there = {f for f in bins if f >= 0}
        there = {f for f in there if not gap_below(there, f)}
        ground = [f for f in sorted(there) if sum(0 <= b <= f for b in bins) >= 0.85 * len(bins)]
        return bool(ground) and self.fine_bin(c, k, p[2]) in {f for f in there if f > ground[0]}


def gap_below(numbers, k):
    """Whether two consecutive numbers between the least and k are missing."""
    return any(b - a > 2 for a, b in pairwise(sorted(n for n in numbers if n <= k)))
