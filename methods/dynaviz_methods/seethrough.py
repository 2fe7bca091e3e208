"""SeeThrough: objects that rays pass through are dynamic, as a whole and for as long as they can be tracked.

    for each scan
        hit:      mark the voxels of its points; add rays into the sky, where no returns come up to the upper border
        clear:    mark the voxels that its rays cross without a hit of the same scan within ``guard``; mark the other
                  crossed voxels as passed: grazed surfaces and small pose errors have hits nearby
        order:    of voxels seen clear after a hit, note whether they are hit again (between) or not (after)
        judge:    label the scan by the scans so far, as below; store where dynamic objects and where other points that
                  are not low were seen last
    ground:       in each column, 8 voxels wide, take the densest of its lowest layers; ignore pits, far below the cells
                  around or without any; limit the slope to 0.1 beyond the incline around; interpolate between columns
    level:        errors of a pose lift the whole scan, and its ground far away. In squares of 12.8 m up to 30 m away,
                  raise or lower the ground to the densest layer of this scan's points, if that is more than 6 cm off;
                  then everywhere by the mean height of its points near the ground, by at most 5 mm per metre of range
    call a point low if it is at most ground_height above the ground, and high if it is more than 4.5 m above it
    for each scan again, in order
        objects:  join the points that are neither low nor high across gaps of up to about ``gap``
        dynamic:  let each voxel vote min(clear / votes, 1) * min(clear / (near + hit / 3), 1), where near is the number
                  of scans that passed it; call an object dynamic if the mean vote of its points exceeds ``share``;
                  ignore points in voxels with one hit that no other scan crossed
        followed: also call an object dynamic if most of it is where a dynamic object was in the last scans that was
                  judged dynamic at least twice, any of its points was ever seen clear, at most 1 in 4 of these
                  (7 in 10 after 12 times) between two hits: a car that arrives and parks, not the wall that it passed;
                  nor, with a mean vote up to 0.1, what is mostly where something was 30 scans before any dynamic object
        waited:   also call an object dynamic if most of it is where the last object ever seen was judged dynamic, in
                  this scan or later, 1 in 10 of its points was seen clear, those seen clear after the last hit exceed
                  those between two hits by 7 in 100, and its mean vote exceeds 0.01: a parked car that drives off
        staying:  in dynamic objects, and where one was dynamic lately, look for connected cells with a mean vote of at
                  most 0.05. Such a part stays if almost no point of it was ever seen clear, and something was in its
                  places for at least 8 scans, from the beginning or before any dynamic object: judge the rest of the
                  object without it. From the beginning: as soon as a square of 3.2 m around them was seen
        settled:  keep the parts of dynamic objects that stay, or that rays stop at while they pass through the rest: a
                  wall that a walker touches. Of objects that waited, keep where almost no point was ever seen clear.
                  Unless it waited, keep parts wider than 3.5 m where something always was, for at least 30 scans
        always:   keep points more than 20 m away if something was in their place for at least 20 scans, from the
                  beginning to the end, and was seen in half of them: errors of poses let rays pass there
        feet:     remove low points under or next to a dynamic object that are more than 4 cm above the other low points
                  of this scan around them (pose errors move both), or that most scans which crossed their voxel saw
                  clear, at least 10 times and more often than they were hit
        alone:    remove other points, if not high, in voxels that at least ``votes`` scans saw clear, more than hit or
                  passed them: rays pass between the leaves of a tree crown
    label the points of dynamic objects, their feet and points alone as dynamic

Each voxel of an object is weak evidence; the mean over the object is strong. A ray crosses the voxels from the
sensor's up to, but not including, the voxel of its point. Points that are not finite and points more than 32768 voxels
from the world's origin are kept unjudged.

Labels are decided once, in the order of the scans, and stored with four bits per point; all other state is per voxel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I32, I64, U8, U64, Bool, Intp
from dynaviz.blocks.blocks import VOXELS, Marks, voxels_of
from dynaviz.contracts.evidence import Asked, Evidence, Quantity, Rule, voxels_around
from dynaviz.contracts.method import Cause, Context, Halo, Labels, MethodInfo, Reason
from dynaviz.contracts.probe import Mask, PointClasses, State, Voxels
from dynaviz.contracts.scan import Scan
from dynaviz_methods import staying
from dynaviz_methods.clear_grid import ClearGrid
from dynaviz_methods.codes import any_of, pack_codes, unpack_codes
from dynaviz_methods.ground_height import PIT, GroundHeight, RollingGroundHeight, levelled
from dynaviz_methods.judgement import PROOF, Judged, Measured, object_rules, point_rules, verdicts
from dynaviz_methods.lookups import known
from dynaviz_methods.trails import Trails

TALL = 3  # height of the cells that join points, in gaps: rings are farther apart than the points of a ring
FIRM = 5.0  # scans: minimum mean evidence against votes around it, times the mean vote of its object
UNTOUCHED = 0.02  # maximum share of points seen clear around a point of a settled part of an object that waited
UNDER = 2  # voxels: edge of the cells that are under or next to a dynamic object
STANDS_OUT = 0.04  # metres above the ground of this scan
LEVEL = 3.2  # metres: edge of the cells in which a scan's own ground is levelled
LEAST = 3  # minimum number of low points there
EMPTY = 10  # minimum number of scans that saw the voxel of a foot clear
FAR = 20.0  # metres from the sensor: the guard is too narrow for errors of poses
ALWAYS_FAR = 20  # scans: minimum time for which something must be in a place far away to be always there
HIGHEST = 4.5  # metres above the ground, which no mover exceeds
OBJECT = 30.0  # metres


@dataclass(frozen=True)
class SeeThroughParams:
    """Parameters of SeeThrough.

    Attributes:
        resolution: edge of a voxel, metres.
        guard: a crossed voxel is not clear if the same scan has a hit within this distance, metres; at most 7 voxels.
        votes: number of clear scans for the full vote of a voxel.
        share: mean vote above which an object is dynamic.
        ground_height: points up to this above the ground are low, metres.
        gap: horizontal edge of the cells that join points to objects, metres; their height is three times this.
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
        if self.gap < self.resolution / 32:  # the keys of its cells have five bits more than voxel keys
            raise ValueError(f"gap = {self.gap}: give at least resolution / 32 = {self.resolution / 32:g} m")
        if not 0 <= self.guard <= 7 * self.resolution * 1.001:
            raise ValueError(f"guard = {self.guard}: give metres from 0 to 7 voxels of {self.resolution} m")
        if not 1 <= self.votes <= 65535:
            raise ValueError(f"votes = {self.votes}: give a number of scans from 1 to 65535")
        if not 0 <= self.share < 1:
            raise ValueError(f"share = {self.share}: give a share from 0 to less than 1")
        if not np.isfinite(self.ground_height):
            raise ValueError(f"ground_height = {self.ground_height}: give metres")


