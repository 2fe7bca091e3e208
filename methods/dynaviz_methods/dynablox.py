"""Dynablox: a point in a voxel that was free for long is of something that moves.

Schmid et al. 2023, as the benchmark runs it. The algorithm, online:

    for each scan
        a  moving:     points in voxels that are free for ever; clusters grow from their voxels over those that touch at
                       a side and hold points, as long as they are free; those nearer than cluster_distance are one;
                       a dynamic one has at least min_cluster and at most max_cluster points
        b  free:       a voxel is occupied that has a point, or that the last scan saw at less than occupied_distance;
                       free for ever, once seen by the last scan and clear, as are its 26 neighbours: observed,
                       not nearer than occupied_distance, and occupied last more than burn_in frames ago
                       revoked, with its 26 neighbours, once occupied for revoke_after frames on end
        c  distances:  the scan as a range image; each voxel in view is averaged with the difference of ranges along its
                       ray, cut off at truncation; what is farther behind a surface is not seen
    a point is dynamic if its voxel was free for ever when it came; with clusters, if it is in a dynamic one

Frames of occupancy are on end where the last was at most temporal_buffer frames before. Points nearer than min_range or
farther than max_range, points that are not finite, and points more than 32768 voxels from the world's origin take no
part and are kept. Labels are decided when a scan is observed, and kept as three bits a point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import I64, U8, Bool
from dynaviz.errors import UsageError
from dynaviz.method import Cause, Context, Labels, MethodInfo, Reason
from dynaviz.probe import PointClasses, RangeImage, Scalar, State, Voxels
from dynaviz.scan import Scan
from dynaviz.sensors import Sensor
from dynaviz.spatial.blocks import read
from dynaviz_methods.free_space import Bits, FreeSpace, SensorView

SHOWN = 25.0  # metres around the sensor


@dataclass(frozen=True)
class DynabloxParams:
    """Parameters of Dynablox; the defaults are the benchmark's for KITTI, but for the range image's.

    Attributes:
        resolution: edge of a voxel, metres.
        min_range: nearer points take no part, metres.
        max_range: farther points take no part, metres; 0: all do.
        image_rows: rows of the range image; 0: one for each ring of the sensor. A sensor without rings gets square
            pixels, one for each point of a sweep.
        image_columns: columns of the range image, all around, at most.
        field_of_view: height of the range image, degrees, half of it above the horizon; 0: from the sensor's lowest
            to its highest ring.
        truncation: largest distance that is averaged; also how far behind a surface voxels are seen, metres.
        max_weight: most observations that a voxel's average stands for.
        occupied_distance: voxels nearer to a surface than this are occupied, metres.
        burn_in: frames since a voxel and its neighbours were last occupied before it is free for ever.
        temporal_buffer: frames since a voxel was last occupied for its occupancy to count on.
        revoke_after: frames of occupancy after which a voxel and its neighbours are free no more.
        cluster_distance: clusters nearer than this are one, metres.
        min_cluster: fewer points are no dynamic cluster.
        max_cluster: more points are no dynamic cluster.
        clusters: whether points of dynamic clusters are removed, and no others; else all in voxels free for ever.
    """

    resolution: float = 0.1
    min_range: float = 0.3
    max_range: float = 0.0
    image_rows: int = 0
    image_columns: int = 2048
    field_of_view: float = 0.0
    truncation: float = 0.4
    max_weight: int = 1000
    occupied_distance: float = 0.3
    burn_in: int = 5
    temporal_buffer: int = 2
    revoke_after: int = 150
    cluster_distance: float = 0.2
    min_cluster: int = 20
    max_cluster: int = 200_000
    clusters: bool = False

    def __post_init__(self) -> None:
        for name in ("resolution", "truncation", "occupied_distance", "cluster_distance"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} = {getattr(self, name)}: give metres above 0")
        if self.cluster_distance < self.resolution / 32:  # keys of its cells have the room of so many a voxel
            least = f"{self.resolution / 32:g} m, a 32nd of resolution"
            raise ValueError(f"cluster_distance = {self.cluster_distance}: give at least {least}")
        for name in ("min_range", "max_range", "field_of_view", "image_rows", "temporal_buffer", "burn_in"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ValueError(f"{name} = {getattr(self, name)}: give a number of at least 0")
        for name in ("image_columns", "revoke_after", "max_weight", "min_cluster"):
            if not 1 <= getattr(self, name) <= 65534:
                raise ValueError(f"{name} = {getattr(self, name)}: give a number from 1 to 65534")
        if self.max_range and not self.min_range < self.max_range:
            raise ValueError(f"max_range = {self.max_range}: give more than min_range = {self.min_range}, or 0 for all")
        if self.image_rows * self.image_columns > 1 << 24:
            raise ValueError(f"image_rows = {self.image_rows}: give fewer rows or columns, at most 2^24 pixels in all")
        if self.image_rows == 1 or self.field_of_view >= 180:
            raise ValueError(
                f"image_rows = {self.image_rows}, field_of_view = {self.field_of_view}: give at least two rows, "
                "in less than 180 degrees"
            )
        if self.occupied_distance > self.truncation:
            raise ValueError(
                f"occupied_distance = {self.occupied_distance}: no distance exceeds truncation = {self.truncation}, so "
                "give at most that"
            )
        if self.temporal_buffer > self.burn_in:
            raise ValueError(
                f"temporal_buffer = {self.temporal_buffer}: give at most burn_in = {self.burn_in}, or a voxel may "
                "count on while it becomes free"
            )
        if self.max_cluster < self.min_cluster:
            raise ValueError(f"max_cluster = {self.max_cluster}: give at least min_cluster = {self.min_cluster}")


NEVER_FREE, FREE, FREE_SMALL, FREE_LARGE, BESIDE, REVOKED, OUT_OF_RANGE, OUT_OF_REACH = range(8)
REASONS = (
    Reason("never_free", "kept: its voxel had not been free for long", Cause.NOT_YET_FREE),
    Reason(
        "ever_free", "removed: its voxel was free for long before something came, a dynamic cluster", Cause.SPARSE_RINGS
    ),
    Reason(
        "ever_free_small_cluster",
        "removed, but kept with clusters: its voxel was free for long; few points cluster",
        Cause.SPARSE_RINGS,
    ),
    Reason(
        "ever_free_large_cluster",
        "removed, but kept with clusters: its voxel was free for long; a huge cluster",
        Cause.SPARSE_RINGS,
    ),
    Reason(
        "beside_ever_free",
        "kept, but removed with clusters: of a dynamic cluster, in a voxel not free for long",
        Cause.SHARED_CELL,
    ),
    Reason("revoked", "kept: its voxel was free for long, but then something stayed in or beside it", Cause.STANDING),
    Reason(
        "out_of_range",
        "kept unjudged: nearer than min_range, farther than max_range, or not finite",
        Cause.OUT_OF_RANGE,
    ),
    Reason("out_of_reach", "kept unjudged: more than 32768 voxels from the world's origin", Cause.OUT_OF_RANGE),
)
STATES = (
    State(
        "clusters",
        PointClasses,
        "Points by cluster: in free voxels of a dynamic one, what it touches, and of too few or too many points",
        legend=("none", "dynamic", "touched", "too small", "too large"),
    ),
    State("intruded", Voxels, "Free voxels with points of this scan; number of points", value_range=(1.0, 50.0)),
    State("became_free", Voxels, "Voxels near the sensor that are free for ever from this scan on"),
    State("revoked", Voxels, "Voxels near the sensor that are free no more: something stayed"),
    State("range_image", RangeImage, "Range of the nearest point in each pixel, metres", value_range=(0.0, 50.0)),
    State("free_voxels", Scalar, "How many voxels are free for ever, of those where points can lie"),
)
CLASS = np.zeros(len(REASONS), np.uint8)  # of a reason, in the legend
CLASS[[FREE, BESIDE, FREE_SMALL, FREE_LARGE]] = 1, 2, 3, 4


class Dynablox:
    """Dynablox, asked for each point when it comes."""

    info: ClassVar[MethodInfo] = MethodInfo("dynablox", "Dynablox", "Schmid et al., RA-L 2023", REASONS, STATES)
    Params: ClassVar[type[Any]] = DynabloxParams

    def __init__(self, params: Any) -> None:
        self.params = params

    def begin(self, context: Context) -> None:
        """Lay out the map where points will lie."""
        self._probe = context.probe
        self._map = FreeSpace(context.extent, self.params, view_of(self.params, context.sensor))
        self._reasons: dict[int, U8] = {}  # three bits a point, packed: the decision is per point
        removed = (FREE, BESIDE) if self.params.clusters else (FREE, FREE_SMALL, FREE_LARGE)
        self._removed = np.isin(np.arange(len(REASONS)), removed)

    def observe(self, scan: Scan) -> None:
        """Decide on the scan's points by the scans before; then learn from it."""
        inside = self._map.look(scan)
        voxels = np.where(inside, self._map.locate(scan.points), -1)
        why = self._judge(scan, inside, voxels)
        self._reasons[scan.index] = np.packbits(why[:, None] >> np.arange(3, dtype=np.uint8) & 1)
        new, lost = self._map.learn(voxels)
        self._map.integrate()
        self._show(why, voxels, new, lost)

    def label(self, scan: Scan) -> Labels:
        """Dynamic where the point's voxel was ever-free when the scan was observed, or as clusters decide."""
        bits = np.unpackbits(self._reasons[scan.index], count=3 * len(scan)).reshape(-1, 3)
        reasons = bits @ np.array([1, 2, 4], np.uint8)
        return Labels(self._removed[reasons], reasons)

    def _judge(self, scan: Scan, inside: Bool, voxels: I64) -> U8:
        """(N,) uint8, codes of ``REASONS``."""
        why = np.full(len(scan), NEVER_FREE, np.uint8)
        why[read(self._map.revoked, voxels)] = REVOKED
        why[voxels < 0] = OUT_OF_REACH
        why[~inside] = OUT_OF_RANGE
        free = read(self._map.free, voxels)
        if free.any():
            clusters = kernels.clusters.grow(voxels, free, self._map.neighbours)
            members = np.flatnonzero(clusters >= 0)
            merged = kernels.clusters.merge(scan.points[members], clusters[members], self.params.cluster_distance)
            size = np.bincount(merged)[merged]
            of_free = free[members]
            why[members[of_free]] = FREE
            why[members[of_free & (size < self.params.min_cluster)]] = FREE_SMALL
            why[members[of_free & (size > self.params.max_cluster)]] = FREE_LARGE
            dynamic = (size >= self.params.min_cluster) & (size <= self.params.max_cluster)
            why[members[~of_free & dynamic]] = BESIDE
        return why

    def _show(self, why: U8, voxels: I64, new: Bits, lost: Bits) -> None:
        wants, emit = self._probe.wants, self._probe.emit
        if wants("free_voxels"):
            emit("free_voxels", Scalar(int(np.bitwise_count(self._map.free).sum())))
        if wants("range_image"):
            emit("range_image", RangeImage(np.where(self._map.image > 0, self._map.image, np.float32(np.nan))))
        for name, bits in (("became_free", new), ("revoked", lost)):
            if wants(name):
                emit(name, self._map.near(bits, SHOWN))
        if wants("intruded"):
            intruded, counts = np.unique(voxels[(why >= FREE) & (why <= FREE_LARGE)], return_counts=True)
            keys, size = self._map.grid.keys(intruded), self.params.resolution
            emit("intruded", Voxels(keys, size, counts.astype(np.float32)))
        if wants("clusters"):
            emit("clusters", PointClasses(CLASS[why]))


def view_of(params: DynabloxParams, sensor: Sensor) -> SensorView:
    """The range image that parameters and sensor make.

    Raises:
        UsageError: where neither tells its rows or its height.
    """
    rows, columns, half = params.image_rows or sensor.rings, params.image_columns, params.field_of_view / 2
    low, high = (-half, half) if half else sensor.elevation or (0.0, 0.0)
    if not rows and sensor.points_per_sweep and low < high:
        pixel = math.sqrt((high - low) * 360 / sensor.points_per_sweep)  # its edge, degrees
        rows, columns = round((high - low) / pixel), min(columns, round(360 / pixel))
    if not rows or rows < 2 or not low < high:
        raise UsageError(
            f"dynablox needs the rows and the height of a range image, which the sensor '{sensor.name}' does not tell: "
            "give --sensor NAME, or --set image_rows=NUMBER --set field_of_view=DEGREES"
        )
    return SensorView(rows, columns, high, low)
