"""FreeDOM: points in conservative free space are dynamic, and so is what was there before the space
turned free.

Li, Li, Liu, Shu and Lou 2025. Space is divided into voxels for free space and sub-voxels, four to
an edge, for the map:

    for each scan
        a  detect:    set voxels with points to level 3 if they are free; grow over adjacent voxels
                      with points, one step to level 2 and two more to level 1
                      revoke free voxels, and their neighbours, with points in counts_to_revert
                      scans in a row
        b  ray cast:  cast rays to the mean of the points of each voxel, and into the sky; they end
                      at voxels with points
        c  free:      call a voxel clear if counts_to_free scans in a row, of those that see it,
                      pass through it
                      set it free if it and its 26 neighbours are clear
        d  take back: raise what earlier scans saw in voxels that turn free now to level 3; grow it
                      over the points of the same scan, one step to level 2 and two more to level 1
        e  insert:    fill empty sub-voxels with the scan's points and their level; replace points
                      of a higher level
    label a point dynamic if the level of its sub-voxel is above 0 after the last scan

Into the sky means: where a depth image has no return, up to its upper border, to the depth that the
pixels around suggest. Points that are out of range, not finite, or more than 32768 voxels from the
world's origin are ignored and kept. Online, the map of the scans so far decides. Only voxels near
points have state.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dynaviz.arrays import F64, I64, U8
from dynaviz.blocks.blocks import read, voxels_of
from dynaviz.contracts.evidence import Asked, Evidence, Quantity, Rule, Term, voxels_around
from dynaviz.contracts.method import Cause, Context, Halo, Labels, MethodInfo, Reason
from dynaviz.contracts.params import require
from dynaviz.contracts.probe import PointClasses, RangeImage, Scalar, State, Voxels
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.errors import UsageError
from dynaviz_methods.freedom.clear_space import GROWTH, LEVEL, RAISED, SUB_VOXELS, ClearSpace
from dynaviz_methods.shared.sky import DepthImage, rows_of

SHOWN = 25.0  # metres around the sensor: range of the crossed voxels to show


@dataclass(frozen=True)
class FreedomParams:
    """Parameters of FreeDOM.

    The defaults are the published ones for KITTI, except those of the depth image.

    Attributes:
        sub_voxel: edge of a sub-voxel, metres; a voxel is four times as long.
        min_range: closer points are ignored, metres.
        max_range: farther points are ignored, metres.
        min_height: points lower than this above the sensor are ignored, metres; negative.
        max_height: points higher than this above the sensor are ignored, metres.
        ray_range: greatest length of a ray, metres.
        ray_min_height: rays end at this height above the sensor, metres; negative.
        ray_max_height: rays end at this height above the sensor, metres.
        counts_to_free: scans in a row that must pass through a voxel before it is clear.
        counts_to_revert: scans in a row with points in a free voxel after which it is no longer
            free.
        sky: cast rays into the sky as well, where a scan has no return.
        sky_range: greatest depth of such rays, metres.
        image_rows: rows of the depth image; 0 for one row per ring of the sensor. For a sensor
            without rings, pixels are square, one per point of a sweep.
        lowest: elevation of the lowest row, degrees; if equal to highest, both are the sensor's.
        highest: elevation of the highest row, degrees.
        inpaint: radius from which holes of the depth image are filled, pixels.
        erosion: pixels by which holes of the depth image shrink.
        own_scan: label points by their own scan, as the public program does online; not by the map.
        port: reproduce three traits of the public program: growth in the map is one step shorter
            than in the scan, blocks that are free entirely are not counted any more, and rays from
            a border of voxels run a voxel ahead.
    """

    sub_voxel: float = 0.1
    min_range: float = 2.7
    max_range: float = 80.0
    min_height: float = -20.0
    max_height: float = 20.0
    ray_range: float = 80.0
    ray_min_height: float = -10.0
    ray_max_height: float = 10.0
    counts_to_free: int = 6
    counts_to_revert: int = 20
    sky: bool = True
    sky_range: float = 80.0
    image_rows: int = 0
    lowest: float = 0.0
    highest: float = 0.0
    inpaint: int = 3
    erosion: int = 0
    own_scan: bool = False
    port: bool = False

    def __post_init__(self) -> None:
        near = self.min_range
        low = self.lowest
        lengths = "sub_voxel max_height ray_range ray_max_height sky_range"
        require(self, lengths, lambda metres: 0 < metres < np.inf, "metres above 0")
        require(
            self, "min_height ray_min_height", lambda metres: -np.inf < metres < 0, "metres below 0"
        )
        require(
            self,
            "max_range",
            lambda far: 0 <= near < far < np.inf,
            f"more metres than min_range, {near}",
        )
        counts = "counts_to_free counts_to_revert"
        require(self, counts, lambda scans: 1 <= scans < 1 << 31, "a number of scans of at least 1")
        require(
            self,
            "image_rows",
            lambda n: n == 0 or 2 <= n <= 4096,
            "2 to 4096 rows, or 0 for the sensor's",
        )
        require(
            self,
            "highest",
            lambda high: -90 <= low <= high <= 90,
            f"degrees from lowest, {low}, to 90",
        )
        require(
            self, "inpaint", lambda pixels: 1 <= pixels <= 100, "a number of pixels from 1 to 100"
        )
        require(
            self, "erosion", lambda pixels: 0 <= pixels <= 100, "a number of pixels from 0 to 100"
        )


(
    OUT_OF_RANGE, OUT_OF_REACH, NEVER_CROSSED, TOO_RARE, BESIDE_UNCLEAR, REVOKED, RETAKEN, IN_FREE,
    GROWN_IN_SCAN,
    TURNED_FREE, GROWN_IN_MAP,
) = range(11)  # fmt: skip
REASONS = (
    Reason(
        "out_of_range",
        "kept unjudged: beyond the limits of range and height, not in the map",
        Cause.OUT_OF_RANGE,
    ),
    Reason(
        "out_of_reach",
        "kept unjudged: not finite, or more than 32768 voxels from the world's origin",
        Cause.OUT_OF_RANGE,
    ),
    Reason("never_seen_through", "kept: no ray crossed its voxel", Cause.NOTHING_BEHIND),
    Reason(
        "seen_too_rarely",
        "kept: rays crossed its voxel, but never in counts_to_free scans in a row",
        Cause.SPARSE_RINGS,
    ),
    Reason(
        "beside_unclear",
        "kept: its voxel was clear, but not all of its neighbours at the same time",
        Cause.SPARSE_RINGS,
    ),
    Reason(
        "revoked",
        "kept: its voxel was free until it or a neighbour was hit too often",
        Cause.STANDING,
    ),
    Reason(
        "retaken",
        "kept: dynamic in its scan, but another scan has a static point there",
        Cause.SHARED_CELL,
    ),
    Reason("in_free_space", "removed: its voxel was free when it came", Cause.PARTLY_EMPTY),
    Reason(
        "grown_in_scan",
        "removed: at most three voxels from points in free space, in its scan",
        Cause.SHARED_CELL,
    ),
    Reason("turned_free", "removed: its voxel turned free after it", Cause.PARTLY_EMPTY),
    Reason(
        "grown_in_map",
        "removed: its scan has points at most three voxels away whose voxel turned free",
        Cause.SHARED_CELL,
    ),
)
STATES = (
    State(
        "levels",
        PointClasses,
        "Points by the level of their voxel in this scan: in free space, one step, or more steps "
        "from it",
        legend=("static", "more steps", "one step", "in free space"),
    ),
    State("crossed", Voxels, "Voxels near the sensor that rays cross in this scan"),
    State("turned_free", Voxels, "Voxels that turn free with this scan"),
    State("revoked", Voxels, "Voxels with points that were hit too often to be free"),
    State("depth", RangeImage, "Depth image of the scan, metres", value_range=(0.0, 80.0)),
    State("sky", RangeImage, "Depth of the rays into the sky, metres", value_range=(0.0, 80.0)),
    State("free_voxels", Scalar, "Number of free voxels near points"),
)


class Freedom:
    """FreeDOM; the map after the last scan decides."""

    info: ClassVar[MethodInfo] = MethodInfo(
        "freedom",
        "FreeDOM",
        "Li et al., RA-L 2025",
        REASONS,
        STATES,
        colour=(100, 0, 180),
        compiles_long=True,
    )
    Params: ClassVar[type[Any]] = FreedomParams

    def __init__(self, params: Any) -> None:
        self.params = params

    def begin(self, context: Context) -> None:
        """Allocate the maps where points will lie."""
        self._probe = context.probe
        self._map = ClearSpace(context.extent, self.params)
        self._image = image_of(self.params, context.sensor) if self.params.sky else None
        self._number = -1
        self._own: dict[
            int, U8
        ] = {}  # by scan index: level of each point in its scan, two bits per point, packed

    def observe(self, scan: Scan) -> None:
        """Detect points in free space, cast rays, take back what is in new free space, and insert
        the scan.
        """
        self._number += 1
        occupied, lost = self._map.hit(self._map.place(scan))
        targets = self._map.means(scan, occupied)
        if self._image is not None:
            targets = np.concatenate([targets, self._sky(scan, self._image)])
        blocks, crossed, freed = self._map.cast(scan, targets)
        self._map.take_back(freed)
        own = self._map.insert(scan, occupied, self._number)
        self._own[scan.index] = np.packbits(own[:, None] >> np.arange(2, dtype=np.uint8) & 1)
        self._show(scan, own, voxels_of(blocks, crossed.view(np.int64)), freed, lost)

    def label(self, scan: Scan) -> Labels:
        """Label points dynamic if the level of their sub-voxel, or with ``own_scan`` of their
        voxel, is above 0.
        """
        voxels = self._map.place(scan)
        space = self._map
        own = self._levels(scan)
        level = own if self.params.own_scan else space.levels(scan, voxels)
        reasons = np.full(len(scan), NEVER_CROSSED, np.uint8)
        of_voxel = np.maximum(voxels, -1)
        for bits, reason in (
            (space.seen, TOO_RARE),
            (space.often, BESIDE_UNCLEAR),
            (space.revoked, REVOKED),
        ):
            reasons[read(bits, of_voxel)] = reason
        reasons[own > 0] = RETAKEN
        dynamic = level & LEVEL > 0
        sure = level & LEVEL == 3
        raised = level & RAISED > 0
        reasons[dynamic] = np.where(
            raised,
            np.where(sure, TURNED_FREE, GROWN_IN_MAP),
            np.where(sure, IN_FREE, GROWN_IN_SCAN),
        )[dynamic]
        reasons[voxels == -1] = OUT_OF_REACH
        reasons[voxels == -2] = OUT_OF_RANGE
        return Labels(dynamic, reasons)

    def _levels(self, scan: Scan) -> U8:
        """(N,) uint8: the level of each point in its scan; 0 if the scan was not observed yet."""
        packed = self._own.get(scan.index, np.zeros(-(-2 * len(scan) // 8), np.uint8))
        return np.unpackbits(packed, count=2 * len(scan)).reshape(-1, 2) @ np.array(
            [1, 2], np.uint8
        )

    def forget(self, index: int) -> None:
        """Drop the levels of a scan."""
        self._own.pop(index, None)

    def halo(self) -> Halo:
        """The distance over which labels grow.

        All points with ``port``, which skips blocks that are free entirely.
        """
        edge = SUB_VOXELS * float(self.params.sub_voxel)
        return Halo(math.inf if self.params.port else (GROWTH + 2) * edge, along_rays=True)

    def evidence(self, asked: Asked) -> Evidence:
        """How many scans in a row passed through the points' voxels, and the levels of their
        sub-voxels.
        """
        space = self._map
        scan = asked.scan
        voxels = space.place(scan)
        level = (
            self._levels(scan) if self.params.own_scan else space.levels(scan, voxels) & LEVEL
        )[asked.rows]
        passes, clear = space.passes(voxels[asked.rows])
        quantities = (
            Quantity("passes", passes, total=True, threshold=self.params.counts_to_free),
            Quantity("clear", clear, total=True, threshold=27),
            Quantity("level", level.astype(float), total=True, threshold=1),
        )
        rule = Rule("level", (Term("level of its sub-voxel", level, ">=", 1),))
        return Evidence(voxels_around(asked.points, space.resolution), quantities, (rule,))

    def _sky(self, scan: Scan, image: DepthImage) -> F64:
        depth, hole = image.of(scan)
        filled, chosen = image.sky(depth, hole)
        for name, metres, shown in (
            ("depth", depth * (image.farthest / 255), hole == 0),
            ("sky", filled, chosen),
        ):
            if self._probe.wants(name):
                shown_metres = np.where(shown, metres, np.nan).astype(np.float32)
                self._probe.emit(name, RangeImage(shown_metres, image.span))
        return image.targets(scan, filled, chosen)

    def _show(self, scan: Scan, own: U8, crossed: I64, freed: I64, lost: I64) -> None:
        wants = self._probe.wants
        emit = self._probe.emit
        size = self._map.resolution
        if wants("levels"):
            emit("levels", PointClasses(own))
        if wants("crossed"):
            keys = self._map.keys(crossed)
            near = np.linalg.norm((keys + 0.5) * size - scan.position, axis=1) < SHOWN
            emit("crossed", Voxels(keys[near], size))
        for name, voxels in (("turned_free", freed), ("revoked", lost)):
            if wants(name):
                emit(name, Voxels(self._map.keys(voxels), size))
        if wants("free_voxels"):
            emit("free_voxels", Scalar(int(np.bitwise_count(self._map.free).sum())))


def image_of(params: FreedomParams, sensor: Sensor) -> DepthImage:
    """The depth image that follows from the parameters and the sensor.

    Raises:
        UsageError: if neither gives its rows or its vertical field of view.
    """
    low, high = (
        (params.lowest, params.highest)
        if params.lowest < params.highest
        else sensor.elevation or (0.0, 0.0)
    )
    rows = params.image_rows or rows_of(sensor, low, high)
    if rows < 2 or not low < high:
        raise UsageError(
            "freedom needs the rows and the vertical field of view of a depth image, but sensor "
            f"'{sensor.name}' has none: give --sensor NAME, --set image_rows=NUMBER --set "
            "lowest=DEGREES "
            "--set highest=DEGREES, or --set sky=false"
        )
    return DepthImage(
        rows,
        math.radians(high),
        math.radians(low),
        params.sky_range,
        params.inpaint,
        params.erosion,
    )
