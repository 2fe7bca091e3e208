"""A slow, simple SeeThrough: dicts of voxels, sets of neighbours, and a flood fill."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from fractions import Fraction
from itertools import product

import numpy as np

from dynaviz.contracts.scan import Scan
from dynaviz.kernels.ground_height import FELLOWS
from dynaviz_methods import seethrough, staying, trails
from dynaviz_methods.ground_height import (
    ACROSS,
    AROUND,
    LAYER,
    LAYERED,
    MANY,
    NEAR,
    OFF,
    PIT,
    SLOPE,
    SQUARE,
    STEEP,
    SWAY,
)
from dynaviz_methods.judgement import FEW, LEAVES, LEFT, PROOF, RARELY, STAYS, STAYS_SURE, SURE, WAITED_FOR
from dynaviz_methods.seethrough import (
    EMPTY,
    FIRM,
    HIGHEST,
    LEAST,
    LEVEL,
    STANDS_OUT,
    TALL,
    UNDER,
    UNTOUCHED,
    SeeThroughParams,
)
from dynaviz_methods.staying import UNSEEN
from dynaviz_methods.trails import AT_ONCE, BEFORE, LATELY
from helpers.reference.octomap import Key, key, walk


class Reference:
    def __init__(self, params: SeeThroughParams):
        self.params = params
        self.hits: Counter[Key] = Counter()
        self.passed: Counter[Key] = Counter()
        self.clear: Counter[Key] = Counter()
        # Voxels seen clear between two hits, and since their last hit.
        self.between: set[Key] = set()
        self.after: set[Key] = set()
        self.layers: dict[tuple[int, int], dict[int, list[float]]] = {}
        # By quarter column: the last scan with a dynamic object, the number of scans in which it was dynamic, and the
        # first scan with one, for ``label`` and for ``observe``. Then the last and first scans with points that are not
        # low, and the last with dynamic points.
        self.movers: dict[tuple[int, int], tuple[int, int, int]] = {}
        self.so_far: dict[tuple[int, int], tuple[int, int, int]] = {}
        self.seen: dict[tuple[int, int], int] = {}
        self.first: dict[tuple[int, int], int] = {}
        self.dynamic: dict[tuple[int, int], int] = {}
        # By quarter column, the number of scans with points that are not low; by square, the first and last with any.
        self.scans: Counter[tuple[int, int]] = Counter()
        self.viewed: dict[tuple[int, int], tuple[int, int]] = {}
        self.observed = self.labelled = 0

    def observe(self, scan: Scan) -> None:
        size, reach = self.params.resolution, round(self.params.guard / self.params.resolution)
        goals = {key(p, size) for p in scan.points if np.isfinite(p).all()}
        crossed: set[Key] = set()
        for goal in goals:
            centre = ((np.array(goal, np.int32) + 0.5) * size).astype(np.float32)
            crossed.update(walk(scan.origins[0], centre, size))
        near = {near for k in goals for near in product(*(range(c - reach, c + reach + 1) for c in k))}
        self.passed.update(crossed - goals)
        self.clear.update(crossed - near)
        self.between |= self.after & goals
        self.after = (self.after | {k for k in crossed - near if self.hits[k]}) - goals
        for k in goals:
            self.hits[k] += 1
        for p in scan.points:
            if np.isfinite(p).all():
                x, y, z = key(p, size)
                self.layers.setdefault((x >> 3, y >> 3), {}).setdefault(z, []).append(round(float(p[2]) * 1000))
        _, places, dynamic = self.judge(scan, self.observed, self.so_far)
        self.seen |= dict.fromkeys(places, self.observed)
        self.first = dict.fromkeys(places, self.observed) | self.first
        self.dynamic |= dict.fromkeys(dynamic, self.observed)
        self.scans.update(places)
        for square in {self.square(self.quarter(k)) for k in goals}:
            self.viewed[square] = (self.viewed.get(square, (self.observed, 0))[0], self.observed)
        self.observed += 1

    def floor(self, column: tuple[int, int]) -> float:
        layers = self.layers.get(column, {})
        least = max(3, int(0.03 * sum(map(len, layers.values()))))
        pairs = {z: layers[z] + layers.get(z - 1, []) for z in layers}
        # A single layer may also be the lower one of a pair.
        pairs |= {z + 1: layers[z] for z in layers if z + 1 not in layers}
        enough = [z for z in sorted(pairs) if len(pairs[z]) >= least]
        if not enough:
            return math.inf
        best = max(range(enough[0], enough[0] + 4), key=lambda z: (len(pairs.get(z, [])), -z))
        return sum(pairs[best]) / len(pairs[best]) / 1000

    def surface(self, columns: set[tuple[int, int]]) -> dict[tuple[int, int], float]:
        low, high = np.min(list(columns), 0), np.max(list(columns), 0)
        cells = list(product(range(low[0], high[0] + 1), range(low[1], high[1] + 1)))
        floor = {c: self.floor(c) for c in cells}
        return self.pressed(self.without_pits(self.without_pits(floor)))

    @staticmethod
    def without_pits(floor: dict[tuple[int, int], float]) -> dict[tuple[int, int], float]:
        steady = {}
        for x, y in floor:
            window = [floor.get((x + i, y + j), math.inf) for i in range(-2, 3) for j in range(-2, 3)]
            known = [f for f in window if f < math.inf]
            level = sum(f <= floor[x, y] + PIT for f in known)
            pit = 4 * level < len(known) or level < FELLOWS
            steady[x, y] = math.inf if pit else floor[x, y]
        return steady

    def pressed(self, steady: dict[tuple[int, int], float]) -> dict[tuple[int, int], float]:
        """A surface lowered until no cell rises from an adjacent one by more than the slope beyond the incline."""
        edge = 8 * self.params.resolution
        squares = {(x // AROUND, y // AROUND) for x, y in steady}
        inclines = {square: self.incline(steady, square, edge) for square in squares}
        surface, lower = steady, {}
        while surface != lower:
            lower, surface = surface, {}
            for x, y in steady:
                ways = [lower[x, y]]
                for i, j in product((-1, 0, 1), repeat=2):
                    if (x + i, y + j) in lower:
                        here, there = (inclines[u // AROUND, v // AROUND] for u, v in ((x, y), (x + i, y + j)))
                        rise = -(here + there) / 2 @ (i, j) + SLOPE * edge * math.hypot(i, j)
                        ways.append(lower[x + i, y + j] + rise)
                surface[x, y] = min(ways) if min(ways) < lower[x, y] - 1e-9 else lower[x, y]
        return surface

    @staticmethod
    def incline(surface: dict[tuple[int, int], float], square: tuple[int, int], edge: float) -> np.ndarray:
        """The mean rise from one cell to the next along x and y, in 3 x 3 squares."""
        rises: tuple[list[float], list[float]] = [], []
        for x, y in surface:
            if max(abs(x // AROUND - square[0]), abs(y // AROUND - square[1])) <= 1:
                for along, (i, j) in zip(rises, ((1, 0), (0, 1)), strict=True):
                    ends = surface[x, y], surface.get((x + i, y + j), math.inf)
                    if max(ends) < math.inf and abs(ends[1] - ends[0]) <= STEEP * edge:
                        along.append(ends[1] - ends[0])
        incline = np.array([np.mean(along or [0.0]) for along in rises])
        return incline * min(1.0, SLOPE * edge / max(np.hypot(*incline), 1e-12))

    @staticmethod
    def interpolated(surface: dict[tuple[int, int], float], at: np.ndarray) -> float:
        """The surface, which is known at the centres of columns, interpolated; the border continues outside."""
        low, high = np.min(list(surface), 0), np.max(list(surface), 0)
        at = np.clip(at[:2].astype(float), low, high)
        corner = np.clip(np.floor(at).astype(int), low, np.maximum(high - 1, low))
        u, v = at - corner
        weights = {(0, 0): (1 - u) * (1 - v), (1, 0): u * (1 - v), (0, 1): (1 - u) * v, (1, 1): u * v}
        return sum(w * surface[tuple(np.minimum(corner + d, high).tolist())] for d, w in weights.items())

    def label(self, scan: Scan) -> np.ndarray:
        dynamic, _, _ = self.judge(scan, self.labelled, self.movers)
        self.labelled += 1
        return dynamic

    def judge(
        self, scan: Scan, now: int, movers: dict
    ) -> tuple[np.ndarray, set[tuple[int, int]], set[tuple[int, int]]]:
        """Labels, the places of points that are not low, and the places of objects that are dynamic by their votes."""
        params, size, points = self.params, self.params.resolution, scan.points
        inside = [i for i in range(len(points)) if np.isfinite(points[i]).all()]
        voxel = {i: key(points[i], size) for i in inside}
        surface = self.surface({(x >> 3, y >> 3) for x, y, _ in voxel.values()})
        ground = {i: self.interpolated(surface, points[i].astype(float) / (8 * size) - 0.5) for i in inside}
        height = {i: float(points[i, 2]) - g if g < np.inf else np.inf for i, g in ground.items()}
        height = self.levelled(scan, height)
        up = [i for i in inside if not height[i] <= params.ground_height]
        dynamic = np.zeros(len(points), bool)
        whole: set[int] = set()
        moving: set[tuple[int, int]] = set()
        left: dict[tuple[int, int], tuple[int, int, int]] = {}
        reachable = [i for i in up if not HIGHEST < height[i] < math.inf]
        for members in self.objects(points, reachable):
            verdict = self.verdict(voxel, members, now, movers)
            lasting: set[int] = set()
            if movers is self.movers:
                stays, lasting = self.staying(points, voxel, members, verdict, now)
                members = sorted(set(members) - stays)
                verdict = self.verdict(voxel, members, now, movers)
            moves, follows, waited, proof, mean = verdict
            if movers is self.movers and (moves or not follows):
                members = sorted(set(members) - self.settled(points, voxel, members, mean if moves else None))
            if movers is self.movers:
                lasting = lasting if moves or follows else set()
                members = [i for i in members if i not in lasting and not self.always(scan, voxel, i)]
            if moves or follows or waited:
                whole.update(members)
            if moves:
                moving.update(self.quarter(voxel[i]) for i in members)
            if moves or follows:
                for i in members:
                    place = self.quarter(voxel[i])
                    proven = max(left.get(place, (now, 0, now))[1], proof + moves)
                    left[place] = (now, proven, min(now, movers.get(place, (0, 0, now))[2]))
        for i in whole:
            dynamic[i] = True
        cells = {tuple(math.floor(float(c) / (UNDER * size)) for c in points[i, :2]) for i in whole}
        under = {
            i
            for i in inside
            if i not in up
            and any(
                (
                    math.floor(float(points[i, 0]) / (UNDER * size)) + a,
                    math.floor(float(points[i, 1]) / (UNDER * size)) + b,
                )
                in cells
                for a in (-1, 0, 1)
                for b in (-1, 0, 1)
            )
        }
        level = self.level(
            points, height, LEVEL, LEAST, [i for i in inside if i not in up and i not in under and height[i] > -PIT]
        )
        for i in inside:
            k = voxel[i]
            near = self.passed[k] - self.clear[k]
            if (
                i in up
                and not HIGHEST < height[i] < math.inf
                and self.clear[k] >= params.votes
                and self.clear[k] > self.hits[k] + near
                and not (movers is self.movers and self.always(scan, voxel, i))
            ):
                dynamic[i] = True
            empty = EMPTY <= self.clear[k] > max(self.hits[k], self.passed[k] / 2)
            if i in under and (height[i] - level(points[i]) > STANDS_OUT or empty):
                dynamic[i] = True
        movers |= left
        return dynamic, {self.quarter(voxel[i]) for i in up}, moving

    def levelled(self, scan: Scan, height: dict[int, float]) -> dict[int, float]:
        """Heights above the ground, as the scan's points near the ground show it."""
        lift = self.lift(scan, height)
        height = {i: h - lift.get(i, 0.0) for i, h in height.items()}
        sway = {i: SWAY * float(np.linalg.norm(scan.points[i] - scan.position)) for i in height}
        top = self.params.ground_height
        near = [i for i, h in height.items() if -PIT - sway[i] < h <= top + sway[i]]
        level = self.level(scan.points, height, SQUARE, MANY, near)
        return height | {i: height[i] - min(max(level(scan.points[i]), -sway[i]), sway[i]) for i in near}

    @staticmethod
    def lift(scan: Scan, height: dict[int, float]) -> dict[int, float]:
        """The middle of the densest layer of a cell near the sensor, of all layers that start at a whole centimetre."""
        cells: dict[tuple[int, ...], list[int]] = {}
        for i in height:
            if math.dist(scan.points[i, :2], scan.position[:2]) <= NEAR:
                cells.setdefault(tuple(math.floor(float(c) / SQUARE) for c in scan.points[i, :2]), []).append(i)
        (off, most), thick, (least, share) = OFF, round(LAYER * 100), LAYERED
        bottom, found = round((-most - LAYER / 2) * 100), {}
        for members in cells.values():
            high = Counter(math.floor(height[i] * 100) for i in members if height[i] < math.inf)
            points = [sum(high[bottom + k + j] for j in range(thick)) for k in range(round(2 * most * 100) + 1)]
            densest = [k for k, n in enumerate(points) if n == max(points)]
            middle = (bottom + (densest[0] + densest[-1]) / 2) / 100 + LAYER / 2
            if max(points) >= max(least, share * len(members)) and abs(middle) > off:
                found |= dict.fromkeys(members, middle)
        return found

    @staticmethod
    def level(
        points: np.ndarray, height: dict[int, float], edge: float, least: int, chosen: list[int]
    ) -> Callable[[np.ndarray], float]:
        """The mean height of the chosen points in the cell of a point."""
        cells: dict[tuple[int, ...], list[float]] = {}
        for i in chosen:
            cells.setdefault(tuple(math.floor(float(c) / edge) for c in points[i, :2]), []).append(height[i])

        def at(point: np.ndarray) -> float:
            heights = cells.get(tuple(math.floor(float(c) / edge) for c in point[:2]), [])
            return sum(heights) / len(heights) if len(heights) >= least else 0.0

        return at

    def left(self, place: tuple[int, int], now: int) -> bool:
        """Whether the last object seen in a place is dynamic, in this scan or later."""
        last = self.dynamic.get(place, -99)
        return last >= now and self.seen.get(place, -99) <= last + LATELY

    @staticmethod
    def square(place: tuple[int, int]) -> tuple[int, int]:
        """The square that contains a quarter column."""
        return place[0] // (2 * ACROSS), place[1] // (2 * ACROSS)

    def since(self, place: tuple[int, int]) -> bool:
        """Whether something was in a place as soon as the square around it was seen."""
        return self.first.get(place, math.inf) <= self.viewed[self.square(place)][0] + AT_ONCE

    def always(self, scan: Scan, voxel: dict[int, Key], i: int) -> bool:
        """Whether a point is far away, where something was as long as the place was seen."""
        far = math.dist(scan.points[i, :2], scan.position[:2]) > seethrough.FAR
        return far and self.taken(self.quarter(voxel[i]), seethrough.ALWAYS_FAR)

    def taken(self, place: tuple[int, int], lasting: int) -> bool:
        """Whether something was in a place as long as the square around it was seen, for a number of scans."""
        span = self.seen.get(place, 0) - self.first.get(place, math.inf) + 1
        lasts = span >= lasting and self.scans[place] >= trails.MOSTLY * span
        to_the_end = self.seen.get(place, -1) >= self.viewed[self.square(place)][1] - AT_ONCE
        return lasts and to_the_end and self.since(place)

    def verdict(
        self, voxel: dict[int, Key], members: list[int], now: int, movers: dict
    ) -> tuple[bool, bool, bool, int, float]:
        """Whether an object moves, follows and waited; the number of scans in which one moved there; its mean vote."""
        params, inside = self.params, [voxel[i] for i in members]
        votes = sum(map(self.votes, inside))
        having = sum(self.hits[k] > 1 or self.passed[k] > 0 for k in inside)
        trail = [movers.get(self.quarter(k), (-99, 0, math.inf)) for k in inside]
        recent = [proof for last, proof, _ in trail if last >= now - LATELY]
        old = sum(
            self.first.get(self.quarter(k), math.inf) < first - BEFORE
            for k, (_, _, first) in zip(inside, trail, strict=True)
        )
        proof = max(recent, default=0)
        touched = sum(self.clear[k] > 0 for k in inside)
        moves = votes > 1000 * params.share * params.votes * having and having >= FEW
        between, after = (sum(k in of for k in inside) for of in (self.between, self.after))
        follows = 2 * len(recent) > len(inside) and proof >= PROOF and touched > 0
        follows = follows and between <= (STAYS_SURE if proof >= SURE else STAYS) * touched
        rarely = votes <= 1000 * RARELY * params.votes * having
        follows = follows and not (rarely and 2 * old > len(inside))
        gone = touched > WAITED_FOR * len(inside) and after - between > LEFT * len(inside)
        gone = gone and votes > 1000 * LEAVES * params.votes * having
        waited = 2 * sum(self.left(self.quarter(k), now) for k in inside) > len(inside)
        return moves, follows, waited and gone, proof, votes / (1000 * params.votes * max(having, 1))

    def staying(
        self,
        points: np.ndarray,
        voxel: dict[int, Key],
        members: list[int],
        verdict: tuple[bool, bool, bool, int, float],
        now: int,
    ) -> tuple[set[int], set[int]]:
        """The points of parts that nothing passes, and that are there before and after the movers; and that last."""
        moves, follows, waited, proof, _ = verdict
        if not (moves or follows or waited or proof >= PROOF):
            return set(), set()
        followed = follows and not moves
        age = staying.EARLIER_FOLLOWED if followed else 0 if waited and not moves else staying.EARLIER
        if now + 1 == self.observed:
            return set(), set()
        stopping = []
        for inside in self.cells(points, members).values():
            having = sum(self.hits[voxel[i]] > 1 or self.passed[voxel[i]] > 0 for i in inside)
            if sum(self.votes(voxel[i]) for i in inside) <= 1000 * UNSEEN * self.params.votes * max(having, 1):
                stopping += inside
        found: set[int] = set()
        lasting: set[int] = set()
        for part in self.objects(points, stopping):
            inside, places = [voxel[i] for i in part], [self.quarter(voxel[i]) for i in part]
            against = sum(self.hits[k] + 3 * (self.passed[k] - self.clear[k]) for k in inside)
            touched = sum(self.clear[k] > 0 for k in inside)
            earlier = sum(min(self.movers.get(q, (0, 0, now))[2], now) - self.first[q] for q in places)
            later = sum(self.seen[q] - now for q in places)
            n = len(part)
            first = sum(map(self.since, places)) >= staying.SINCE * n
            before = first or earlier >= age * n
            firm = before and earlier + later >= staying.LASTING * n and n > staying.MANY and against >= 3 * n
            always = sum(self.taken(q, staying.LONG) for q in places)
            wide = math.hypot(*(float(max(x) - min(x)) for x in points[part, :2].T)) >= staying.WIDE
            if firm and touched <= staying.UNTOUCHED * n:
                found.update(part)
            elif touched <= staying.TOUCHED * n and always >= staying.ALWAYS * n and wide:
                lasting.update(part)
        return found, lasting

    def settled(self, points: np.ndarray, voxel: dict[int, Key], members: list[int], vote: float | None) -> set[int]:
        """The points of an object that rays stop at; ``vote`` is its mean vote, from 0 to 1, None if it waited."""
        by_cell = self.cells(points, members)
        found: set[int] = set()
        for place, inside in by_cell.items():
            near = [voxel[j] for d in product((-1, 0, 1), repeat=3) for j in by_cell.get(tuple(np.add(place, d)), [])]
            having = sum(self.hits[k] > 1 or self.passed[k] > 0 for k in near)
            mean = sum(self.votes(k) for k in near) / (1000 * self.params.votes * max(having, 1))
            against = sum(self.hits[k] + 3 * (self.passed[k] - self.clear[k]) for k in near) / (3 * len(near))
            touched = sum(self.clear[k] > 0 for k in near) / len(near)
            if touched <= UNTOUCHED if vote is None else mean <= UNSEEN and against * vote >= FIRM:
                found.update(inside)
        return found

    def votes(self, k: Key) -> int:
        """The vote of a voxel, thousandths of a scan."""
        against = Fraction(self.hits[k], 3) + self.passed[k] - self.clear[k]
        return math.floor(1000 * min(self.clear[k], self.params.votes) * min(self.clear[k] / against, 1))

    @staticmethod
    def quarter(k: Key) -> tuple[int, int]:
        return k[0] >> 2, k[1] >> 2

    def cells(self, points: np.ndarray, chosen: list[int]) -> dict[Key, list[int]]:
        """Points by the cells that join them to objects."""
        edges = (self.params.gap, self.params.gap, TALL * self.params.gap)
        cells: dict[Key, list[int]] = {}
        for i in chosen:
            cell = tuple(math.floor(float(c) / e) for c, e in zip(points[i], edges, strict=True))
            cells.setdefault(cell, []).append(i)
        return cells

    def objects(self, points: np.ndarray, chosen: list[int]) -> list[list[int]]:
        cells = self.cells(points, chosen)
        found, left = [], set(cells)
        while left:
            stack, members = [left.pop()], []
            while stack:
                cell = stack.pop()
                members += cells[cell]
                around = {tuple(np.add(cell, d)) for d in product((-1, 0, 1), repeat=3)} & left
                left -= around
                stack += around
            found.append(members)
        return found
