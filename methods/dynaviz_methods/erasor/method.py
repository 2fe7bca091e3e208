"""ERASOR: in polar bins around the sensor, map points are dynamic where the map spans more height
than the scan.

Lim et al. 2021; the parameters are those of the benchmark (Zhang et al. 2023). The algorithm:

    downsample the raw map to the centroids of its voxels; measure heights from the ground below the
        sensor
    for every removal_interval-th scan, downsampled as well
        bins:    assign the points within max_range and within the height band to rings and sectors
                 (R-POD)
        heights: compute the difference between the highest and the lowest point of each bin, for
                 map and scan
        flagged: flag bins with at least min_points scan points where scan / map < scan_ratio and
                 map > min_difference
        ground:  fit a plane to the lowest points of each flagged bin, and refine it iteratively
                 (R-GPF)
        remove the points of flagged bins that are not ground from the map
    label a point dynamic if its voxel was removed from the map
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I32, I64, U8, Bool
from dynaviz.contracts.evidence import Asked, Evidence, Quantity, Rule, Term, voxels_around
from dynaviz.contracts.method import Cause, Context, Halo, Labels, MethodInfo, Reason
from dynaviz.contracts.params import require
from dynaviz.contracts.probe import Points, PolarGrid, State, Voxels
from dynaviz.contracts.scan import Scan
from dynaviz.errors import UsageError
from dynaviz_methods.erasor.polar import PolarBins
from dynaviz_methods.shared.tiles import laid_out, thinned

KERNELS = kernels.load("dynaviz_methods.erasor.kernels")

NEAR = (
    0.05  # metres: with ``port``, a point is static if a point of the map is within this distance
)
PILLAR = 0.5  # metres: edge of the cubes that show flagged bins


@dataclass(frozen=True)
class ErasorParams:
    """Parameters of ERASOR; the defaults are the benchmark's for KITTI 00.

    Attributes:
        max_range: radius of the bins around the sensor in x and y, metres.
        rings: number of bins along a radius.
        sectors: number of bins around the sensor.
        min_height: points lower than this above the ground are not judged, metres.
        max_height: points higher than this above the ground are not judged, metres.
        sensor_height: height of the sensor above the ground, metres; 0 for the height in the
            sensor's file.
        scan_ratio: a bin is flagged if the height of the scan is less than this fraction of the
            height of the map.
        min_difference: a bin is flagged only if the height of the map exceeds this, metres.
        min_points: minimum number of scan points in a bin; bins with fewer are not judged.
        ground_distance: points less than this above the plane are ground, metres.
        ground_iterations: number of iterations of the plane fit.
        ground_skip: number of lowest points of a bin to skip.
        ground_lowest: number of points after them whose mean height is the lowest ground.
        ground_seed: points less than this above the lowest ground seed the fit, metres.
        map_voxel: edge of the voxels that downsample the map, metres; 0 for no downsampling.
        query_voxel: edge of the voxels that downsample a scan, metres; 0 for no downsampling.
        removal_interval: compare every N-th scan with the map.
        port: behave as the benchmark's port: insert the scan's points into flagged bins, do not
            orient normals upwards, and call a point static if a remaining map point is within 0.05
            m.
    """

    max_range: float = 80.0
    rings: int = 20
    sectors: int = 108
    min_height: float = -1.3
    max_height: float = 3.0
    sensor_height: float = 0.0
    scan_ratio: float = 0.2
    min_difference: float = 0.5
    min_points: int = 6
    ground_distance: float = 0.15
    ground_iterations: int = 3
    ground_skip: int = 5
    ground_lowest: int = 20
    ground_seed: float = 0.5
    map_voxel: float = 0.1
    query_voxel: float = 0.1
    removal_interval: int = 4
    port: bool = False

    def __post_init__(self) -> None:
        counts = "rings sectors min_points ground_iterations ground_lowest removal_interval"
        require(self, counts, lambda count: count >= 1, "at least 1")
        lengths = "min_difference ground_distance ground_skip map_voxel query_voxel sensor_height"
        require(self, lengths, lambda value: value >= 0, "at least 0")
        require(self, "max_range", lambda far: far > 0, "metres above 0")
        high = self.max_height
        require(self, "min_height", lambda low: low < high, f"less than max_height = {high}")


# If several scans judge a voxel, the highest code counts. The codes from UNJUDGED on are assigned
# per point.
(
    BEYOND,
    OUTSIDE,
    TOO_FEW,
    MAP_NOT_HIGHER,
    LOW_BIN,
    GROUND,
    REMOVED,
    UNJUDGED,
    FAR_FROM_MAP,
    NEAR_MAP,
) = range(10)
REASONS = (
    Reason(
        "beyond_range",
        "kept: never within range of a scan that was compared with the map",
        Cause.OUT_OF_RANGE,
    ),
    Reason(
        "outside_height_band",
        "kept: too low or too high above the ground to be judged",
        Cause.HEIGHT_LIMIT,
    ),
    Reason("too_few_points", "kept: no scan had enough points in its bin", Cause.SPARSE_RINGS),
    Reason(
        "map_not_higher",
        "kept: in its bin, the scan spans about as much height as the map",
        Cause.SHARED_CELL,
    ),
    Reason(
        "low_bin",
        "kept: in its bin, the map spans more height than the scan, but not more than a kerb",
        Cause.HEIGHT_LIMIT,
    ),
    Reason("ground_of_flagged_bin", "kept: ground of a flagged bin", Cause.TAKEN_FOR_GROUND),
    Reason(
        "bin_ratio",
        "removed: in its bin, the map spans more height than the scan",
        Cause.SHARED_CELL,
    ),
    Reason(
        "unjudged",
        "kept: not finite, or more than a million voxels from the world's origin",
        Cause.OUT_OF_RANGE,
    ),
    Reason(
        "far_from_map",
        "removed: its voxel was kept, but the port's map has no point within 0.05 m",
        Cause.SHARED_CELL,
    ),
    Reason(
        "near_map",
        "kept: its voxel was removed, but the port's map has a point within 0.05 m",
        Cause.SHARED_CELL,
    ),
)
HEIGHTS = (-1.3, 3.0)
STATES = (
    State(
        "map_height",
        PolarGrid,
        "Height that the map spans in each bin, metres",
        value_range=(0.0, 4.3),
    ),
    State(
        "scan_height",
        PolarGrid,
        "Height that the scan spans in each bin, metres",
        value_range=(0.0, 4.3),
    ),
    State(
        "ratio",
        PolarGrid,
        "Smaller of both heights divided by the larger; at most 1",
        value_range=(0.0, 1.0),
        threshold="scan_ratio",
    ),
    State(
        "status",
        PolarGrid,
        "Verdict on each bin: 2 too few points, 3 map not higher, 4 map higher but low, 6 map "
        "higher: flagged",
        legend=(
            "",
            "",
            "too few points",
            "map not higher",
            "higher, but low",
            "",
            "higher: flagged",
        ),
        value_range=(2.0, 6.0),
    ),
    State(
        "flagged",
        Voxels,
        "Cubes with map points of flagged bins; ratio",
        value_range=(0.0, 0.3),
        threshold="scan_ratio",
    ),
    State(
        "removed",
        Points,
        "Map points removed because of this scan; metres above ground",
        value_range=HEIGHTS,
    ),
    State(
        "ground",
        Points,
        "Map points kept as ground of flagged bins; metres above ground",
        value_range=HEIGHTS,
    ),
)


@dataclass(frozen=True)
class _Comparison:
    """The comparison of one scan with the map around it.

    Attributes:
        foot: (3,) float64, metres, world frame: the ground below the sensor.
        rows: (K,) int32: map points within range.
        bins: (K,) int32: the bin of each of these points.
        reasons: (K,) uint8: the reason code of each of these points.
        inserted: (I, 3) float32, metres, world frame: the scan's points in flagged bins.
        map_height, scan_height: (rings * sectors,) float64, metres; NaN for an empty bin.
        scan_points: (rings * sectors,) int64: number of scan points in each bin.
        verdict: (rings * sectors,) uint8: the reason code of each bin.
    """

    foot: F64
    rows: I32
    bins: I32
    reasons: U8
    inserted: F32
    map_height: F64
    scan_height: F64
    scan_points: I64
    verdict: U8


class Erasor:
    """ERASOR, with a label for every raw point."""

    info: ClassVar[MethodInfo] = MethodInfo(
        "erasor",
        "ERASOR",
        "Lim et al., RA-L 2021",
        REASONS,
        STATES,
        needs_map=True,
        colour=(195, 0, 0),
    )
    Params: ClassVar[type[Any]] = ErasorParams

    def __init__(self, params: Any) -> None:
        self.params = params

    def begin(self, context: Context) -> None:
        """Downsample the raw map and sort it into tiles."""
        self._probe = context.probe
        self._height = self.params.sensor_height or context.sensor.height
        if not self._height:
            raise UsageError(
                "erasor needs the height of the sensor above the ground, but sensor "
                f"'{context.sensor.name}' has none: "
                "give --sensor NAME or --set sensor_height=METRES"
            )
        assert context.raw_map is not None  # because of info.needs_map
        p = self.params
        self._bins = PolarBins(p.max_range, p.rings, p.sectors, p.min_height, p.max_height)
        # The map, (V, 3) float32, metres, to which ``port`` adds; and the map row of each raw
        # point, (M,), -1 for none.
        self._tiles, self._map, self._voxel = laid_out(*thinned(context.raw_map, p.map_voxel))
        self._gone = np.zeros(len(self._map), np.bool_)
        # the last entry is for raw points without a voxel
        self._codes = np.zeros(len(self._map) + 1, np.uint8)
        self._codes[-1] = UNJUDGED
        self._first: dict[int, int] = {}  # by scan index: its first raw point
        self._observed = self._end = 0
        self._last: _Comparison | None = None  # of the last scan, if it was compared
        self._tree: Any = None
        # Compile the kernels here, not in the first scan that is compared.
        self._compare(np.zeros((0, 3), np.float32), np.zeros(3))

    def observe(self, scan: Scan) -> None:
        """Record the scan's rows in the raw map.

        Compare every ``removal_interval``-th scan with the map.
        """
        self._first[scan.index] = self._end
        self._end += len(scan)
        self._observed += 1
        self._last = None
        if self._observed % self.params.removal_interval == 0:
            self._last = comparison = self._compare(scan.points, scan.position)
            self._show(comparison)
            self._remove(comparison)

    def label(self, scan: Scan) -> Labels:
        """Label points dynamic whose voxel was removed.

        With ``port``, points without a map point nearby.
        """
        reasons = self._reasons(scan)
        if not self.params.port:
            return Labels(reasons == REMOVED, reasons)
        dynamic = self._far_from_map(scan)
        reasons[dynamic & (reasons != REMOVED)] = FAR_FROM_MAP
        reasons[~dynamic & (reasons == REMOVED)] = NEAR_MAP
        return Labels(dynamic, reasons)

    def halo(self) -> Halo:
        """The size of the largest bin; all points with ``port``, which adds points to the map."""
        p = self.params
        return Halo(math.inf if p.port else p.max_range * (1 / p.rings + 2 * math.pi / p.sectors))

    def evidence(self, asked: Asked) -> Evidence:
        """The heights that map and scan span in the points' bins, if the last scan was compared
        with the map.
        """
        p = self.params
        voxel = self._voxel[asked.first + asked.rows]
        map_height, scan_height, scan_points, ground = np.full((4, len(voxel)), np.nan)
        if (last := self._last) is not None:
            place = np.full(len(self._map) + 1, -1)  # of each map point among those within range
            place[last.rows] = np.arange(len(last.rows))
            near = np.flatnonzero(place[voxel] >= 0)
            bins = last.bins[place[voxel[near]]]
            ground[near] = last.reasons[place[voxel[near]]] == GROUND
            near = near[bins >= 0]
            bins = bins[bins >= 0]
            map_height[near] = last.map_height[bins]
            scan_height[near] = last.scan_height[bins]
            scan_points[near] = last.scan_points[bins]
        ratio = _ratio(map_height, scan_height)
        quantities = (
            Quantity("map", map_height, "m"),
            Quantity("scan", scan_height, "m"),
            Quantity("ratio", ratio, threshold=p.scan_ratio),
        )
        terms = (
            # Each comparison sees the map that the earlier ones left, so the parameters change more
            # than these thresholds.
            Term(
                "scan points in its bin",
                scan_points,
                ">=",
                p.min_points,
                parameter="min_points",
                follows="otherwise",
            ),
            Term(
                "ratio of heights",
                ratio,
                "<",
                p.scan_ratio,
                parameter="scan_ratio",
                follows="otherwise",
            ),
            Term("height of the map", map_height, ">=", scan_height, "m"),
            Term(
                "height of the map",
                map_height,
                ">",
                p.min_difference,
                "m",
                "min_difference",
                "otherwise",
            ),
            Term("ground of its bin", ground, "<", 1),
        )
        rule = self._far_rule(asked) if p.port else Rule("map higher", terms, lasting=True)
        return Evidence(voxels_around(asked.points, p.map_voxel or NEAR), quantities, (rule,))

    def _far_rule(self, asked: Asked) -> Rule:
        """The rule of the port: no remaining map point nearby."""
        judged = self._voxel[asked.first + asked.rows] >= 0
        distance = np.full(len(judged), np.nan)
        distance[judged], _ = self._search().query(asked.points[judged])
        return Rule(
            "far from the map", (Term("nearest point of the map", distance, ">", NEAR, "m"),)
        )

    def cleaned_map(self) -> F32:
        """(K, 3) float32, metres, world frame.

        Centroids of the remaining voxels, and points inserted by ``port``.
        """
        return self._map[~self._gone]

    def _compare(self, points: F32, position: F64) -> _Comparison:
        """Run the steps "bins" to "ground" for one scan; the map is not changed."""
        foot = position - np.array((0, 0, self._height))
        query, _ = thinned(points, self.params.query_voxel)
        rows, bins = self._bins.locate(
            self._map, foot, self._tiles.spans(foot, self.params.max_range), self._gone
        )
        query_rows, query_bins = self._bins.locate(query, foot)
        map_height, _ = self._bins.heights(self._map, rows, bins)
        scan_height, scan_points = self._bins.heights(query, query_rows, query_bins)
        verdict = self._judge(map_height, scan_height, scan_points)
        # bin -1, the last, is outside the height band
        of_bin = np.append(verdict, np.uint8(OUTSIDE))
        reasons = of_bin[bins]
        flagged = np.flatnonzero(reasons == REMOVED)
        flagged = flagged[np.argsort(bins[flagged], kind="stable")]
        ground = self._fit_ground(self._map[rows[flagged]] - foot, bins[flagged])
        reasons[flagged[ground]] = GROUND
        inserted = query[query_rows[of_bin[query_bins] == REMOVED]]
        return _Comparison(
            foot, rows, bins, reasons, inserted, map_height, scan_height, scan_points, verdict
        )

    def _judge(self, map_height: F64, scan_height: F64, scan_points: I64) -> U8:
        """Scan ratio test: reason code of each bin."""
        ratio = _ratio(map_height, scan_height)
        verdict = np.full(len(ratio), MAP_NOT_HIGHER, np.uint8)
        higher = (ratio < self.params.scan_ratio) & (map_height >= scan_height)
        verdict[higher] = np.where(
            map_height[higher] > self.params.min_difference, REMOVED, LOW_BIN
        )
        verdict[(scan_points < self.params.min_points) | np.isnan(map_height)] = TOO_FEW
        return verdict

    def _fit_ground(self, points: F64, bins: I32) -> Bool:
        """Region-wise ground plane fitting; points are sorted by bin."""
        p = self.params
        starts = np.flatnonzero(np.diff(bins, prepend=-1, append=-1))
        ground: Bool = KERNELS.region_ground.fit(
            kernels.as_readonly(points, np.float64),
            kernels.as_readonly(starts, np.int64),
            *(
                p.ground_skip,
                p.ground_lowest,
                p.ground_seed,
                p.ground_distance,
                p.ground_iterations,
                not p.port,
            ),
        )
        return ground

    def _remove(self, comparison: _Comparison) -> None:
        rows = comparison.rows
        reasons = comparison.reasons
        self._codes[rows] = np.maximum(self._codes[rows], reasons)
        self._gone[rows[reasons == REMOVED]] = True
        if self.params.port:
            self._insert(comparison.inserted)
        self._tree = None

    def _insert(self, points: F32) -> None:
        if not len(points):
            return
        self._tiles.append(points)
        self._map = np.concatenate([self._map, points])
        self._gone = np.append(self._gone, np.zeros(len(points), np.bool_))
        self._codes = np.insert(self._codes, -1, np.full(len(points), BEYOND, np.uint8))

    def _reasons(self, scan: Scan) -> U8:
        reasons: U8 = self._codes[self._voxel[self._first[scan.index] :][: len(scan)]]
        return reasons

    def _far_from_map(self, scan: Scan) -> Bool:
        """Points whose nearest map point is farther than ``NEAR``, as the benchmark scores a map of
        centroids.
        """
        far = np.zeros(len(scan), np.bool_)
        judged = np.flatnonzero(self._reasons(scan) != UNJUDGED)
        nearest, _ = self._search().query(
            scan.points[judged],
            distance_upper_bound=np.nextafter(NEAR, 1),
            workers=kernels.threads_in_use(),
        )
        far[judged] = np.isinf(nearest)
        return far

    def _search(self) -> Any:
        """The search tree of the map as it is now."""
        from scipy.spatial import cKDTree

        if self._tree is None:
            self._tree = cKDTree(self.cleaned_map())
        return self._tree

    def _show(self, comparison: _Comparison) -> None:
        map_height = comparison.map_height
        scan_height = comparison.scan_height
        rows = comparison.rows
        reasons = comparison.reasons
        ratio = _ratio(map_height, scan_height)
        status = np.where(np.isnan(map_height), np.nan, comparison.verdict)
        grids = {
            "map_height": map_height,
            "scan_height": scan_height,
            "ratio": ratio,
            "status": status,
        }
        for name, values in grids.items():
            self._probe.emit(name, self._bins.grid(values))
        for name, code in (("removed", REMOVED), ("ground", GROUND)):
            if self._probe.wants(name):
                points = self._map[rows[reasons == code]]
                self._probe.emit(
                    name, Points(points, (points[:, 2] - comparison.foot[2]).astype(np.float32))
                )
        if self._probe.wants("flagged"):
            chosen = (reasons == GROUND) | (reasons == REMOVED)
            cubes = np.floor(self._map[rows[chosen]] / np.float32(PILLAR)).astype(np.int32)
            keys, first = np.unique(cubes, axis=0, return_index=True)
            values = ratio[comparison.bins[chosen][first]].astype(np.float32)
            self._probe.emit("flagged", Voxels(keys, PILLAR, values))


def _ratio(a: F64, b: F64) -> F64:
    """The smaller value divided by the larger; NaN where both are 0 or either is NaN."""
    with np.errstate(invalid="ignore"):
        ratio: F64 = np.minimum(a, b) / np.maximum(a, b)
    return ratio
