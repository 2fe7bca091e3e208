"""BeautyMap: binary columns of height slices.

Slices that are in the map but not in a scan are dynamic.

Jia et al. 2024. The algorithm:

    divide the map into columns of width xy_resolution
    set the base of each column to its lowest point, bounded by the bases of the preceding columns
    set bit k of a column if the map has points in slice k, h_res high, counted from the base
    for each scan, in a square window of side dis_range around the sensor
        encode the scan in the map's columns; remove the slices that are in the map but not in the
            scan, except
        near:      slices within 2 m of the sensor
        sight:     from 15 m on, slices of a column where the scan sees no ground
        seen:      in a column, slices from the highest one that the scan sees upwards
        view:      where the scan sees none, slices from the upper edge of its field of view upwards
        ground:    the lowest slice of a column
        overhang:  slices above a gap of two slices
        blocked:   slices with scan points in front of them on the line from the sensor
        split the slice below the lowest removed slice: its lowest fine bins, with 85 % of its
            points, are ground
    label a point dynamic if any scan removes its slice, or splits its slice and the point is above
        the ground bins

Slice 0 extends as far below the base as above it, and slice 30, the highest, includes everything
above it. Points below slice 0 are kept unjudged. So are points that are not finite, or more than
32768 columns or 1000 km of height from the world's origin.

Live, the map is that of the scans that are not forgotten yet. It is encoded anew with each scan,
because a single lower point can move the bases of many columns, and all scans in it are compared
again. So the labels of a scan are those of an offline run that ends with it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I32, I64
from dynaviz.blocks.window import Window
from dynaviz.contracts.evidence import Asked, Evidence, Quantity, Rule, Term
from dynaviz.contracts.method import Cause, Context, Labels, MethodInfo, Reason
from dynaviz.contracts.params import require
from dynaviz.contracts.probe import Mask, Scalar, State, Voxels
from dynaviz.contracts.scan import Scan
from dynaviz_methods.beautymap.column_map import GAP, REACH, SLICES, Cloud, ColumnMap, Placed

KERNELS = kernels.load("dynaviz_methods.beautymap.kernels")

BLIND = 2.0  # metres around the sensor where nothing is judged
SIGHT = 15.0  # metres; farther columns are judged only if the scan sees their ground
SKIP = 3  # columns in x and y together, up to which nothing blocks the line of sight
CHUNK = 1 << 20  # points of the raw map that are encoded at a time


@dataclass(frozen=True)
class BeautyMapParams:
    """Parameters of BeautyMap; the defaults are the paper's for KITTI.

    Attributes:
        dis_range: side of the square window around the sensor, metres.
        xy_resolution: side of a column, metres.
        h_res: height of a slice, metres.
    """

    dis_range: float = 40.0
    xy_resolution: float = 1.0
    h_res: float = 0.5

    def __post_init__(self) -> None:
        cell = self.xy_resolution
        require(
            self,
            "dis_range xy_resolution h_res",
            lambda metres: 0 < metres < math.inf,
            "metres above 0",
        )
        require(
            self,
            "dis_range",
            lambda far: 2 <= far / cell <= 4096,
            f"2 to 4096 times xy_resolution = {cell}",
        )


UNJUDGED = 0
NEVER_NEAR = 1
ALWAYS_SEEN = 2
FINE_GROUND = 10
SLICE_GONE = 11
ABOVE_GROUND = 12
REASONS = (
    Reason(
        "unjudged",
        "kept: not finite, too far from the world's origin, not in the map, or below slice 0",
        Cause.OUT_OF_RANGE,
    ),
    Reason(
        "out_of_window",
        "kept: its column was never within the window around the sensor",
        Cause.OUT_OF_RANGE,
    ),
    Reason(
        "always_seen",
        "kept: every scan with its column in the window saw its slice",
        Cause.STANDING,
    ),
    Reason(
        "near_sensor",
        "kept: the scans that missed its slice were too close to judge it",
        Cause.OUT_OF_RANGE,
    ),
    Reason(
        "ground_not_seen",
        "kept: the scans that missed its slice were far away and saw no ground in its column",
        Cause.SPARSE_RINGS,
    ),
    Reason(
        "above_highest_seen",
        "kept: its slice is above the highest slice that the scans saw in its column",
        Cause.HEIGHT_LIMIT,
    ),
    Reason(
        "above_view",
        "kept: its slice is above the field of view of the scans that missed it",
        Cause.HEIGHT_LIMIT,
    ),
    Reason("ground_slice", "kept: in the lowest slice of its column", Cause.TAKEN_FOR_GROUND),
    Reason(
        "overhang",
        "kept: above a gap of two empty slices, or of two empty fine bins",
        Cause.HEIGHT_LIMIT,
    ),
    Reason(
        "ray_blocked",
        "kept: scans that missed its slice had their view of it blocked",
        Cause.NOTHING_BEHIND,
    ),
    Reason(
        "fine_ground",
        "kept: in the slice below the removed slices, among its lowest 85 % of points",
        Cause.TAKEN_FOR_GROUND,
    ),
    Reason(
        "not_in_scan", "removed: a scan should have seen its slice but did not", Cause.SPARSE_RINGS
    ),
    Reason(
        "above_fine_ground",
        "removed: in the slice below the removed slices, above its lowest 85 % of points",
        Cause.SHARED_CELL,
    ),
)
STEPS = (
    "map_slices",
    "near_sensor",
    "ground_not_seen",
    "above_highest_seen",
    "above_view",
    "ground_slice",
    "overhang",
    "ray_blocked",
    "removed",
)
OUTCOMES = ("in scan", *STEPS[1:])  # of a slice of the map that is in a scan's window
REMOVED = len(OUTCOMES) - 1
HEIGHT = (0.0, 6.0)
_SLICES = {
    "map_slices": "Occupied slices of the map in this scan's window",
    "scan_slices": "Slices of the map that this scan sees",
    "near_sensor": "Unseen slices kept: too near the sensor",
    "ground_not_seen": "Unseen slices kept: far away, and no ground is seen",
    "above_highest_seen": "Unseen slices kept: above the highest seen slice",
    "above_view": "Unseen slices kept: above the field of view",
    "ground_slice": "Unseen slices kept: the lowest of their columns",
    "overhang": "Unseen slices kept: above a gap",
    "ray_blocked": "Unseen slices kept: view of them is blocked",
    "removed": "Unseen slices that this scan removes",
}
STATES = (
    *(
        State(name, Voxels, f"{text}; slices above the base", value_range=HEIGHT)
        for name, text in _SLICES.items()
    ),
    State("fine_ground", Mask, "Points kept as the ground of a split slice, by the scans so far"),
    State(
        "view_slope",
        Scalar,
        "Upper edge of the field of view: metres of height per metre of distance",
    ),
)


@dataclass(frozen=True)
class _Window:
    """The columns around the sensor.

    ``first`` (2,) is the lowest, ``columns`` (W, W) are their rows, -1 if empty.
    """

    first: I64
    columns: I64


@dataclass(frozen=True)
class _View:
    """A sensor's position (3,) and the slope of the upper edge of its field of view."""

    sensor: F64
    slope: float

    @classmethod
    def of(cls, scan: Scan, points: F32) -> _View:
        sensor = kernels.as_readonly(scan.position, np.float64)
        return cls(sensor, float(KERNELS.columns.steepest(points, sensor)))


