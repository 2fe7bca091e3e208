"""SeeThrough: what rays pass through is dynamic, and so is the object around it, wherever it
stands.

    for each scan
        find the ground
            the lowest layers of its points that a slope from the level under the sensor reaches;
            what lies below ground that is seen, on a ray that passes below it, is a reflection;
            where earlier scans had the level, a quarter of such rays is enough; it rises by at
            most 10 % beyond the scan's mean incline
            if it is over 10 cm off the ground of earlier scans, level the scan: its points, its
            rays and its sensor
        mark what it hit: the voxels of its points
        mark what it saw clear
            cast a ray to one point in each cube of 2 x 2 x 2 voxels, and into the sky
            a crossed voxel is clear if neither this scan nor the one before has a hit within
            ``guard`` of it; otherwise it is grazed
        join its points to objects
            those from ``ground_height`` to 4.5 m above the ground, across an angle of
            ``join_angle`` plus 2.7 times that between rays

    the evidence of a voxel: was it empty at times?
        for it:     the scans that saw it clear
        against it: the scans that grazed it, weighted with ``near``, and those that hit it,
                    weighted with ``hit``
        if more is for it: (for - against) / (for + against), in full if ``votes`` scans saw it
        clear
        otherwise: the prior times (for - against) / (for + against + 1), which is below 0
        the prior rises with the number of scans, to ``prior`` for 64

    the evidence of a place, 4 x 4 x 8 voxels
        the mean of its voxels, less the prior, weighted with their hits; in full from ``votes``
        hits on
        only of voxels that contained points of objects, and that another scan hit or crossed

    twice
        how certain it is that an object is dynamic, from -1 to 1
            the mean of its places: their evidence and what they inherit, in ``votes``; certain
            places weigh up to twice as much
        an object is dynamic if its certainty is above 1/2; the second time also if
            it moved
                its outline is displaced as a whole, by at least twice ``guard``, against more
                than ``hit`` of the up to 64 objects that it continues, or that continue it
                nothing was at its new end before, nothing at its old end since, and one of both
                is dynamic
            it continues dynamic objects, forwards or backwards in time, seen from above
                as a whole: it covers most columns of each, and they cover at least half of it,
                and most of those of its columns that anything had visited by then
                as a part: one of them covers most of it, in columns to which a track came before
                anything else
                a column where something static, no larger, was in the same scan does not count
                in both cases, its track must once have had as many columns that are dynamic by
                themselves, less others, as it has columns
        what a place inherits
            the mean certainty of the objects that were there, 1 for dynamic ones

    a point is removed if
        the evidence of its place, and ``inherit`` times what the place inherits if that is above
        0, are above 0 together
        or it is low, next to such a point, and 5 cm above the ground or in a voxel whose evidence
        is above the prior

A ray crosses the voxels from the sensor's up to, but not including, the voxel of its point. Points
that are not finite and points more than 32768 voxels from the world's origin are kept unjudged.
Online, all this is computed for each scan from the scans so far, with the objects of the last 64 of
them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I32, I64, U8, U64, Bool, all_finite
from dynaviz.blocks.blocks import VOXELS, BlockGrid, Marks, voxels_of
from dynaviz.contracts.evidence import Asked, Evidence, Quantity, Rule, Term, voxels_around
from dynaviz.contracts.extent import CELL, Extent
from dynaviz.contracts.method import Cause, Context, Halo, Labels, MethodInfo, Reason
from dynaviz.contracts.params import require
from dynaviz.contracts.probe import Mask, PointClasses, State, Voxels
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.spatial.scan_ground import EXACT, ScanGround
from dynaviz_methods.seethrough.clear_grid import ClearGrid
from dynaviz_methods.seethrough.history import Decision, History
from dynaviz_methods.seethrough.level import Level
from dynaviz_methods.shared.codes import pack_codes, unpack_codes
from dynaviz_methods.shared.lookups import known

KERNELS = kernels.load("dynaviz_methods.seethrough.kernels")
SHARED = kernels.load("dynaviz_methods.shared.kernels")

SPACINGS = 2.7  # mean angles between rays, across which points are joined beyond ``join_angle``
STEP = 0.2  # degrees between two rays of a ring, unless the sensor's facts state it
HIGHEST = 4.5  # metres above the ground, which no mover exceeds
LIFTED = 4 * CELL, CELL  # metres: most by which scans are levelled, in recorded sequences and live
OBJECT = 30.0  # metres: the largest object, around a tile
ON_GROUND, NEAR_GROUND, ABOVE, TOO_HIGH = BANDS = range(4)  # of heights: see ``scan_ground.bands``


@dataclass(frozen=True)
class SeeThroughParams:
    """Parameters of SeeThrough.

    Attributes:
        resolution: edge of a voxel, metres.
        guard: a crossed voxel is not clear if this scan or the one before has a hit within this
            distance, metres; at most 7 voxels.
        votes: number of clear scans for the full evidence of a voxel; of hits, for that of a place.
        near: weight of a crossing near a hit, against one clear crossing.
        hit: weight of a hit, against one clear crossing; share of the scans in which an object that
            moved is displaced.
        prior: evidence that a place must exceed in 64 scans or more, with what it inherits, from 0
            to less than 1; hits alone are at most so much evidence against it.
        inherit: weight of what a place inherits from objects.
        ground_height: points up to this above the ground are low, metres.
        join_angle: points are joined to objects across about this angle plus 2.7 times that between
            rays, degrees.
    """

    resolution: float = 0.1
    guard: float = 0.3
    votes: int = 4
    near: float = 0.35
    hit: float = 0.12
    prior: float = 0.13
    inherit: float = 0.5
    ground_height: float = 0.15
    join_angle: float = 0.7

    def __post_init__(self) -> None:
        most = 7 * self.resolution
        require(self, "resolution", lambda edge: 0 < edge < np.inf, "metres above 0")
        require(self, "join_angle", lambda angle: 0 <= angle < 90, "degrees from 0 to less than 90")
        require(
            self,
            "guard",
            lambda guard: 0 <= guard <= most * 1.001,
            f"metres from 0 to 7 voxels, {most:g} m",
        )
        require(
            self, "votes", lambda scans: 1 <= scans <= 65535, "a number of scans from 1 to 65535"
        )
        require(
            self, "near hit inherit", lambda weight: 0 <= weight < np.inf, "a weight of at least 0"
        )
        require(self, "prior", lambda evidence: 0 <= evidence < 1, "evidence from 0 to less than 1")
        require(self, "ground_height", np.isfinite, "metres")


NEVER_CLEAR, TOO_LITTLE, LOW, OUT_OF_REACH, SEEN_THROUGH, FOLLOWED, FOOT, HIGH = range(8)
REASONS = (
    Reason(
        "never_clear", "kept: its voxel was not seen clear more than occupied", Cause.NOTHING_BEHIND
    ),
    Reason("too_little_clear", "kept: too little of its place was seen clear", Cause.STANDING),
    Reason("low", "kept: near the ground, and not under a dynamic object", Cause.TAKEN_FOR_GROUND),
    Reason(
        "out_of_reach",
        "kept unjudged: not finite, or more than 32768 voxels from the origin",
        Cause.OUT_OF_RANGE,
    ),
    Reason("seen_through", "removed: its place was seen clear", Cause.SHARED_CELL),
    Reason(
        "followed", "removed: the objects in its place are dynamic as a whole", Cause.SHARED_CELL
    ),
    Reason("foot", "removed: low, but under a dynamic object", Cause.SHARED_CELL),
    Reason(
        "high",
        "kept: more than 4.5 m above the ground, where no mover is expected",
        Cause.HEIGHT_LIMIT,
    ),
)
BY_PLACE = (OUT_OF_REACH, LOW, HIGH, TOO_LITTLE, NEVER_CLEAR, SEEN_THROUGH, FOLLOWED)
REMOVED = np.isin(np.arange(len(REASONS)), (SEEN_THROUGH, FOLLOWED, FOOT))  # (R,) bool, by code
STATES = (
    State(
        "clear",
        Voxels,
        "Voxels with points that this scan saw clear; number of such scans",
        value_range=(1, 6),
    ),
    State(
        "passed",
        Voxels,
        "Voxels with points, crossed near hits of this scan or the last one: no evidence",
    ),
    State(
        "objects",
        PointClasses,
        "Points by the scans so far: low, static, dynamic, of a place that inherits, foot",
        legend=("static", "low", "dynamic", "followed", "foot"),
    ),
    State("low", Mask, "Points near the ground: removed only under a dynamic object"),
)
CLASS = np.array([0, 0, 1, 0, 2, 3, 4, 0], np.uint8)  # reason code to class of the legend


@dataclass(frozen=True, eq=False)
class Measured:
    """What one scan shows.

    Attributes:
        number: its position.
        scan: levelled; bands: (N,) uint8, how high its points are above the ground: one of
            ``BANDS``.
        voxels: (N,) int64, -1 for none.
        tilt: (3,) float64, the error of the pose that was subtracted, as from ``Level``.
    """

    number: int
    scan: Scan
    bands: U8
    voxels: I64
    tilt: F64


@dataclass(frozen=True, eq=False)
class Judged:
    """What decided the labels of the scan that was judged last."""

    measured: Measured
    decision: Decision
    reasons: U8


class SeeThrough:
    """SeeThrough; in online mode it labels each scan by the scans so far."""

    info: ClassVar[MethodInfo] = MethodInfo(
        "seethrough",
        "SeeThrough",
        "dynaviz, 2026",
        REASONS,
        STATES,
        uses=("elevation",),
        colour=(75, 60, 255),
    )
    Params: ClassVar[type[Any]] = SeeThroughParams

    def __init__(self, params: Any) -> None:
        self.params = params

    def begin(self, context: Context) -> None:
        """Allocate the map where points will lie."""
        p = self.params
        self._probe = context.probe
        self._grid = ClearGrid(context.extent, p.resolution, LIFTED[0], context.sensor)
        rows = len(self._grid) + 1  # points without a voxel (-1) read the last row
        self._counts = tuple(
            self._grid.per_block(np.zeros((rows, VOXELS), np.uint16)) for _ in range(3)
        )
        weights = float(p.near), float(p.hit), float(p.votes), float(p.prior)
        self._history = History(self._grid, float(p.guard), float(p.inherit), weights, self._counts)
        self._angle = math.radians(p.join_angle + SPACINGS * _spacing(context.sensor))
        self._level = Level(LIFTED[self._grid.rolls] - p.resolution)
        self._observed = 0
        self._judged: Judged | None = None
        self._measured: Measured | None = (
            None  # the scan that was observed last, which online is labelled next
        )
        self._decided: tuple[int, bool, Decision] = -1, False, self._history.decide()
        self._number: dict[int, int] = {}  # by scan index: its position among the observed scans
        self._tilts: dict[int, F64] = {}  # by position
        self._sensor_height = -np.inf  # metres above the ground, in the last scan that shows it
        self._before: dict[int, float] = {}  # by position: the same when the scan came
        self._bands: dict[int, U8] = {}  # by scan index, until it is labelled; packed
        self._reasons: dict[int, U8] = {}  # by scan index: four bits per point, packed

    @classmethod
    def compile_ahead(cls, scan: Scan) -> None:
        """Count the voxels of a scan, and join its points to objects."""
        chosen = all_finite(scan.points)
        grid = BlockGrid(Extent.of(scan), 0.2)
        marks = grid.mark(scan, chosen, chosen)
        bits = np.zeros((len(marks.blocks) + 1, 8), np.uint64)
        near = SHARED.clearance.grown(bits, np.zeros((len(marks.blocks), 6), np.int32), 1)
        counts = [np.zeros((len(grid) + 1, VOXELS), np.uint16) for _ in range(3)]
        SHARED.clearance.count(marks.blocks, marks.bits, near, *counts)
        at = kernels.as_readonly(scan.position[:2], np.float64)
        objects, cells, wider = KERNELS.objects.cells_of(scan.points, chosen, at, 0.2, 0.05)
        order = np.argsort(cells)
        KERNELS.objects.connect(objects, order, cells[order], wider)

    def observe(self, scan: Scan) -> None:
        """Count the voxels that the scan hits, crosses and sees clear, and let its
        places inherit.
        """
        p = self.params
        now = self._number[scan.index] = self._observed
        self._before[now] = self._sensor_height
        surface = ScanGround.of(scan.points, scan.position, height_before=self._sensor_height)
        if surface.sensor_height > -np.inf:
            self._sensor_height = surface.sensor_height
        self._tilts[now] = self._level.error(surface, scan.position)
        self._observed = now + 1
        measured = self._measured = self._measure(
            scan, self._bands_of(surface.heights(scan.points))
        )
        self._bands[scan.index] = pack_codes(measured.bands)
        marks = self._grid.mark_once(measured.scan, measured.voxels)
        near = self._grid.near(marks, round(p.guard / p.resolution))
        SHARED.clearance.count(marks.blocks, marks.bits, near, *self._counts)
        chosen = (measured.voxels >= 0) & (measured.bands == ABOVE)
        at = kernels.as_readonly(scan.position[:2], np.float64)
        objects, cells, wider = KERNELS.objects.cells_of(
            measured.scan.points, chosen, at, p.resolution, self._angle
        )
        # turns cells into objects
        order = np.argsort(cells)
        count = KERNELS.objects.connect(objects, order, cells[order], wider)
        self._history.add(now, measured.scan.points, measured.voxels, objects, count)
        self._show(measured, marks, near)

    def label(self, scan: Scan) -> Labels:
        """Label the points of a scan; decided when it is labelled for the first time.

        A scan that was observed last is labelled by the scans so far, unless another one was
        labelled since.
        """
        if scan.index not in self._reasons:
            number = self._number[scan.index]
            measured = self._measured
            packed = self._bands.pop(scan.index, None)
            if measured is None or measured.number != number:
                bands = (
                    self._bands_of(self._heights(scan))
                    if packed is None
                    else unpack_codes(packed, len(scan))
                )
                measured = self._measure(scan, bands)
            decision = self._decision(online=number + 1 == self._observed)
            self._reasons[scan.index] = pack_codes(self._outcomes(measured, decision))
        reasons = unpack_codes(self._reasons[scan.index], len(scan))
        return Labels(REMOVED.take(reasons), reasons)

    def forget(self, index: int) -> None:
        """Drop what is stored about a scan."""
        number = self._number.pop(index, -1)
        self._reasons.pop(index, None)
        self._bands.pop(index, None)
        self._tilts.pop(number, None)
        self._before.pop(number, None)
        self._history.forget(number)

    def relabel(self, scans: Sequence[Scan]) -> list[Labels]:
        """Label scans again by all that is known, as if none had been labelled.

        The stored labels stay.
        """
        stored = self._reasons
        decided = self._decided
        self._reasons = {}
        self._decided = (self._observed, True, self._history.decide())
        try:
            return [self.label(scan) for scan in scans]
        finally:
            self._reasons = stored
            self._decided = decided

    def _decision(self, online: bool) -> Decision:
        """What decides the labels by the scans so far.

        Unless asked for online use, by all visits of these.
        """
        at, whole, decision = self._decided
        if at != self._observed or not (whole or online):
            decision = self._history.decide(online)
            self._decided = self._observed, not online, decision
        return decision

    def _heights(self, scan: Scan) -> F32:
        """(N,) float32, metres: height of the points of an observed scan above its ground.

        Infinite if unknown.
        """
        before = self._before[self._number[scan.index]]
        ground = ScanGround.of(scan.points, scan.position, height_before=before)
        return ground.heights(scan.points)

    def _bands_of(self, heights: F32) -> U8:
        exact, low, highest = (
            np.float32(limit) for limit in (EXACT, self.params.ground_height, HIGHEST)
        )
        bands: U8 = kernels.scan_ground.bands(heights, exact, low, highest)
        return bands

    def _measure(self, scan: Scan, bands: U8) -> Measured:
        """What an observed scan shows; bands: (N,) uint8, those of its points."""
        number = self._number[scan.index]
        levelled = _levelled(scan, self._tilts[number])
        voxels = self._grid.locate(levelled.points)
        lost = np.flatnonzero(voxels < 0) if self._tilts[number].any() else ()
        if len(lost):
            given = self._grid.locate(scan.points[lost])
            self._grid.extend(levelled.points[lost[given >= 0]])
            found = self._grid.locate(levelled.points[lost])
            voxels[lost] = np.where(found < 0, given, found)  # beyond the room for blocks
        return Measured(number, levelled, bands, voxels, self._tilts[number])

    def _scans(self, voxels: I64) -> tuple[F64, F64, F64]:
        """The number of scans, (K,) float64 each, that hit, passed and saw clear voxels (K,).

        NaN for voxel -1.
        """
        hits, clear, grazed = (known(of[voxels >> 9, voxels & 511], voxels) for of in self._counts)
        return hits, clear + grazed, clear

    def _outcomes(self, measured: Measured, decision: Decision) -> U8:
        """Reason code of each point of an observed scan, (N,) uint8."""
        of_places = decision.rows, decision.own, decision.shared, decision.inherit
        of_voxels = *self._counts, decision.weights
        reasons: U8 = KERNELS.places.outcomes(
            measured.voxels, measured.bands, *of_places, *of_voxels, BY_PLACE
        )
        under = self._under(measured, reasons)
        if under.any():
            empty = KERNELS.places.of_points(np.where(under, measured.voxels, -1), *of_voxels)
            reasons[
                under & ((measured.bands == NEAR_GROUND) | (empty > np.float32(decision.prior)))
            ] = FOOT
        self._judged = Judged(measured, decision, reasons)
        return reasons

    def _under(self, measured: Measured, reasons: U8) -> Bool:
        """(N,) bool: low points under, or in a column of voxels next to, dynamic points that are
        not low.
        """
        chosen = REMOVED.take(reasons) & (reasons != FOOT)
        low = (reasons == LOW) | (reasons == FOOT)
        under: Bool = KERNELS.squares.in_or_next_to(
            measured.scan.points, chosen, low, self.params.resolution
        )
        return under

    def halo(self) -> Halo:
        """The size of an object, and of what it inherits from."""
        return Halo(OBJECT)

    def evidence(self, asked: Asked) -> Evidence:
        """How often scans hit, passed and saw clear the points' voxels.

        What their places show and inherit.
        """
        number = self._number.get(asked.scan.index, -1)
        scan = _levelled(asked.scan, self._tilts[number]) if number in self._tilts else asked.scan
        voxels = self._grid.locate(scan.points)[asked.rows]
        hits, passed, clear = self._scans(voxels)
        quantities = [
            Quantity(name, of, total=True)
            for name, of in (("hit", hits), ("passed", passed), ("clear", clear))
        ]
        judged = self._judged
        rules: tuple[Rule, ...] = ()
        if judged is not None and judged.measured.scan.index == asked.scan.index:
            decision = judged.decision
            of = judged.measured.voxels[asked.rows]
            rows = decision.rows[of >> 9 << 2 | of >> 7 & 2 | of >> 5 & 1]
            own = known(decision.own[rows], of)
            shared = known(decision.shared[rows], of)
            source = known(np.where(decision.source[rows] < 0, np.nan, decision.source[rows]), of)
            of_places = ("place", own), ("objects", shared), ("dynamic in", source)
            quantities += [Quantity(name, of) for name, of in of_places]
            rules = self._rules(judged, asked, own + decision.inherit * np.maximum(shared, 0.0))
        return Evidence(
            voxels_around(asked.points, self.params.resolution), tuple(quantities), rules
        )

    def _rules(self, judged: Judged, asked: Asked, total: F64) -> tuple[Rule, ...]:
        """The rules that remove points."""
        measured = judged.measured
        p = self.params
        decision = judged.decision
        rows = asked.rows
        voxels = measured.voxels[rows]
        height = self._heights(asked.scan)[rows]
        empty = known(KERNELS.places.of_points(voxels, *self._counts, decision.weights), voxels)
        up = (
            Term(
                "height above the ground",
                height,
                ">",
                float(np.float32(p.ground_height)),
                "m",
                "ground_height",
                "otherwise",
            ),
            Term("more than 4.5 m above the ground", measured.bands[rows] == TOO_HIGH, "<", 1),
        )
        prior = float(np.float32(decision.prior))
        place = Term("evidence", total + prior, ">", prior, parameter="prior", follows="otherwise")
        under = self._under(measured, judged.reasons)
        stands = Term("height above the ground", height, ">", float(np.float32(EXACT)), "m")
        near = Term(
            "low and near a dynamic object", np.where(np.isnan(empty), np.nan, under[rows]), ">=", 1
        )
        name = "evidence of its voxel"
        return (
            Rule("place", (*up, place)),
            Rule("foot", (near, stands)),
            Rule("empty foot", (near, Term(name, empty, ">", prior, "", "prior", "otherwise"))),
        )

    def _show(self, measured: Measured, marks: Marks, near: U64) -> None:
        wants = self._probe.wants
        emit = self._probe.emit
        for name, among in (("clear", ~near), ("passed", near)):
            if wants(name):
                through = marks.bits[:, :8] & ~marks.bits[:, 8:]
                voxels = voxels_of(marks.blocks, through & among.view(np.int64))
                voxels = voxels[self._counts[0].ravel()[voxels] > 0]
                count = self._scans(voxels)[2].astype(np.float32) if name == "clear" else None
                emit(name, Voxels(self._shown(voxels, measured), self._grid.resolution, count))
        if wants("objects"):
            emit(
                "objects",
                PointClasses(CLASS[self._outcomes(measured, self._decision(online=True))]),
            )
        if wants("low"):
            emit("low", Mask(measured.bands < ABOVE))

    def _shown(self, voxels: I64, measured: Measured) -> I32:
        """(K, 3) int32: indices of voxels, raised and tilted like the points of a scan that was
        levelled.
        """
        keys = self._grid.keys(voxels)
        if measured.tilt.any():
            size = self._grid.resolution
            lift = _lift((keys + 0.5) * size, measured.scan.position, measured.tilt)
            keys = keys + np.outer(np.round(lift / size), (0, 0, 1)).astype(np.int32)
        return keys


def _spacing(sensor: Sensor) -> float:
    """Mean angle between adjacent rays of a sensor, degrees.

    ``STEP`` if its view or their number is unknown.
    """
    begin, end = sensor.azimuth
    ring = (end - begin) / (sensor.azimuth_step or STEP)
    rays = sensor.points_per_sweep or ((sensor.rings or 1) - 1) * ring
    if not sensor.elevation or not rays:
        return STEP
    low, high = sensor.elevation
    return math.sqrt((high - low) * (end - begin) / rays)


def _levelled(scan: Scan, tilt: F64) -> Scan:
    """A scan without an error of its pose, (3,), as from ``Level``."""
    if not tilt.any():
        return scan

    def lowered(xyz: Any) -> Any:
        found = xyz.copy()
        found[:, 2] -= _lift(xyz, scan.position, tilt).astype(xyz.dtype)
        return found

    (x, y, _) = scan.position.tolist()
    (c, a, b) = tilt.tolist()
    shear = np.eye(4)
    shear[2] = -a, -b, 1.0, a * x + b * y - c
    return replace(
        scan,
        points=lowered(scan.points),
        T_world_sensor=shear @ scan.T_world_sensor,
        origins=lowered(scan.origins),
    )


def _lift(xyz: F32 | F64, position: F64, tilt: F64) -> F32 | F64:
    """(N,) metres: how much the error of a pose, (3,), as from ``Level``, lifts points (N, 3) of a
    sensor (3,).
    """
    (x, y, _) = position.tolist()
    (c, a, b) = tilt.tolist()
    lift: F32 | F64 = c + a * (xyz[:, 0] - x) + b * (xyz[:, 1] - y)
    return lift