NEVER_CLEAR, TOO_LITTLE, LOW, OUT_OF_REACH, SEEN_THROUGH, FOLLOWED_ON, FOOT, ALONE, WAITED, HIGH, SETTLED, ALWAYS = (
    range(12)
)
REASONS = (
    Reason("never_clear", "kept: no scan saw its voxel clear", Cause.NOTHING_BEHIND),
    Reason("too_little_clear", "kept: too little of its object was seen clear", Cause.STANDING),
    Reason("low", "kept: near the ground, and not under a dynamic object", Cause.TAKEN_FOR_GROUND),
    Reason("out_of_reach", "kept unjudged: not finite, or more than 32768 voxels from the origin", Cause.OUT_OF_RANGE),
    Reason("seen_through", "removed: much of its object was seen clear", Cause.SHARED_CELL),
    Reason("followed", "removed: its object is where a dynamic object was in the last scans", Cause.SHARED_CELL),
    Reason("foot", "removed: low, but under a dynamic object", Cause.SHARED_CELL),
    Reason("alone", "removed: its voxel was seen clear, but its object was not", Cause.SPARSE_RINGS),
    Reason("waited", "removed: its object waited here before it moved away", Cause.SHARED_CELL),
    Reason("high", "kept: more than 4.5 m above the ground, where no mover is expected", Cause.HEIGHT_LIMIT),
    Reason("settled", "kept: rays stop at this part of a dynamic object", Cause.OCCUPIED),
    Reason("always", "kept: far away, where something was as long as the place was seen", Cause.OCCUPIED),
)
BY_POINT = (NEVER_CLEAR, TOO_LITTLE, HIGH, SETTLED, ALONE, LOW, OUT_OF_REACH)  # of points whose object does not move
REMOVED = np.isin(np.arange(len(REASONS)), (SEEN_THROUGH, FOLLOWED_ON, FOOT, ALONE, WAITED))  # (R,) bool, by code
STATES = (
    State("clear", Voxels, "Voxels with points that this scan saw clear; number of such scans", value_range=(1, 6)),
    State("passed", Voxels, "Voxels with points that this scan's rays crossed near its hits: no evidence"),
    State(
        "objects",
        PointClasses,
        "Points by the scans so far: low, of a static, dynamic or followed object, foot, alone",
        legend=("static", "low", "dynamic", "followed", "foot", "alone"),
    ),
    State("low", Mask, "Points near the ground: removed only under a dynamic object"),
)
CLASS = np.array([0, 0, 1, 0, 2, 3, 4, 5, 3, 0, 0, 0], np.uint8)  # reason code to class of the legend


