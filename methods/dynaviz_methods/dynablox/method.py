"""Dynablox: points that fall into ever-free voxels are dynamic.

Schmid et al. 2023, as the benchmark runs it. The algorithm, online:

    for each scan
        a  detect:     seed clusters from ever-free voxels with points; grow them over occupied
                       voxels that share a face, where only ever-free voxels keep growing; merge
                       clusters closer than cluster_distance; call a cluster dynamic if it has from
                       min_cluster to max_cluster points
        b  ever-free:  call a voxel occupied if it has a point, or if the last scan observed it with
                       a distance below occupied_distance
                       set it ever-free if the last scan observed it and it and its 26 neighbours
                       are clear: observed, with a distance of at least occupied_distance, last
                       occupied more than burn_in frames ago
                       revoke it and its 26 neighbours if it is occupied for revoke_after
                       consecutive frames
        c  TSDF:       project the scan into a range image; update each voxel in view by the average
                       of the projective distances along its ray, truncated; skip voxels farther
                       than truncation behind a surface
    label a point dynamic if its voxel is ever-free when the point arrives; with clusters, if its
        cluster is dynamic

Consecutive means at most temporal_buffer frames apart. Points closer than min_range or farther than
max_range, points that are not finite, and points more than 32768 voxels from the world's origin are
ignored and kept. Labels are decided when a scan is observed, and stored with four bits per point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import I64, U8, Bool, Intp
from dynaviz.blocks.blocks import read
from dynaviz.contracts.evidence import Asked, Evidence, Quantity, Rule, Term, voxels_around
from dynaviz.contracts.method import Cause, Context, Halo, Labels, MethodInfo, Reason
from dynaviz.contracts.params import require
from dynaviz.contracts.probe import PointClasses, RangeImage, Scalar, State, Voxels
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.errors import UsageError
from dynaviz_methods.dynablox.free_space import Bits, FreeSpace, SensorView
from dynaviz_methods.shared.codes import pack_codes, unpack_codes
from dynaviz_methods.shared.lookups import around, known

KERNELS = kernels.load("dynaviz_methods.dynablox.kernels")

OBJECT = 20.0  # metres: size of the largest object, a bus
SHOWN = 25.0  # metres around the sensor: range of the voxels to show


@dataclass(frozen=True)
class DynabloxParams:
    """Parameters of Dynablox.

    The defaults are the benchmark's for KITTI, except those of the range image.

    Attributes:
        resolution: edge of a voxel, metres.
        min_range: closer points are ignored, metres.
        max_range: farther points are ignored, metres; 0 for no limit.
        image_rows: rows of the range image; 0 for one row per ring of the sensor. For a sensor
            without rings, pixels are square, one per point of a sweep.
        image_columns: maximum number of columns of the range image, which covers 360 degrees.
        field_of_view: vertical field of view of the range image, degrees, symmetric about the
            horizon; 0 for the range from the sensor's lowest to its highest ring.
        truncation: truncation distance of the TSDF, metres; also how far behind a surface voxels
            are updated.
        max_weight: maximum number of observations that a voxel's average represents.
        occupied_distance: voxels closer to a surface than this are occupied, metres.
        burn_in: frames without occupancy of a voxel and its neighbours before it becomes ever-free.
        temporal_buffer: maximum gap between frames of occupancy that count as consecutive, frames.
        revoke_after: consecutive frames of occupancy after which a voxel and its neighbours are no
            longer ever-free.
        cluster_distance: clusters closer than this are merged, metres.
        min_cluster: minimum number of points of a dynamic cluster.
        max_cluster: maximum number of points of a dynamic cluster.
        clusters: remove the points of dynamic clusters only; by default, all points in ever-free
            voxels are removed.
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
        lengths = "resolution truncation occupied_distance cluster_distance"
        require(self, lengths, lambda metres: 0 < metres < np.inf, "metres above 0")
        least = self.resolution / 32  # the keys of its cells have five bits more than voxel keys
        what = f"at least {least:g} m, a 32nd of resolution"
        require(self, "cluster_distance", lambda metres: metres >= least, what)
        others = "min_range max_range field_of_view image_rows temporal_buffer burn_in"
        require(self, others, lambda value: 0 <= value < np.inf, "a number of at least 0")
        counts = "image_columns revoke_after max_weight min_cluster"
        require(self, counts, lambda count: 1 <= count <= 65534, "a number from 1 to 65534")
        what = f"more than min_range = {self.min_range}, or 0 for all"
        require(self, "max_range", lambda far: not far or self.min_range < far, what)
        what = "fewer rows or columns, at most 2^24 pixels in all"
        require(self, "image_rows", lambda rows: rows * self.image_columns <= 1 << 24, what)
        if self.image_rows == 1 or self.field_of_view >= 180:
            raise ValueError(
                f"image_rows = {self.image_rows}, field_of_view = {self.field_of_view}: give at "
                "least two rows and "
                "less than 180 degrees"
            )
        if self.occupied_distance > self.truncation:
            raise ValueError(
                f"occupied_distance = {self.occupied_distance}: distances end at truncation = "
                f"{self.truncation}; "
                "give at most that"
            )
        if self.temporal_buffer > self.burn_in:
            raise ValueError(
                f"temporal_buffer = {self.temporal_buffer}: give at most burn_in = {self.burn_in}; "
                "otherwise a voxel "
                "can become free in the middle of consecutive occupancy"
            )
        what = f"at least min_cluster = {self.min_cluster}"
        require(self, "max_cluster", lambda points: points >= self.min_cluster, what)


