"""BeautyMap: columns of bits, one for each slice of height; what the map holds and a scan does not see has moved.

Jia et al. 2024. The algorithm:

    the map's columns, xy_resolution wide, have their base at their lowest point, held near that of columns before them;
    bit k of a column tells whether the map holds points in its slice k, h_res high, counted from the base
    for each scan, in a square window of dis_range around the sensor
        bits of the scan, on the map's bases; slices to be removed: in the map, not in the scan, but
        near:      nothing within 2 m of the sensor
        sight:     nothing of a column from 15 m on where the scan sees no ground
        seen:      nothing from the highest slice on that the scan sees in the column
        view:      where it sees none, nothing from the upper edge of its field of view on
        ground:    not the lowest slice of a column
        overhang:  nothing above a gap of two slices
        blocked:   no slice before which, on the line from the sensor, the scan sees something
        the slice below the lowest that is removed is split: its lowest fine bins, with 85 % of its points, are ground
    a point is dynamic if its slice is removed by any scan, or if any splits it and the point lies above its ground

Slice 0 reaches as far below the base as above, and slice 30, the highest, holds everything above it. Kept unjudged are
points deeper than slice 0, and those that are not finite, or lie more than 32768 columns or a thousand kilometres of
height from the world's origin.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F64, I32, I64
from dynaviz.method import Cause, Context, Labels, MethodInfo, Reason
from dynaviz.probe import Mask, Scalar, State, Voxels
from dynaviz.scan import Scan

REACH = 32768  # columns to each side of the world's origin
SLICES = 31
BLIND = 2.0  # metres around the sensor where nothing is judged
SIGHT = 15.0  # metres from where on a column is judged only if its ground is seen
GAP = 2  # empty slices, or fine bins, above which things hang
SKIP = 3  # columns in x and y together, up to which nothing blocks the sight
FINE = 0.1  # metres: fine bins are at least as high
GROUND_PART = 0.85  # of a split slice's points
NEIGHBOURS, LEAST, DEVIATIONS = 5, 15, 3.0  # columns back, of them with points, and how far a base may lie from them


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
        for name in ("dis_range", "xy_resolution", "h_res"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} = {getattr(self, name)}: give metres above 0")
        if not 2 <= self.dis_range / self.xy_resolution <= 4096:
            raise ValueError(f"dis_range = {self.dis_range}: give 2 to 4096 times xy_resolution = {self.xy_resolution}")


UNJUDGED, NEVER_NEAR, ALWAYS_SEEN, FINE_GROUND, SLICE_GONE, ABOVE_GROUND = 0, 1, 2, 10, 11, 12
REASONS = (
    Reason(
        "unjudged",
        "kept: not finite, too far from the world's origin, not of the map, or below slice 0",
        Cause.OUT_OF_RANGE,
    ),
    Reason("out_of_window", "kept: its column was never within the window around the sensor", Cause.OUT_OF_RANGE),
    Reason("always_seen", "kept: each scan with its column in the window saw its slice", Cause.STANDING),
    Reason("near_sensor", "kept: scans that missed its slice were too near to judge it", Cause.OUT_OF_RANGE),
    Reason(
        "ground_not_seen",
        "kept: scans that missed its slice were far and saw no ground in its column",
        Cause.SPARSE_RINGS,
    ),
    Reason(
        "above_highest_seen",
        "kept: scans that missed its slice saw at most what is below it, and something there",
        Cause.HEIGHT_LIMIT,
    ),
    Reason("above_view", "kept: its slice is above the field of view of scans that missed it", Cause.HEIGHT_LIMIT),
    Reason("ground_slice", "kept: the lowest slice of its column", Cause.TAKEN_FOR_GROUND),
    Reason("overhang", "kept: above a gap of two empty slices, or of two fine bins of its slice", Cause.HEIGHT_LIMIT),
    Reason("ray_blocked", "kept: whenever a scan missed its slice, something stood before it", Cause.NOTHING_BEHIND),
    Reason(
        "fine_ground",
        "kept: in the slice below removed ones, among the lowest 85 % of the points",
        Cause.TAKEN_FOR_GROUND,
    ),
    Reason("not_in_scan", "removed: a scan should have seen its slice, and did not", Cause.SPARSE_RINGS),
    Reason(
        "above_fine_ground",
        "removed: in the slice below removed ones, above the lowest 85 % of the points",
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
HEIGHT = (0.0, 6.0)
STATES = (
    State(
        "map_slices",
        Voxels,
        "Slices that the map holds in this scan's window; slices above the base",
        value_range=HEIGHT,
    ),
    State("scan_slices", Voxels, "Slices of them that this scan sees; slices above the base", value_range=HEIGHT),
    State("near_sensor", Voxels, "Unseen slices kept: too near the sensor; slices above the base", value_range=HEIGHT),
    State(
        "ground_not_seen", Voxels, "Unseen slices kept: far, and no ground is seen; above the base", value_range=HEIGHT
    ),
    State(
        "above_highest_seen", Voxels, "Unseen slices kept: above the highest seen; above the base", value_range=HEIGHT
    ),
    State(
        "above_view", Voxels, "Unseen slices kept: above the field of view; slices above the base", value_range=HEIGHT
    ),
    State(
        "ground_slice", Voxels, "Unseen slices kept: lowest of their columns; slices above the base", value_range=HEIGHT
    ),
    State("overhang", Voxels, "Unseen slices kept: above a gap; slices above the base", value_range=HEIGHT),
    State(
        "ray_blocked", Voxels, "Unseen slices kept: something stands before them; above the base", value_range=HEIGHT
    ),
    State("removed", Voxels, "Unseen slices that this scan removes; slices above the base", value_range=HEIGHT),
    State("fine_ground", Mask, "Points kept as ground of a slice that is split, as far as scans say until now"),
    State("view_slope", Scalar, "Upper edge of the field of view: metres up for each metre away"),
)


@dataclass(frozen=True)
class _Window:
    """Where a scan looks: ``first`` (2,) its lowest column, ``columns`` (W, W) their numbers, -1 without points."""

    first: I64
    columns: I64


class BeautyMap:
    """BeautyMap, with a label for every point of the map."""

    info: ClassVar[MethodInfo] = MethodInfo(
        "beautymap", "BeautyMap", "Jia et al., RA-L 2024", REASONS, STATES, needs_map=True
    )
    Params: ClassVar[type[Any]] = BeautyMapParams

    def __init__(self, params: Any) -> None:
        self.params = params

    def begin(self, context: Context) -> None:
        """Encode the raw map in columns; its points are not kept."""
        assert context.raw_map is not None  # as info.needs_map asks
        self._probe, p = context.probe, self.params
        points, k = kernels.as_readonly(context.raw_map, np.float32), kernels.columns
        low, high = k.bounds(points, REACH * p.xy_resolution)
        self._corner = np.where(np.isfinite(low), low, 0.0)
        shape = (np.nan_to_num((high - low) / p.xy_resolution, neginf=0.0) // 64).astype(np.int64) + 1
        tiles, n = k.directory(points, self._corner, p.xy_resolution, (int(shape[0]), int(shape[1])))
        self._grid = (self._corner, float(p.xy_resolution), tiles)
        low_z = k.lowest(points, *self._grid, n * 64 * 64)
        self._base, self._raised = k.level(low_z, tiles, NEIGHBOURS, LEAST, DEVIATIONS)
        self._lowest = float(np.fmin.reduce(low_z, initial=np.inf))
        self._fine_step = max(FINE, p.h_res / SLICES)
        self._bits, self._rows = k.fill(points, *self._grid, self._base, p.h_res)
        fine = k.histograms(points, *self._grid, self._base, p.h_res, self._fine_step, self._bits, self._rows)
        self._cuts = k.ground(fine, GROUND_PART, GAP)
        self._steps = np.zeros((len(self._base), len(STEPS)), np.int32)  # bits of all scans so far
        self._splits = np.zeros(len(self._base), np.int32)

    def observe(self, scan: Scan) -> None:
        """Compare the scan's slices with the map's, and split the slices below those that are removed."""
        p, sensor = self.params, scan.position
        if not np.isfinite(sensor).all():
            return
        window = self._window(sensor)
        width, middle = len(window.columns), len(window.columns) // 2
        eye = kernels.as_readonly(sensor, np.float64)
        seen, slope = kernels.columns.look(scan.points, *self._grid, self._base, p.h_res, window.first, width, eye)
        under = window.columns[middle, middle]
        base = float(self._base[under]) if under >= 0 else math.nan
        if math.isnan(base):
            base = self._lowest  # the map holds no point in the sensor's column
        said = kernels.columns.judge(
            *(window.columns, self._bits, self._base, self._raised, seen),
            *(float(sensor[2] - base) / p.h_res + 0.5, base, slope * p.xy_resolution / p.h_res),
            *(int(BLIND / p.xy_resolution) + 1, SIGHT / p.xy_resolution, GAP, SKIP, self._steps, self._splits),
        )
        self._show(scan, window, seen, said, slope)

    def label(self, scan: Scan) -> Labels:
        """Dynamic where the point's slice is removed, or split and the point above its ground.

        The reason is that of the scan that came nearest to removing the slice.
        """
        reasons = kernels.columns.reasons(
            *(scan.points, *self._grid, self._base, float(self.params.h_res), self._fine_step),
            *(self._bits, self._rows, self._steps, self._splits, self._cuts),
        )
        return Labels((reasons == SLICE_GONE) | (reasons == ABOVE_GROUND), reasons)

    def _window(self, sensor: F64) -> _Window:
        """The columns around the sensor's; as many before it as from it on."""
        half = max(int(self.params.dis_range / self.params.xy_resolution / 2), 1)
        tiles = self._grid[2]
        at = np.clip((sensor[:2] - self._corner) / self.params.xy_resolution, -(2**40), 2**40)
        first = np.floor(at).astype(np.int64) - half
        i, j = (first[a] + np.arange(2 * half) for a in (0, 1))
        inside = [(x >= 0) & (x < 64 * tiles.shape[a]) for a, x in enumerate((i, j))]
        tile = tiles[np.ix_(np.where(inside[0], i >> 6, 0), np.where(inside[1], j >> 6, 0))].astype(np.int64)
        columns = tile * 4096 + (i & 63)[:, None] * 64 + (j & 63)[None]
        columns[(tile < 0) | ~(inside[0][:, None] & inside[1][None])] = -1
        return _Window(first, columns)

    def _show(self, scan: Scan, window: _Window, seen: I32, said: I32, slope: float) -> None:
        for name, bits in {**dict(zip(STEPS, np.moveaxis(said, 2, 0), strict=True)), "scan_slices": seen}.items():
            if self._probe.wants(name):
                self._probe.emit(name, self._cubes(window, bits))
        if self._probe.wants("fine_ground"):
            self._probe.emit("fine_ground", Mask(self.label(scan).reasons == FINE_GROUND))
        self._probe.emit("view_slope", Scalar(float(slope)))

    def _cubes(self, window: _Window, bits: I32) -> Voxels:
        """Slices as cubes: as many as fit side by side and above one another, at most half a cube from their place."""
        p = self.params
        edge = min(p.xy_resolution, p.h_res)
        aside, above = round(p.xy_resolution / edge), round(p.h_res / edge)
        i, j, k = np.nonzero(bits[:, :, None] >> np.arange(SLICES) & 1)
        base = self._base[window.columns[i, j]]
        corners = np.stack([(window.first[0] + i) * p.xy_resolution, (window.first[1] + j) * p.xy_resolution, base], 1)
        corners[:, :2] += self._corner
        corners[:, 2] += k * p.h_res
        within = np.indices((aside, aside, above)).reshape(3, -1).T + 0.5
        size = np.array([p.xy_resolution / aside] * 2 + [p.h_res / above])
        centres = corners[:, None] + within[None] * size
        keys = np.floor(centres / edge).astype(np.int32).reshape(-1, 3)
        return Voxels(keys, edge, np.repeat(k, len(within)).astype(np.float32))
