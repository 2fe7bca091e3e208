"""SeeThrough: what scans saw clear through has moved, as a whole and for as long as it can be followed.

    for each scan
        hit:      voxels of its points
        clear:    voxels that its rays cross with no hit of this very scan within ``guard``; others that they cross are
                  passed: a grazed surface, seen from elsewhere or with a pose that is off, keeps its hits near
        judged:   as below by the scans so far; where dynamic objects are, and where anything is that is not low
    ground:       in each column of 8 voxels a side the densest of its lowest layers, pressed down to a slope of 0.2
    a point is low if it is at most ground_height above that ground
    for each scan again, in its order
        objects:  points that are not low, joined over gaps of about ``gap``
        dynamic:  a voxel votes with min(clear / votes, 1) min(clear / (near + hit / 3), 1), where near counts scans
                  that crossed it and were not clear; an object is dynamic, all of it, where the mean vote of its
                  points exceeds ``share``; points in voxels of one hit that no other scan crossed have no say
        followed: so is an object of which most lies where a mover was in the last scans, one that was judged dynamic
                  at least twice, if any of its points was ever seen clear through: a car that came and parked
        waited:   so is one of which most lies where the last that was ever seen was judged dynamic, then or later, if
                  1 in 10 of its points was seen clear through: a car that stood and drove off
        feet:     low points under or beside a dynamic object that stand out of the ground, were passed five times as
                  often as hit, or were hit twice at most and seen clear through as often
        alone:    other points in a voxel that was seen clear through by ``votes`` scans, by more than hit it or passed
                  it near a hit

Nothing is judged by one plan of the world: each part of an object is weak evidence, its mean is strong. A ray crosses
the voxels from the sensor's to the last before its point's. Points that are not finite and points more than 32768
voxels from the world's origin are kept unjudged.

Labels are decided in the order of the scans, once each, and kept as four bits a point; all else is state of voxels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, I32, I64, U8, U64
from dynaviz.method import Cause, Context, Labels, MethodInfo, Reason
from dynaviz.probe import Mask, PointClasses, State, Voxels
from dynaviz.scan import Scan
from dynaviz.spatial.blocks import VOXELS, BlockGrid, Marks, voxels_of
from dynaviz.spatial.extent import Extent
from dynaviz_methods.ground_height import GroundHeight

TALL = 3  # gaps: height of an object's cells, for rings lie farther apart than the points of one
PROOF = 2  # scans in which it must have been judged dynamic before
LATELY = 3  # scans for which a mover's place is remembered
WAITED_FOR = 0.1  # share of its points that must have been seen through where an object stood and left later
STANDS_OUT = 0.05  # metres above the ground
PASSED = 5  # times as often as hit
SELDOM = 2  # hits of a voxel up to which it is no ground where it was seen clear through as often
FEW = 3  # points that have a say; fewer do not make an object dynamic


@dataclass(frozen=True)
class SeeThroughParams:
    """Parameters of SeeThrough.

    Attributes:
        resolution: edge of a voxel, metres.
        guard: a crossed voxel is not clear with a hit of the same scan this near, metres; at most 7 voxels.
        votes: clear scans that a voxel's whole vote takes.
        share: mean vote above which an object is dynamic.
        ground_height: points up to this above the ground are low, metres.
        gap: edge of the cells that join points to objects, metres; three times this in height.
    """

    resolution: float = 0.1
    guard: float = 0.3
    votes: int = 3
    share: float = 0.35
    ground_height: float = 0.2
    gap: float = 0.3

    def __post_init__(self) -> None:
        for name in ("resolution", "gap"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} = {getattr(self, name)}: give metres above 0")
        if self.gap < self.resolution / 32:  # keys of its cells have the room of so many a voxel
            raise ValueError(f"gap = {self.gap}: give at least resolution / 32 = {self.resolution / 32:g} m")
        if not 0 <= self.guard <= 7 * self.resolution * 1.001:
            raise ValueError(f"guard = {self.guard}: give metres from 0 to 7 voxels of {self.resolution} m")
        if not 1 <= self.votes <= 65535:
            raise ValueError(f"votes = {self.votes}: give a number of scans from 1 to 65535")
        if not 0 <= self.share < 1:
            raise ValueError(f"share = {self.share}: give a share from 0 to less than 1")
        if not np.isfinite(self.ground_height):
            raise ValueError(f"ground_height = {self.ground_height}: give metres")


NEVER_CLEAR, TOO_LITTLE, LOW, OUT_OF_REACH, SEEN_THROUGH, FOLLOWED_ON, FOOT, ALONE, WAITED = range(9)
REASONS = (
    Reason("never_clear", "kept: no scan saw clear through its voxel", Cause.NOTHING_BEHIND),
    Reason("too_little_clear", "kept: too little of its object was seen clear through", Cause.STANDING),
    Reason("low", "kept: near the ground, and under no dynamic object", Cause.TAKEN_FOR_GROUND),
    Reason(
        "out_of_reach",
        "kept unjudged: not finite, or more than 32768 voxels from the world's origin",
        Cause.OUT_OF_RANGE,
    ),
    Reason("seen_through", "removed: much of its object was seen clear through", Cause.SHARED_CELL),
    Reason("followed", "removed: its object is where a dynamic one was in the last scans", Cause.SHARED_CELL),
    Reason("foot", "removed: low, but under a dynamic object", Cause.SHARED_CELL),
    Reason("alone", "removed: its voxel was seen clear through, though its object was not", Cause.SPARSE_RINGS),
    Reason("waited", "removed: where its object stood before it moved away", Cause.SHARED_CELL),
)
REMOVED = np.isin(np.arange(len(REASONS)), (SEEN_THROUGH, FOLLOWED_ON, FOOT, ALONE, WAITED))  # (R,) bool, by code
STATES = (
    State("clear", Voxels, "Voxels with points that this scan saw clear through; scans that did", value_range=(1, 6)),
    State("passed", Voxels, "Voxels with points that its rays crossed near something it hit: no evidence"),
    State(
        "objects",
        PointClasses,
        "Points by what is known so far: low, of an object that stands, of a dynamic or a followed one, alone",
        legend=("stands", "low", "dynamic", "followed", "foot", "alone"),
    ),
    State("low", Mask, "Points near the ground: they fall only under a dynamic object"),
)
CLASS = np.array([0, 0, 1, 0, 2, 3, 4, 5, 3], np.uint8)  # of a reason, in the legend


class ClearGrid(BlockGrid):
    """A block grid that knows what lies near the hits of a scan."""

    def __init__(self, extent: Extent, resolution: float) -> None:
        super().__init__(extent, resolution)
        # Empty between scans.
        self._rows, self._once = np.zeros(len(self) + 1, np.int32), np.zeros((len(self) + 1, 8), np.int64)

    @property
    def blocks(self) -> I64:
        """(B, 3) keys of its blocks, sorted."""
        return self._blocks

    def mark_once(self, scan: Scan, voxels: I64) -> Marks:
        """What the rays of a scan cross and hit, one for each voxel with points, to its centre, from each origin.

        Args:
            scan: where rays start.
            voxels: (N,) int64, the voxel of each point, -1 for none.
        """
        origins = scan.origins
        if len(origins) == 1:
            goals = kernels.voids.distinct(voxels, voxels >= 0, self._once)
        else:
            places, which = np.unique(origins, axis=0, return_inverse=True)
            rays = np.unique((voxels * len(places) + which.ravel())[voxels >= 0])
            goals, origins = rays // len(places), places[rays % len(places)]
        centres = ((self.keys(goals) + 0.5) * self.resolution).astype(np.float32)
        every = kernels.as_readonly(np.ones(len(goals), np.bool_), np.bool_)
        ends = (kernels.as_readonly(centres, np.float32), kernels.as_readonly(origins, np.float64), every, every)
        kernels.raycast.mark(*ends, *(self._per_metre, *self._place, *self._scratch))
        return Marks(*kernels.raycast.collect(*self._scratch))

    def near(self, marks: Marks, hit: U64, times: int) -> U64:
        """(B, 8) uint64: voxels of the marked blocks in the cubes of 2 times + 1 voxels a side around those hit.

        Cubes grow from block to block beside it, as far as these are marked.
        """
        sides = kernels.clearance.beside(marks.blocks, self._rows, self._blocks, *self._place)
        padded = np.zeros((len(hit) + 1, 8), np.uint64)
        padded[:-1] = hit
        grown: U64 = kernels.clearance.grown(padded, sides, times)[:-1]
        return grown


class SeeThrough:
    """SeeThrough; online it labels each scan by the scans so far."""

    info: ClassVar[MethodInfo] = MethodInfo("seethrough", "SeeThrough", "dynaviz, 2026", REASONS, STATES)
    Params: ClassVar[type[Any]] = SeeThroughParams

    def __init__(self, params: Any) -> None:
        self.params = params

    def begin(self, context: Context) -> None:
        """Lay out the map where points will lie."""
        self._probe = context.probe
        self._grid = ClearGrid(context.extent, self.params.resolution)
        self._relief = GroundHeight(self._grid.blocks, self.params.resolution)
        rows = len(self._grid) + 1  # points without a voxel, -1, read the last
        self._hits, self._passed, self._clear = (np.zeros((rows, VOXELS), np.uint16) for _ in range(3))
        # Of each quarter of a column the last scan with a mover there, and in how many scans that one had been judged
        # dynamic: by what is known at the end, and so far. And when anything and a dynamic object was seen there last.
        places = 4 * len(self._relief) + 4
        self._movers, self._so_far = (np.full((2, places), -LATELY - 1, np.int32) for _ in range(2))
        self._seen, self._dynamic = (np.full(places, -LATELY - 1, np.int32) for _ in range(2))
        self._number: dict[int, int] = {}  # of each scan by its index: the how manieth was observed
        self._reasons: dict[int, U8] = {}  # four bits a point, packed

    def observe(self, scan: Scan) -> None:
        """Count what the scan's rays hit, pass and see clear through, and judge it by the scans so far."""
        points, voxels, places = self._located(scan)
        marks = self._grid.mark_once(scan, voxels)
        crossed, hit = (np.ascontiguousarray(half).view(np.uint64) for half in np.split(marks.bits, 2, axis=1))
        near = self._grid.near(marks, hit, round(self.params.guard / self.params.resolution))
        counts = (self._hits, self._passed, self._clear)
        kernels.clearance.count(marks.blocks, crossed, hit, near, *counts)
        self._relief.add(points, voxels)
        now = self._number[scan.index] = len(self._number)
        why = self._judge(scan, points, voxels, places, self._so_far)
        self._seen[places[(why != LOW) & (why != FOOT)]] = now
        self._dynamic[places[why == SEEN_THROUGH]] = now
        self._show(why, marks.blocks, crossed & ~hit, near)

    def label(self, scan: Scan) -> Labels:
        """Dynamic where the point belongs to a dynamic object.

        Decided when a scan is labelled for the first time. Objects are followed from scan to scan, so label scans in
        order.
        """
        if scan.index not in self._reasons:
            why = self._judge(scan, *self._located(scan), self._movers)
            even, odd = np.append(why, np.zeros(len(why) & 1, np.uint8)).reshape(-1, 2).T
            self._reasons[scan.index] = even + 16 * odd
        pairs = self._reasons[scan.index]
        reasons = np.stack([pairs & 15, pairs >> 4], 1).ravel()[: len(scan)]
        return Labels(REMOVED[reasons], reasons)

    def _located(self, scan: Scan) -> tuple[F32, I64, I64]:
        """Its points (N, 3), their voxels (N,), -1 for none, and the quarters of columns (N,) that these are in."""
        points = kernels.as_readonly(scan.points, np.float32)
        voxels = self._grid.locate(points)
        return points, voxels, self._relief.quarters(voxels)

    def _judge(self, scan: Scan, points: F32, voxels: I64, places: I64, movers: I32) -> U8:
        """(N,) uint8, codes of ``REASONS``, for an observed scan; movers: where any were, and then are."""
        params, now = self.params, self._number[scan.index]
        height = self._relief.height(points, voxels, scan.position)
        within, low = voxels >= 0, height <= params.ground_height
        objects, n = kernels.objects.connect(points, within & ~low, params.gap, TALL * params.gap)
        verdict = self._movement(objects, n, voxels, places, now, movers)
        moves = verdict > 0

        counts = (self._hits, self._passed, self._clear)
        hits, passed, clear = (kernels.objects.read(voxels, of) for of in counts)
        why = np.where(clear > 0, TOO_LITTLE, NEVER_CLEAR).astype(np.uint8)
        why[(clear >= params.votes) & (2 * clear > hits + passed)] = ALONE
        why[moves] = verdict[moves]
        why[low] = LOW
        under = low & kernels.objects.beside(points, moves, 4 * params.resolution)
        empty = (passed > PASSED * hits) | ((clear >= hits) & (hits <= SELDOM))
        why[under & ((height > STANDS_OUT) | empty)] = FOOT
        why[~within] = OUT_OF_REACH
        return why

    def _movement(self, objects: I32, n: int, voxels: I64, places: I64, now: int, movers: I32) -> U8:
        """(N,) uint8: why points are of an object that moves, or 0; such objects leave a trail in ``movers``."""
        evidence = (voxels, self._hits, self._passed, self._clear, self.params.votes)
        size, having, votes, touched = kernels.objects.evidence(objects, n, *evidence)
        lately, proof = kernels.objects.trails(objects, n, places, now - LATELY, *movers)
        last = self._dynamic[places]
        left = kernels.objects.count(objects, n, (last >= now) & (self._seen[places] <= last + LATELY))
        verdict = np.zeros(n + 1, np.uint8)  # the last: no object
        why = verdict[:n]
        why[(2 * left > size) & (touched > WAITED_FOR * size)] = WAITED
        why[(2 * lately > size) & (touched > 0) & (proof >= PROOF)] = FOLLOWED_ON
        dynamic = (votes > 1000 * self.params.share * self.params.votes * having) & (having >= FEW)
        why[dynamic] = SEEN_THROUGH
        proven = (proof + dynamic).astype(np.int32)
        kernels.objects.leave(objects, (why > 0) & (why != WAITED), proven, places, now, *movers)
        return verdict[objects]

    def _show(self, why: U8, blocks: I32, through: U64, near: U64) -> None:
        wants, emit = self._probe.wants, self._probe.emit
        for name, bits in (("clear", through & ~near), ("passed", through & near)):
            if wants(name):
                voxels = voxels_of(blocks, bits.view(np.int64))
                voxels = voxels[self._hits.ravel()[voxels] > 0]
                count = self._clear.ravel()[voxels].astype(np.float32) if name == "clear" else None
                emit(name, Voxels(self._grid.keys(voxels), self._grid.resolution, count))
        if wants("objects"):
            emit("objects", PointClasses(CLASS[why]))
        if wants("low"):
            emit("low", Mask((why == LOW) | (why == FOOT)))