NEVER_FREE, FREE, FREE_SMALL, FREE_LARGE, BESIDE, REVOKED, OUT_OF_RANGE, OUT_OF_REACH = range(8)
REASONS = (
    Reason("never_free", "kept: its voxel was not ever-free", Cause.NOT_YET_FREE),
    Reason(
        "ever_free", "removed: in an ever-free voxel, part of a dynamic cluster", Cause.SPARSE_RINGS
    ),
    Reason(
        "ever_free_small_cluster",
        "removed, but kept with clusters: in an ever-free voxel, but the cluster is too small",
        Cause.SPARSE_RINGS,
    ),
    Reason(
        "ever_free_large_cluster",
        "removed, but kept with clusters: in an ever-free voxel, but the cluster is too large",
        Cause.SPARSE_RINGS,
    ),
    Reason(
        "beside_ever_free",
        "kept, but removed with clusters: part of a dynamic cluster, in a voxel that is not "
        "ever-free",
        Cause.SHARED_CELL,
    ),
    Reason(
        "revoked",
        "kept: its voxel was ever-free until it or a neighbour stayed occupied",
        Cause.STANDING,
    ),
    Reason(
        "out_of_range",
        "kept unjudged: closer than min_range, farther than max_range, or not finite",
        Cause.OUT_OF_RANGE,
    ),
    Reason(
        "out_of_reach",
        "kept unjudged: more than 32768 voxels from the world's origin",
        Cause.OUT_OF_RANGE,
    ),
)
STATES = (
    State(
        "clusters",
        PointClasses,
        "Points by cluster: ever-free voxels of dynamic clusters, voxels these touch, clusters of "
        "a wrong size",
        legend=("none", "dynamic", "touched", "too small", "too large"),
    ),
    State(
        "intruded",
        Voxels,
        "Ever-free voxels with points of this scan; number of points",
        value_range=(1.0, 50.0),
    ),
    State("became_free", Voxels, "Voxels near the sensor that become ever-free with this scan"),
    State(
        "revoked",
        Voxels,
        "Voxels near the sensor that are no longer ever-free: they stayed occupied",
    ),
    State(
        "range_image",
        RangeImage,
        "Range of the nearest point in each pixel, metres",
        value_range=(0.0, 50.0),
    ),
    State("free_voxels", Scalar, "Number of ever-free voxels, among those where points can lie"),
)
CLASS = np.zeros(len(REASONS), np.uint8)  # reason code to class of the legend
CLASS[[FREE, BESIDE, FREE_SMALL, FREE_LARGE]] = 1, 2, 3, 4


