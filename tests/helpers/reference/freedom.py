"""FreeDOM on dictionaries, one voxel, ray and point at a time, without rays into the sky; slow."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from itertools import product

import numpy as np

Key = tuple[int, int, int]
CUBE = [offset for offset in product((-1, 0, 1), repeat=3) if any(offset)]


@dataclass
class Voxel:
    is_free: bool = False
    free_count: int = 0
    hit_count: int = 0


@dataclass
class Entry:
    scan: int
    level: int
    raised: bool = False


def around(key: Key) -> list[Key]:
    return [(key[0] + x, key[1] + y, key[2] + z) for x, y, z in CUBE]


def block(key: Key) -> Key:
    return tuple(k // 8 for k in key)


class Reference:
    def __init__(self, params):
        self.p, self.size, self.scan = params, 4 * params.sub_voxel, -1
        self.voxels: defaultdict[Key, Voxel] = defaultdict(Voxel)
        self.blocks: dict[Key, set[Key]] = {}  # recorded blocks, and their free voxels
        self.map: defaultdict[Key, dict[Key, Entry]] = defaultdict(dict)  # by voxel and sub-voxel
        self.seen, self.often, self.revoked = set(), set(), set()

    def key(self, point, size: float) -> Key:
        return tuple(math.floor(float(c) * (1.0 / size)) for c in point)

    def inside(self, point, origin) -> bool:
        away = point.astype(float) - origin
        return self.p.min_range <= np.linalg.norm(away) <= self.p.max_range and (
            self.p.min_height <= away[2] <= self.p.max_height
        )

    def observe(self, scan) -> list[int]:
        """The level of each point in its scan."""
        self.scan += 1
        groups: defaultdict[Key, list] = defaultdict(list)
        keys = [
            self.key(q, self.size) if self.inside(q, scan.position) else None for q in scan.points
        ]
        for point, key in zip(scan.points, keys, strict=True):
            if key is not None:
                groups[key].append(point.astype(float))
        levels = self.grown(self.hit(list(groups)), 3, set(groups))
        for key in self.lost:
            for other in [key, *around(key)]:
                self.revoke(other)
        crossed = {
            c
            for points in groups.values()
            for c in self.walk(scan.position, np.mean(points, 0), groups)
        }
        self.take_back(self.free(crossed))
        for point, key in zip(scan.points, keys, strict=True):
            if key is not None:
                self.insert(key, self.key(point, self.p.sub_voxel), levels.get(key, 0))
        return [levels.get(key, 0) for key in keys]

    def hit(self, keys: list[Key]) -> dict[Key, int]:
        seeds, self.lost = {}, []
        for key in keys:
            if block(key) not in self.blocks:
                continue
            voxel = self.voxels[key]
            voxel.hit_count, voxel.free_count = voxel.hit_count + 1, 0
            if voxel.is_free:
                seeds[key] = 3
            if voxel.hit_count >= self.p.counts_to_revert:
                self.lost.append(key)
        return seeds

    def revoke(self, key: Key) -> None:
        if self.voxels[key].is_free:
            self.voxels[key].is_free = False
            self.revoked.add(key)
            self.blocks[block(key)].discard(key)

    def grown(self, seeds: dict[Key, int], steps: int, allowed) -> dict[Key, int]:
        levels, front = dict(seeds), list(seeds)
        for step in range(steps):
            front = list(
                dict.fromkeys(
                    o for key in front for o in around(key) if o in allowed and o not in levels
                )
            )
            levels |= dict.fromkeys(front, 2 if step == 0 else 1)
        return levels

    def walk(self, origin, target, occupied) -> list[Key]:
        u = np.array(target) - origin
        low, high = (
            max(self.p.min_height, self.p.ray_min_height),
            min(self.p.max_height, self.p.ray_max_height),
        )
        reach = min(self.p.max_range, self.p.ray_range)
        if not (u @ u <= reach**2 and low < u[2] < high):
            u = u * min(
                reach / math.sqrt(u @ u), high / u[2] if u[2] > 0 else low / u[2] if u[2] < 0 else 1
            )
        cell, step, at, period = list(self.key(origin, self.size)), [], [], []
        for axis in range(3):
            step.append(int(np.sign(u[axis])))
            period.append(self.size / abs(u[axis]) if u[axis] else 1.0)
            first = -math.fmod(origin[axis], self.size) / u[axis] if u[axis] else 1.0
            late = first < 0 or (first == 0 and u[axis] > 0 and not self.p.port)
            at.append(first + period[axis] if late else first)
        cells = []
        while tuple(cell) not in occupied:
            cells.append(tuple(cell))
            x, y, z = at
            axis = 0 if x < y and x < z else 1 if y < z else 2
            cell[axis] += step[axis]
            at[axis] += period[axis]
            if min(at) >= 1:
                break
        return cells

    def free(self, crossed: set[Key]) -> list[Key]:
        self.seen |= crossed
        whole = {b for b, free in self.blocks.items() if len(free) == 512}
        candidates = []
        for key in crossed:
            self.blocks.setdefault(block(key), set())
            if self.p.port and block(key) in whole:
                continue
            voxel = self.voxels[key]
            voxel.free_count, voxel.hit_count = voxel.free_count + 1, 0
            if voxel.free_count >= self.p.counts_to_free:
                self.often.add(key)
                if not voxel.is_free:
                    candidates.append(key)
        new = [key for key in candidates if all(self.clear(other) for other in around(key))]
        for key in new:
            self.voxels[key].is_free = True
            self.blocks[block(key)].add(key)
        self.revoked -= set(new)
        return new

    def clear(self, key: Key) -> bool:
        return key in self.voxels and self.voxels[key].free_count >= self.p.counts_to_free

    def take_back(self, new: list[Key]) -> None:
        of_scan: defaultdict[int, set[Key]] = defaultdict(set)  # voxels by the scans they hold
        for key, entries in self.map.items():
            for entry in entries.values():
                of_scan[entry.scan].add(key)
        for scan, keys in of_scan.items():
            seeds = {key: 3 for key in new if key in keys}
            for key, level in self.grown(seeds, 2 if self.p.port else 3, keys).items():
                for entry in self.map[key].values():
                    if entry.scan == scan and level > entry.level:
                        entry.level, entry.raised = level, True

    def insert(self, key: Key, sub: Key, level: int) -> None:
        entry = self.map[key].get(sub)
        if entry is None or (entry.scan != self.scan and entry.level > level):
            self.map[key][sub] = Entry(self.scan, level)

    def label(self, scan, own: list[int]) -> list[str]:
        """The reason of each point; ``own`` are the levels that ``observe`` returned."""
        return [self.reason(q, level) if self.inside(q, scan.position) else "out_of_range"
                for q, level in zip(scan.points, own, strict=True)]  # fmt: skip

    def reason(self, point, own: int) -> str:
        key = self.key(point, self.size)
        entry = self.map[key][self.key(point, self.p.sub_voxel)]
        if entry.level:
            names = (
                ("grown_in_map", "turned_free")
                if entry.raised
                else ("grown_in_scan", "in_free_space")
            )
            return names[entry.level == 3]
        if own:
            return "retaken"
        for name, voxels in (
            ("revoked", self.revoked),
            ("beside_unclear", self.often),
            ("seen_too_rarely", self.seen),
        ):
            if key in voxels:
                return name
        return "never_seen_through"