@dataclass
class _Edge:
    """Lets a live session begin anew before the sensor leaves the columns' reach."""

    farthest: float  # metres from the world's origin

    def grow(self, cells: I32, position: F64) -> bool:
        return True

    def shrink(self, position: F64, limit: float) -> None:
        return


class BeautyMap:
    """BeautyMap, with a label for every point."""

    info: ClassVar[MethodInfo] = MethodInfo(
        "beautymap",
        "BeautyMap",
        "Jia et al., RA-L 2024",
        REASONS,
        STATES,
        needs_map=True,
        colour=(255, 60, 135),
    )
    Params: ClassVar[type[Any]] = BeautyMapParams

    def __init__(self, params: Any) -> None:
        self.params = params

    def begin(self, context: Context) -> None:
        """Encode the raw map in columns; the points themselves are not stored.

        Live, there is no map yet.
        """
        self._probe = context.probe
        side = self.params.xy_resolution
        self._recent: dict[int, tuple[_View, Cloud]] = {}  # live: the scans in the map, by index
        self._live = context.raw_map is None
        if isinstance(context.extent, Window):
            context.extent.attach(_Edge(REACH * side))
        raw = kernels.as_readonly(
            np.zeros((0, 3)) if context.raw_map is None else context.raw_map, np.float32
        )
        self._encode(
            [
                Cloud.of(raw[start : start + CHUNK], side)
                for start in range(0, max(len(raw), 1), CHUNK)
            ]
        )
        self._map.find_ground(self._map.bits)

    def observe(self, scan: Scan) -> None:
        """Compare the scan's slices with the map's; split the slices below the removed ones."""
        points = kernels.as_readonly(scan.points, np.float32)
        view = _View.of(scan, points)
        if not self._live:
            self._compare(view, self._map.place(points))
        else:
            self._recent[scan.index] = view, Cloud.of(points, self.params.xy_resolution)
            self._encode([cloud for _, cloud in self._recent.values()], keep=True)
            for n, (each, _) in enumerate(self._recent.values()):
                self._compare(each, self._map.placed(n))
            self._map.find_ground(self._splits)
        self._show(scan, view.slope)

    def label(self, scan: Scan) -> Labels:
        """Label points dynamic whose slice is removed, or is split with the point above its ground.

        The reason is that of the scan that came closest to removing the slice.
        """
        points = kernels.as_readonly(scan.points, np.float32)
        reasons = self._map.reasons(points, self._steps, self._splits)
        return Labels((reasons == SLICE_GONE) | (reasons == ABOVE_GROUND), reasons)

    def forget(self, index: int) -> None:
        """Leave a scan out of the map from the next scan on."""
        self._recent.pop(index, None)

    def _encode(self, clouds: Sequence[Cloud], keep: bool = False) -> None:
        self._map = ColumnMap(clouds, self.params.xy_resolution, self.params.h_res, keep)
        self._steps = np.zeros((len(self._map), len(STEPS)), np.int32)  # bits of all scans so far
        self._splits = np.zeros(len(self._map), np.int32)
        # where columns are in the window of a scan
        self._places = np.full(len(self._map), -1, np.int32)
        self._last: tuple[_Window, I32, I32] | None = (
            None  # window, slices and outcome of the last scan
        )

    def _compare(self, view: _View, placed: Placed) -> None:
        """Remove slices of the map that a scan does not see."""
        p = self.params
        columns = self._map
        self._last = None
        if not np.isfinite(view.sensor).all():
            return
        window = self._window(view.sensor)
        middle = len(window.columns) // 2
        seen = self._seen(window, placed)
        under = window.columns[middle, middle]
        base = float(columns.base[under]) if under >= 0 else math.nan
        if math.isnan(base):
            base = columns.lowest  # the map has no point in the sensor's column
        outcome = KERNELS.columns.judge(
            *(window.columns, columns.bits, columns.base, columns.raised, seen),
            *(
                float(view.sensor[2] - base) / p.h_res + 0.5,
                base,
                view.slope * p.xy_resolution / p.h_res,
            ),
            *(
                int(BLIND / p.xy_resolution) + 1,
                SIGHT / p.xy_resolution,
                GAP,
                SKIP,
                self._steps,
                self._splits,
            ),
        )
        self._last = window, seen, outcome

    def _seen(self, window: _Window, placed: Placed) -> I32:
        """(W, W) int32: the slices in the window with points of a scan."""
        seen = np.zeros(window.columns.shape, np.int32)
        within = window.columns >= 0
        self._places[window.columns[within]] = np.flatnonzero(within)
        KERNELS.columns.look(*placed, self._places, seen.ravel())
        self._places[window.columns[within]] = -1
        return seen

    def evidence(self, asked: Asked) -> Evidence:
        """Whether the last scan saw the points' slices, and which step of the algorithm kept those
        that it missed.
        """
        points = kernels.as_readonly(asked.points, np.float32)
        column, k, fine, first, end = self._map.bins(points)
        saw = np.full(len(points), np.nan)
        split = self._splits[column] >> k & 1
        if self._last is not None:
            window, seen, outcome = self._last
            inside = np.isin(column, window.columns[window.columns >= 0]) & (column >= 0)
            at = np.argmax(window.columns.ravel() == column[inside, None], axis=1)
            of_scan = np.concatenate(
                [seen.reshape(-1, 1), outcome.reshape(-1, len(STEPS))[:, 1:]], 1
            )
            bits = of_scan[at] >> k[inside, None] & 1
            saw[inside] = np.argmax(bits, axis=1)
        seen_at, kept = (
            np.where(np.isnan(saw), np.nan, yes) for yes in (saw == 0, (saw > 0) & (saw < REMOVED))
        )
        missed = Term("in the scan", seen_at, "<", 1), Term("kept by a step", kept, "<", 1)
        above = Term("removed slice above it", np.where(k < 0, 0, split), ">=", 1)
        height = Term("fine bin", fine, ">=", first), Term("fine bin", fine, "<", end)
        rules = (
            Rule("slice missed", missed, lasting=True),
            Rule("above the ground", (above, *height)),
        )
        quantities = (
            Quantity("outcome", saw, legend=OUTCOMES),
            Quantity("split", split.astype(float), total=True),
        )
        return Evidence(self._boxes(column, k), quantities, rules)

    def _boxes(self, column: I64, k: I64) -> F64:
        """(K, 2, 3) float64, metres: lowest and highest corner of slices; NaN where k is -1."""
        p = self.params
        sides = np.array([p.xy_resolution, p.xy_resolution, p.h_res])
        low = np.column_stack([self._map.corners(column), k]) * sides
        low[:, :2] += self._map.corner
        low[:, 2] += self._map.base[column]
        low[k < 0] = np.nan
        return np.stack([low, low + sides], 1)

    def _window(self, sensor: F64) -> _Window:
        """The columns around the sensor.

        Half of them before the sensor's column, half from it on, along each axis.
        """
        half = max(int(self.params.dis_range / self.params.xy_resolution / 2), 1)
        at = np.clip((sensor[:2] - self._map.corner) / self.params.xy_resolution, -(2**40), 2**40)
        first = np.floor(at).astype(np.int64) - half
        return _Window(first, self._map.window(first, 2 * half))

    def _show(self, scan: Scan, slope: float) -> None:
        if self._last is None:
            return
        window, seen, outcome = self._last
        for name, bits in {
            **dict(zip(STEPS, np.moveaxis(outcome, 2, 0), strict=True)),
            "scan_slices": seen,
        }.items():
            if self._probe.wants(name):
                self._probe.emit(name, self._cubes(window, bits))
        if self._probe.wants("fine_ground"):
            self._probe.emit("fine_ground", Mask(self.label(scan).reasons == FINE_GROUND))
        self._probe.emit("view_slope", Scalar(slope))

    def _cubes(self, window: _Window, bits: I32) -> Voxels:
        """Slices as cubes of the world's grid, at most half a cube from their exact position."""
        p = self.params
        edge = min(p.xy_resolution, p.h_res)
        across = round(p.xy_resolution / edge)
        above = round(p.h_res / edge)
        i, j, k = np.nonzero(bits[:, :, None] >> np.arange(SLICES) & 1)
        base = self._map.base[window.columns[i, j]]
        corners = np.stack(
            [
                (window.first[0] + i) * p.xy_resolution,
                (window.first[1] + j) * p.xy_resolution,
                base,
            ],
            1,
        )
        corners[:, :2] += self._map.corner
        corners[:, 2] += k * p.h_res
        within = np.indices((across, across, above)).reshape(3, -1).T + 0.5
        size = np.array([p.xy_resolution / across] * 2 + [p.h_res / above])
        centres = corners[:, None] + within[None] * size
        keys = np.floor(centres / edge).astype(np.int32).reshape(-1, 3)
        return Voxels(keys, edge, np.repeat(k, len(within)).astype(np.float32))