class Dynablox:
    """Dynablox; each point is labelled when it arrives."""

    info: ClassVar[MethodInfo] = MethodInfo(
        "dynablox",
        "Dynablox",
        "Schmid et al., RA-L 2023",
        REASONS,
        STATES,
        colour=(135, 60, 135),
    )
    Params: ClassVar[type[Any]] = DynabloxParams

    def __init__(self, params: Any) -> None:
        self.params = params

    def begin(self, context: Context) -> None:
        """Allocate the map where points will lie."""
        self._probe = context.probe
        self._map = FreeSpace(context.extent, self.params, view_of(self.params, context.sensor))
        self._reasons: dict[int, U8] = {}  # by scan index: four bits per point, packed
        removed = (FREE, BESIDE) if self.params.clusters else (FREE, FREE_SMALL, FREE_LARGE)
        self._removed = np.isin(np.arange(len(REASONS)), removed)

    def observe(self, scan: Scan) -> None:
        """Label the scan's points by the scans before it, then integrate the scan."""
        inside = self._map.look(scan)
        voxels = np.where(inside, self._map.locate(scan.points), -1)
        reasons = self._judge(scan, inside, voxels)
        self._reasons[scan.index] = pack_codes(reasons)
        new, lost = self._map.learn(voxels)
        self._map.integrate()
        self._show(reasons, voxels, new, lost)

    def label(self, scan: Scan) -> Labels:
        """Label points dynamic whose voxel was ever-free when the scan was observed, or whose
        cluster is dynamic.
        """
        reasons = unpack_codes(self._reasons[scan.index], len(scan))
        return Labels(self._removed[reasons], reasons)

    def forget(self, index: int) -> None:
        """Drop the labels of a scan."""
        self._reasons.pop(index, None)

    def halo(self) -> Halo:
        """The size of an object: clusters are judged as a whole."""
        return Halo(OBJECT)

    def evidence(self, asked: Asked) -> Evidence:
        """How far the points' voxels are from a surface, and how many voxels around
        them are clear.
        """
        voxels = self._map.locate(asked.points)
        cubes = around(self._map.grid, voxels)
        clear = self._map.clear(cubes.ravel()).reshape(cubes.shape).sum(1)
        free = read(self._map.free, voxels).astype(float)
        quantities = (
            Quantity(
                "distance",
                self._map.distances(voxels),
                "m",
                threshold=self.params.occupied_distance,
            ),
            Quantity("clear", known(clear, voxels), threshold=cubes.shape[1]),
            Quantity("ever-free", known(free, voxels), total=True, threshold=1),
        )
        index, *_ = self._judged
        rules = (self._rule(asked),) if index == asked.scan.index else ()
        return Evidence(
            voxels_around(asked.points, self.params.resolution),
            quantities,
            rules,
            final=bool(rules),
        )

    def _judge(self, scan: Scan, inside: Bool, voxels: I64) -> U8:
        """Reason code of each point, (N,) uint8."""
        reasons = np.full(len(scan), NEVER_FREE, np.uint8)
        reasons[read(self._map.revoked, voxels)] = REVOKED
        reasons[voxels < 0] = OUT_OF_REACH
        reasons[~inside] = OUT_OF_RANGE
        free = read(self._map.free, voxels)
        self._judged = scan.index, voxels, free
        if free.any():
            members, size = self._clusters(scan, voxels, free)
            of_free = free[members]
            reasons[members[of_free]] = FREE
            reasons[members[of_free & (size < self.params.min_cluster)]] = FREE_SMALL
            reasons[members[of_free & (size > self.params.max_cluster)]] = FREE_LARGE
            dynamic = (size >= self.params.min_cluster) & (size <= self.params.max_cluster)
            reasons[members[~of_free & dynamic]] = BESIDE
        return reasons

    def _clusters(self, scan: Scan, voxels: I64, free: Bool) -> tuple[Intp, Intp]:
        """The points that belong to clusters, and the size of each one's cluster, points."""
        clusters = KERNELS.clusters.grow(voxels, free, self._map.neighbours)
        members = np.flatnonzero(clusters >= 0)
        merged = KERNELS.clusters.merge(
            scan.points[members], clusters[members], self.params.cluster_distance
        )
        return members, np.bincount(merged)[merged]

    def _rule(self, asked: Asked) -> Rule:
        """What decided the labels of the scan that was observed last."""
        _, voxels, free = self._judged
        if not self.params.clusters:
            return Rule("ever-free", (Term("ever-free when it came", free[asked.rows], ">=", 1),))
        size = np.full(len(free), np.nan)
        if free.any():
            members, size_of_members = self._clusters(asked.scan, voxels, free)
            size[members] = size_of_members
        points = "points of its cluster", size[asked.rows]
        lowest = Term(*points, ">=", self.params.min_cluster, parameter="min_cluster")
        highest = Term(*points, "<=", self.params.max_cluster, parameter="max_cluster")
        return Rule("dynamic cluster", (lowest, highest))

    def _show(self, reasons: U8, voxels: I64, new: Bits, lost: Bits) -> None:
        wants = self._probe.wants
        emit = self._probe.emit
        if wants("free_voxels"):
            emit("free_voxels", Scalar(int(np.bitwise_count(self._map.free).sum())))
        if wants("range_image"):
            emit(
                "range_image",
                RangeImage(
                    np.where(self._map.image > 0, self._map.image, np.float32(np.nan)),
                    self._map.span,
                ),
            )
        for name, bits in (("became_free", new), ("revoked", lost)):
            if wants(name):
                emit(name, self._map.near(bits, SHOWN))
        if wants("intruded"):
            intruded, counts = np.unique(
                voxels[(reasons >= FREE) & (reasons <= FREE_LARGE)], return_counts=True
            )
            keys = self._map.grid.keys(intruded)
            size = self.params.resolution
            emit("intruded", Voxels(keys, size, counts.astype(np.float32)))
        if wants("clusters"):
            emit("clusters", PointClasses(CLASS[reasons]))


def view_of(params: DynabloxParams, sensor: Sensor) -> SensorView:
    """The range image that follows from the parameters and the sensor.

    Raises:
        UsageError: if neither gives its rows or its vertical field of view.
    """
    rows = params.image_rows or sensor.rings
    columns = params.image_columns
    half = params.field_of_view / 2
    low, high = (-half, half) if half else sensor.elevation or (0.0, 0.0)
    if not rows and sensor.points_per_sweep and low < high:
        pixel = math.sqrt((high - low) * 360 / sensor.points_per_sweep)  # its edge, degrees
        rows = round((high - low) / pixel)
        columns = min(columns, round(360 / pixel))
    if not rows or rows < 2 or not low < high:
        raise UsageError(
            "dynablox needs the rows and the vertical field of view of a range image, but sensor "
            f"'{sensor.name}' has "
            "none: give --sensor NAME, or --set image_rows=NUMBER --set field_of_view=DEGREES"
        )
    return SensorView(rows, columns, high, low)