class SeeThrough:
    """SeeThrough; in online mode it labels each scan by the scans so far."""

    info: ClassVar[MethodInfo] = MethodInfo(
        "seethrough", "SeeThrough", "dynaviz, 2026", REASONS, STATES, uses=("elevation",)
    )
    Params: ClassVar[type[Any]] = SeeThroughParams

    def __init__(self, params: Any) -> None:
        self.params = params

    def begin(self, context: Context) -> None:
        """Allocate the map where points will lie."""
        self._probe = context.probe
        self._grid = ClearGrid(context.extent, self.params.resolution, context.sensor)
        size = self.params.resolution
        self._ground = RollingGroundHeight(self._grid) if self._grid.rolls else GroundHeight(self._grid.blocks, size)
        rows = len(self._grid) + 1  # points without a voxel (-1) read the last row
        self._hits, self._passed, self._grazed = (
            self._grid.per_block(np.zeros((rows, VOXELS), np.uint16)) for _ in range(3)
        )
        # One bit per voxel: ever hit; seen clear between two hits; seen clear after the last hit.
        self._order = tuple(self._grid.per_block(np.zeros((rows, 8), np.uint64)) for _ in range(3))
        self._trails = Trails(self._ground.squares)  # by quarter column
        if isinstance(self._ground, RollingGroundHeight):
            self._ground.watch(self._trails.forget)
        self._observed = 0
        self._measured: Measured | None = None  # the scan that was observed last, which online is labelled next
        self._number: dict[int, int] = {}  # by scan index: its position among the observed scans
        self._reasons: dict[int, U8] = {}  # by scan index: four bits per point, packed

    def observe(self, scan: Scan) -> None:
        """Count the voxels that the scan hits, passes and sees clear, and judge it by the scans so far."""
        points, voxels, places = self._located(scan)
        marks = self._grid.mark_once(scan, voxels)
        near = self._grid.near(marks, round(self.params.guard / self.params.resolution))
        bits = marks.bits
        if self._observed >= kernels.clearance.MOST:
            bits = kernels.clearance.countable(marks.blocks, bits, self._hits, self._passed)
        kernels.clearance.count(marks.blocks, bits, near, self._hits, self._passed, self._grazed)
        kernels.clearance.order(marks.blocks, marks.bits, near, *self._order)
        self._ground.add(points, voxels)
        now = self._number[scan.index] = self._observed
        self._observed += 1
        measured = self._measured = self._measure(scan, points, voxels, places)
        verdict = self._movement(measured, self._trails.observed)
        self._trails.observe(places, voxels >= 0, ~measured.low, verdict == SEEN_THROUGH, now)
        self._show(measured, verdict, marks, near)

    def label(self, scan: Scan) -> Labels:
        """Label the points of dynamic objects.

        Labels are decided when a scan is labelled for the first time. Objects are tracked from scan to scan, so label
        scans in order.
        """
        if scan.index not in self._reasons:
            last = self._measured
            if last is None or last.index != scan.index:
                last = self._measure(scan, *self._located(scan))
            reasons = self._outcomes(last, self._movement(last, self._trails.labelled))
            self._reasons[scan.index] = pack_codes(reasons)
        reasons = unpack_codes(self._reasons[scan.index], len(scan))
        return Labels(any_of(reasons, REMOVED), reasons)

    def forget(self, index: int) -> None:
        """Drop the labels of a scan."""
        self._number.pop(index, None)
        self._reasons.pop(index, None)

    def relabel(self, scans: Sequence[Scan]) -> list[Labels]:
        """Label scans again, in order, as if none had been labelled; the stored labels stay."""
        stored = self._reasons, self._trails.restart()
        self._reasons = {}
        try:
            return [self.label(scan) for scan in scans]
        finally:
            self._reasons, self._trails.labelled = stored

    def _located(self, scan: Scan) -> tuple[F32, I64, I64]:
        """The scan's points (N, 3), their voxels (N,), -1 for none, and their quarter columns (N,)."""
        points = kernels.as_readonly(scan.points, np.float32)
        voxels = self._grid.locate(points)
        return points, voxels, self._ground.quarters(voxels)

    def _scans(self, voxels: I64) -> tuple[I32, I32, I32]:
        """The number of scans, (K,) int32 each, that hit, passed and saw clear each of some voxels (K,)."""
        hits, passed, grazed = (kernels.objects.read(voxels, of) for of in (self._hits, self._passed, self._grazed))
        return hits, passed, passed - grazed

    def _measure(self, scan: Scan, points: F32, voxels: I64, places: I64) -> Measured:
        """The height, object and evidence of each point of an observed scan."""
        params = self.params
        height = self._ground.height(points, voxels, scan.position)
        height = levelled(height, points, voxels >= 0, scan.position, params.ground_height)
        low = height <= params.ground_height
        chosen = (voxels >= 0) & ~low & ~_high(height)
        objects, n = kernels.objects.connect(points, chosen, params.gap, TALL * params.gap)
        sums = self._tally(voxels, objects, n)
        return Measured(scan.index, scan.position, points, voxels, places, height, low, objects, n, sums)

    def _outcomes(self, measured: Measured, verdict: U8) -> U8:
        """Reason code of each point of an observed scan, (N,) uint8."""
        voxels, height, counts = measured.voxels, measured.height, (self._hits, self._passed, self._grazed)
        points = voxels, verdict, measured.low, _high(height)
        reasons: U8 = kernels.objects.outcomes(*points, *counts, self.params.votes, BY_POINT)
        alone = np.flatnonzero(reasons == ALONE)
        reasons[alone[self._always(measured, alone)]] = ALWAYS
        under = self._under(measured, verdict)
        feet = np.flatnonzero(under)
        if not len(feet):
            return reasons
        hits, passed, clear = self._scans(voxels[feet])
        empty = (clear >= EMPTY) & (clear > hits) & (2 * clear > passed)
        stands_out = height[feet] - self._level(measured, under, under)[feet] > STANDS_OUT
        reasons[feet[stands_out | empty]] = FOOT
        return reasons

    def _always(self, measured: Measured, rows: Intp) -> Bool:
        """(K,) bool: far away in some rows (K,), in places where something was as long as they were seen."""
        far: Bool = np.hypot(*(measured.points[rows, :2] - measured.position[:2]).T) > FAR
        far[far] = self._trails.always(measured.places[rows[far]], ALWAYS_FAR)
        return far

    def _under(self, measured: Measured, verdict: U8) -> Bool:
        """(N,) bool: low points in or next to a dynamic object."""
        size = UNDER * self.params.resolution
        under: Bool = kernels.squares.in_or_next_to(measured.points, any_of(verdict, REMOVED), measured.low, size)
        return under

    def _level(self, measured: Measured, under: Bool, wanted: Bool) -> F32:
        """(N,) float32, metres: height of the scan's own ground around the wanted points (N,); 0 if unknown."""
        ground, height = measured.low & ~under & (measured.height > -PIT), measured.height
        level: F32 = kernels.squares.local_level(measured.points, ground, wanted, height, LEVEL, LEAST)
        return level

    def _movement(self, measured: Measured, movers: I32) -> U8:
        """(N,) uint8: why each point's object is dynamic, ``SETTLED`` for its settled parts, or 0.

        ``movers`` holds the positions of dynamic objects in earlier scans; those of this scan are added.
        """
        now, objects, labels = self._number[measured.index], measured.objects, movers is self._trails.labelled
        weighed, reasons = self._judge(measured, objects, measured.evidence, now, movers)
        stays, lasts = self._staying(measured, weighed, reasons, now, movers) if labels else staying.NOTHING
        if len(stays):
            sums = measured.evidence - self._tally(measured.voxels[stays], objects[stays], measured.n)
            objects = objects.copy()
            objects[stays] = -1
            weighed, reasons = self._judge(measured, objects, sums, now, movers)
        by_point: U8 = kernels.objects.spread(reasons, objects)
        follows = (reasons > 0) & (reasons != WAITED)
        if labels:  # a mark of a mover in the scans so far may be too large
            vote = weighed[2] / (1000 * self.params.votes * np.maximum(weighed[1], 1))
            by_point[self._settled(measured, by_point, vote)] = SETTLED
            by_point[stays] = SETTLED * (reasons[measured.objects[stays]] > 0)
            by_point[lasts[follows[objects[lasts]]]] = SETTLED
            moving = np.flatnonzero(any_of(by_point, REMOVED))
            by_point[moving[self._always(measured, moving)]] = ALWAYS
        proven = (weighed[5] + (reasons == SEEN_THROUGH)).astype(np.int32)
        kernels.places.leave(objects, follows, any_of(by_point, REMOVED), proven, measured.places, now, *movers)
        self._judged = Judged(measured, weighed, by_point)
        return by_point

    def _tally(self, voxels: I64, groups: I32, n: int) -> I64:
        """(7, n) int64: the evidence of n groups of points; see ``kernels/objects.py``."""
        counts = self._hits, self._passed, self._grazed, *self._order[1:], self.params.votes
        sums: I64 = kernels.objects.evidence(groups, n, voxels, *counts)
        return sums

    def _judge(self, measured: Measured, objects: I32, evidence: I64, now: int, movers: I32) -> tuple[I64, U8]:
        """What is known about each object, as in ``Judged``, and why it is dynamic, (n,) uint8, or 0."""
        size, having, votes, touched, between, after, _ = evidence
        lately, proof, left, old = self._trails.around(objects, measured.n, measured.places, now, movers)
        weighed = np.array([size, having, votes, touched, lately, proof, left, between, after, old])
        waited, followed, seen = verdicts(weighed, self.params.votes, self.params.share)
        codes = [SEEN_THROUGH, FOLLOWED_ON, WAITED]  # the first that applies
        return weighed, np.select([seen, followed, waited], codes).astype(np.uint8)

    def _staying(self, measured: Measured, weighed: I64, reasons: U8, now: int, movers: I32) -> tuple[Intp, Intp]:
        """Rows of the points that stay, or last, of objects that are dynamic or where one was dynamic lately."""
        wanted = (reasons > 0) | ((weighed[4] > 0) & (weighed[5] >= PROOF))
        if not wanted.any() or now + 1 == self._observed:
            return staying.NOTHING
        earliest = np.where(reasons == FOLLOWED_ON, staying.EARLIER_FOLLOWED, staying.EARLIER)
        earliest[reasons == WAITED] = 0  # it was always there
        rows = np.flatnonzero(kernels.objects.spread(wanted.view(np.uint8), measured.objects))
        objects, places = measured.objects[rows], measured.places[rows]
        points = kernels.as_readonly(measured.points[rows], np.float32)
        cells, tally = (self.params.gap, TALL * self.params.gap), partial(self._tally, measured.voxels[rows])
        spans = partial(self._trails.spans, places=places, now=now, movers=movers)
        always = self._trails.always(places, staying.LONG)
        stays, lasts = staying.staying(points, objects, cells, self.params.votes, earliest, always, tally, spans)
        return rows[stays], rows[lasts]

    def _settled(self, measured: Measured, verdict: U8, vote: F64) -> Intp:
        """Rows of the points in settled parts of objects that were seen through or waited.

        The walls and parked cars that a mover touches belong to its object, but rays stop at them. The clearer the rest
        of an object was seen through, the fewer hits and near hits it takes. An object that waited was hit while it
        did, but once it is gone, most of it is seen clear.

        Args:
            measured: the scan.
            verdict: (N,) uint8, why each point's object is dynamic, or 0.
            vote: (objects,) float64, mean vote of each object, from 0 to 1.
        """
        cells = self.params.gap, TALL * self.params.gap
        rows = np.flatnonzero((verdict == SEEN_THROUGH) | (verdict == WAITED))
        evidence = measured.voxels[rows], self._hits, self._passed, self._grazed, self.params.votes
        points = kernels.as_readonly(measured.points[rows], np.float32)
        cell, votes, against, touched = kernels.objects.surroundings(points, *cells, *evidence)
        stops = (votes[cell] <= staying.UNSEEN) & (against[cell] * vote[measured.objects[rows]] >= FIRM)
        settled: Intp = rows[np.where(verdict[rows] == WAITED, touched[cell] <= UNTOUCHED, stops)]
        return settled

    def halo(self) -> Halo:
        """The size of an object, and the distance from which low ground lowers the ground."""
        return Halo(OBJECT)

    def evidence(self, asked: Asked) -> Evidence:
        """How often scans hit, passed and saw clear the points' voxels; and what is known about their objects."""
        voxels = self._grid.locate(asked.points)
        hits, passed, clear = (known(scans, voxels) for scans in self._scans(voxels))
        counts = {"hit": hits, "passed": passed, "clear": clear}
        quantities = tuple(Quantity(name, values, total=True) for name, values in counts.items())
        judged = self._judged
        rules: tuple[Rule, ...] = ()
        if judged.measured.index == asked.scan.index:
            settled = np.isin(judged.verdict[asked.rows], (SETTLED, ALWAYS))
            of_objects = object_rules(judged, asked.rows, settled, self.params.votes, self.params.share)
            rules = (*of_objects, *self._point_rules(asked, judged, (hits, passed, clear)))
        return Evidence(voxels_around(asked.points, self.params.resolution), quantities, rules)

    def _point_rules(self, asked: Asked, judged: Judged, counts: tuple[F64, F64, F64]) -> tuple[Rule, ...]:
        """The rules that remove single points: above the ground, and low under a dynamic object."""
        measured, rows, under = judged.measured, asked.rows, self._under(judged.measured, judged.verdict)
        wanted = np.zeros(len(under), np.bool_)
        wanted[rows] = measured.voxels[rows] >= 0
        height, level = measured.height[rows], self._level(measured, under, wanted)[rows]
        limits = self.params.votes, EMPTY, self.params.ground_height, STANDS_OUT
        where = _high(height), under[rows], self._always(measured, rows)
        return point_rules(height, level, where, counts, limits)

    def _show(self, measured: Measured, verdict: U8, marks: Marks, near: U64) -> None:
        wants, emit = self._probe.wants, self._probe.emit
        for name, among in (("clear", ~near), ("passed", near)):
            if wants(name):
                through = marks.bits[:, :8] & ~marks.bits[:, 8:]
                voxels = voxels_of(marks.blocks, through & among.view(np.int64))
                voxels = voxels[self._hits.ravel()[voxels] > 0]
                count = self._scans(voxels)[2].astype(np.float32) if name == "clear" else None
                emit(name, Voxels(self._grid.keys(voxels), self._grid.resolution, count))
        if wants("objects"):
            emit("objects", PointClasses(CLASS[self._outcomes(measured, verdict)]))
        if wants("low"):
            emit("low", Mask(measured.low))


def _high(height: F32) -> Bool:
    """(N,) bool: points too high above the ground for a mover, from their heights in metres; infinite is unknown."""
    high: Bool = (height > HIGHEST) & (height < np.inf)
    return high
