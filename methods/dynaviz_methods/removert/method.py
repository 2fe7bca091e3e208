"""Removert: map points that are closer than a scan's return in the same pixel of a range image are
dynamic.

Kim and Kim, IROS 2020. An offline method, which needs the map of all scans first.

    downsample the raw map to the centroids of 0.05 m voxels
    for each scan
        for each resolution
            project the scan into a range image; keep the nearest return of each pixel
            flag each map point that is closer than its pixel's return by more than the threshold
                times that range
    revert: unflag map points that are not flagged again in the coarser images of the revert step
    label each raw point as its map point

Each map point is judged by its own range, independent of the other points in its pixel. It
therefore makes no difference that the paper processes one resolution after another on the remaining
map: here all are done in one pass.

The public benchmark's port differs (preset ``port``): it judges only the nearest map point of each
pixel, by the absolute difference, so a closer return of the scan also flags the map point behind
it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I32, I64, U8, Bool
from dynaviz.contracts.evidence import Asked, Evidence, Quantity, Rule, Term, voxels_around
from dynaviz.contracts.method import Cause, Context, Halo, Labels, MethodInfo, Reason
from dynaviz.contracts.params import require
from dynaviz.contracts.probe import Points, RangeImage, State
from dynaviz.contracts.scan import Scan
from dynaviz.errors import UsageError
from dynaviz_methods.shared.range_images import chunks, image_views, picture, slices, whole
from dynaviz_methods.shared.tiles import laid_out, thinned

SHARED = kernels.load("dynaviz_methods.shared.kernels")

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


SHOWN = 3  # number of resolutions with reasons and states of their own
LARGEST = 200.0  # metres; the port treats a larger difference as a pixel without return
EDGE = (
    0.05  # metres: of the box around a point whose rays are evidence, if the map is not downsampled
)
FINEST = 50.0  # pixels per degree; an image then takes hundreds of megabytes


@dataclass(frozen=True)
class RemovertParams:
    """Parameters of Removert.

    Attributes:
        resolutions: resolutions of the range images, pixels per degree; the first should give one
            row per ring of the sensor.
        revert_resolutions: resolutions of the images in which a flagged point must be flagged
            again, pixels per degree; empty for no revert step. LT-mapper's step at 2.2 uses images
            of 0.95 * 2.2.
        threshold: a map point must be closer than the scan's return by this fraction of the
            return's range.
        voxel: edge of the voxels that downsample the map, metres; 0 judges every raw point.
        elevation: (lowest, highest) elevation of the range images, degrees above the horizon; empty
            for the sensor's.
        azimuth: (from, to) azimuth of the range images, degrees; empty for the sensor's.
        port: apply the rule of the benchmark's port: images have the axes of the world, points
            above or below them go to the first or last row, and only the nearest map point of each
            pixel is judged, by the absolute difference.
        scan_neighbours: number of nearest neighbours, including the point itself, over which the
            scan-side step averages squared distances; 0 for no such step. With this step, a point
            is static if the averages in its scan and in the cleaned map differ by less than
            ``scan_difference``, regardless of its map point.
        scan_difference: maximum difference between the averages of the scan-side step, square
            metres.
    """

    resolutions: tuple[float, ...] = (2.5, 2.0, 1.5)
    revert_resolutions: tuple[float, ...] = ()
    threshold: float = 0.05
    voxel: float = 0.05
    elevation: tuple[float, ...] = ()
    azimuth: tuple[float, ...] = ()
    port: bool = False
    scan_neighbours: int = 0
    scan_difference: float = 0.1

    def __post_init__(self) -> None:
        every = (*self.resolutions, *self.revert_resolutions)
        if not self.resolutions or len(every) > 8 or not all(0 < r <= FINEST for r in every):
            raise ValueError(
                f"resolutions = {every}: give one to eight numbers above 0 and at most {FINEST:g}, "
                "including revert_resolutions"
            )
        require(self, "threshold", lambda share: 0 < share < 1, "a fraction between 0 and 1")
        others = "voxel scan_neighbours scan_difference"
        require(self, others, lambda value: 0 <= value < np.inf, "0 or a positive number")
        for name, limit in (("elevation", 90), ("azimuth", 180)):
            span = getattr(self, name)
            if span and not (len(span) == 2 and -limit <= span[0] < span[1] <= limit):
                raise ValueError(
                    f"{name} = {span}: give two ascending numbers from {-limit} to {limit}"
                )
        if self.port and self.revert_resolutions:
            raise ValueError(
                "revert_resolutions: the port has no revert step; give either port or "
                "revert_resolutions"
            )


AGREES = 0
NEARER = 1
REVERTED = 4
HIDDEN = 5
OUT_OF_VIEW = 6
LEFT_ALONE = 7
SURROUNDED = 8
REASONS = (
    Reason(
        "agrees",
        "kept: at least two scans see a surface there, and no scan sees past it",
        Cause.STANDING,
    ),
    Reason(
        "nearer_than_scan_at_res_1",
        "removed: a scan sees past it at the first resolution",
        Cause.PARTLY_EMPTY,
    ),
    Reason(
        "nearer_than_scan_at_res_2",
        "removed: a scan sees past it at the second resolution, but none at the first",
        Cause.PARTLY_EMPTY,
    ),
    Reason(
        "nearer_than_scan_at_res_3",
        "removed: a scan sees past it, but only at the third resolution or later",
        Cause.PARTLY_EMPTY,
    ),
    Reason(
        "reverted",
        "kept: a scan sees past it, but none at a resolution of the revert step",
        Cause.SHARED_CELL,
    ),
    Reason(
        "hidden",
        "kept: at most one scan sees a surface there; the others see something closer, or nothing",
        Cause.NOTHING_BEHIND,
    ),
    Reason(
        "out_of_view",
        "kept unjudged: outside all images, in no pixel with a return, beyond all returns, or not "
        "in the map",
        Cause.OUT_OF_RANGE,
    ),
    Reason(
        "left_alone",
        "removed by the scan-side step: its neighbours in the scan are missing in the cleaned map",
        Cause.SPARSE_RINGS,
    ),
    Reason(
        "surrounded",
        "kept by the scan-side step: the cleaned map around it is as dense as the scan",
        Cause.SHARED_CELL,
    ),
)

IMAGES = (
    ("scan", "Range of the nearest return of the scan", (0.0, 80.0)),
    ("map", "Range of the nearest map point", (0.0, 80.0)),
    ("difference", "Range of the scan minus range of the map", (-5.0, 5.0)),
    ("flagged", "The same difference, for pixels whose nearest map point is dynamic", (-5.0, 5.0)),
)
STATES = (
    *(
        State(
            f"{name}_{k}",
            RangeImage,
            f"{meaning}; metres, resolution {k}",
            value_range=value_range,
            at_cases=k > 1,
        )
        for k in range(1, SHOWN + 1)
        for name, meaning, value_range in IMAGES
    ),
    State(
        "accused",
        Points,
        "Map points that this scan is the first to flag dynamic; range, metres",
        (),
        (0.0, 80.0),
    ),
)


class Removert:
    """Removert; a raw point gets the label of its map point."""

    info: ClassVar[MethodInfo] = MethodInfo(
        "removert",
        "Removert",
        "Kim and Kim, IROS 2020",
        REASONS,
        STATES,
        needs_map=True,
        colour=(210, 135, 90),
    )
    Params: ClassVar[type[Any]] = RemovertParams

    def __init__(self, params: Any) -> None:
        self.params = params
        self._verdicts = verdicts(len(params.resolutions), len(params.revert_resolutions))

    def begin(self, context: Context) -> None:
        """Downsample the raw map and sort it into tiles.

        Raises:
            UsageError: if neither the sensor nor a parameter gives the vertical field of view.
        """
        params = self.params
        sensor = context.sensor
        elevation = params.elevation or sensor.elevation
        if elevation is None:
            raise UsageError(
                f"removert needs the vertical field of view, but sensor '{sensor.name}' has none: "
                "give --sensor NAME or --set elevation=[LOWEST,HIGHEST], degrees"
            )
        self._probe = context.probe
        resolutions = (*params.resolutions, *params.revert_resolutions)
        self._views = image_views(resolutions, elevation, params.azimuth or sensor.azimuth)
        assert context.raw_map is not None  # because of info.needs_map
        self._tiles, points, self._map_points = laid_out(*thinned(context.raw_map, params.voxel))
        self._map = kernels.as_readonly(points.T, np.float32)
        # One entry more than map points: raw points without a map point (-1) read the last.
        # bit k: a scan sees past the point at resolution k
        self._past = np.zeros(len(points) + 1, np.uint8)
        self._met = np.zeros(len(points) + 1, np.uint8)  # bits IN_VIEW, ONCE, AGAIN
        # the port judges only the nearest point of a pixel
        self._met[:-1] = IN_VIEW if params.port else 0
        self._places: dict[int, slice] = {}  # by scan index: its rows in the raw map
        self._end = 0  # row in the raw map after the last observed scan
        self._tree: cKDTree | None = None  # k-d tree of the cleaned map

    def observe(self, scan: Scan) -> None:
        """Compare the scan's range images with the map, at all resolutions."""
        self._places[scan.index] = slice(self._end, self._end + len(scan))
        self._end += len(scan)
        self._tree = None
        scan_ranges, _ = self._nearest(scan, scan.points.T, *whole(len(scan)))
        self._last = scan, scan_ranges
        near = self._within_reach(scan, scan_ranges)
        before = self._past[rows := _rows(near[0])] if self._probe.wants("accused") else None
        if self.params.port or self._draws():
            map_ranges, nearest = self._nearest(scan, self._map, *near)
            flagged = self._flagged(scan_ranges, map_ranges)
        if self._draws():
            self._draw(scan_ranges, map_ranges, flagged)
        if self.params.port:
            self._judge_nearest(nearest, flagged, np.isfinite(scan_ranges))
        else:
            self._judge_all(scan, scan_ranges, *near)
        if before is not None:
            accused = rows[self._dynamic(self._past[rows]) & ~self._dynamic(before)]
            self._draw_accused(scan, self._map[:, accused].T)

    def label(self, scan: Scan) -> Labels:
        """Label points as their map points; with the scan-side step, as that step finds them."""
        past = self._of(scan, self._past)
        met = self._of(scan, self._met)
        by_map = self._dynamic(past)
        reasons = self._verdicts[past]
        dynamic = self._scan_side(scan) if self.params.scan_neighbours else by_map
        kept = reasons == AGREES
        reasons[kept & (met & AGAIN == 0)] = HIDDEN
        reasons[kept & (met & IN_VIEW == 0)] = OUT_OF_VIEW
        reasons[dynamic & ~by_map] = LEFT_ALONE
        reasons[by_map & ~dynamic] = SURROUNDED
        return Labels(dynamic, reasons)

    def halo(self) -> Halo:
        """The edge of a voxel; all points with ``port`` and ``scan_neighbours``, which look at the
        whole map.
        """
        whole_map = self.params.port or self.params.scan_neighbours
        return Halo(math.inf if whole_map else float(self.params.voxel))

    def evidence(self, asked: Asked) -> Evidence:
        """How far the points' map points lie in front of the surface that the last scan saw in
        their pixels.
        """
        p = self.params
        rows = self._map_points[asked.first + asked.rows]
        (scan, scan_ranges) = self._last
        xyz = np.ascontiguousarray(self._map[:, rows])
        pixels, ranges = SHARED.range_image.pixels_of(xyz, *self._camera(scan))
        near = np.where(rows < 0, np.nan, ranges)
        surfaces = np.where(pixels < 0, np.inf, scan_ranges[pixels])
        # in float32, as in the kernel
        surfaces = np.where(np.isfinite(surfaces), surfaces, np.float32(np.nan))
        limits = (surfaces - np.float32(p.threshold) * surfaces)[: len(p.resolutions)]
        shown = [f"at {resolution:g}/°" for resolution in p.resolutions]
        depths = [Quantity(name, surfaces[k] - near, "m") for k, name in enumerate(shown[:SHOWN])]
        if p.scan_neighbours or p.port or p.revert_resolutions:
            rules = self._rules_of_all_scans(asked, shown, self._past[rows])
        else:
            nearer = [
                Term("its range", near, "<", limit, "m", "threshold", "complement")
                for limit in limits
            ]
            rules = tuple(
                Rule(f"nearer {name}", (term,), lasting=True)
                for name, term in zip(shown, nearer, strict=True)
            )
        return Evidence(voxels_around(asked.points, p.voxel or EDGE), tuple(depths), rules)

    def _rules_of_all_scans(self, asked: Asked, shown: list[str], past: U8) -> tuple[Rule, ...]:
        """The rules of the port, of the revert step and of the scan-side step.

        They need what all scans saw.
        """
        p = self.params
        scan = asked.scan
        if p.scan_neighbours and scan.index in self._places:
            difference = self._densities(scan)[asked.rows]
            return (
                Rule(
                    "left alone",
                    (
                        Term(
                            "density difference",
                            difference,
                            ">=",
                            p.scan_difference,
                            "m²",
                            "scan_difference",
                        ),
                    ),
                ),
            )
        revert = tuple(
            Term(f"seen past at {resolution:g}/°", past >> k & 1, ">=", 1)
            for k, resolution in enumerate(p.revert_resolutions, len(p.resolutions))
        )
        seen = [Term(f"seen past {name}", past >> k & 1, ">=", 1) for k, name in enumerate(shown)]
        return tuple(
            Rule(f"nearer {name}", (term, *revert)) for name, term in zip(shown, seen, strict=True)
        )

    def _within_reach(self, scan: Scan, scan_ranges: F32) -> tuple[I64, np.float32]:
        """Chunks of the map near the scan, and the range, metres, beyond which the scan cannot
        judge map points.
        """
        farthest = scan_ranges[np.isfinite(scan_ranges)].max(initial=0)
        reach = farthest + LARGEST if self.params.port else farthest * (1 + self.params.threshold)
        return chunks(self._tiles.spans(scan.position, 1.001 * float(reach))), np.float32(
            1.0001 * reach
        )

    def _nearest(self, scan: Scan, xyz: F32, which: I64, reach: np.float32) -> tuple[F32, I32]:
        """Range and index of the nearest point in each pixel of all images."""
        xyz = kernels.as_readonly(xyz, np.float32)
        lanes = kernels.threads_in_use()
        ranges, indices = SHARED.range_image.nearest(
            xyz, which, reach, *self._camera(scan), lanes, np.float32(0)
        )
        return ranges, indices

    def _camera(self, scan: Scan) -> tuple[F64, F64, F64, bool]:
        """Centre, axes and views of the images, and whether points above or below them go to their
        border rows.
        """
        axes = np.eye(3) if self.params.port else scan.T_world_sensor[:3, :3].T
        centre = kernels.as_readonly(scan.position, np.float64)
        return centre, kernels.as_readonly(axes, np.float64), self._views, self.params.port

    def _judge_all(self, scan: Scan, scan_ranges: F32, which: I64, reach: np.float32) -> None:
        """Judge every map point by its own range."""
        threshold = np.float32(self.params.threshold)
        surface = np.where(np.isfinite(scan_ranges), scan_ranges, np.float32(0))
        limits = kernels.as_readonly(surface - threshold * surface, np.float32)
        spread = (1 + threshold) / (1 - threshold)
        camera = self._camera(scan)
        flags = (self._past, self._met)
        SHARED.range_image.judge(self._map, which, reach, *camera, limits, spread, *flags)

    def _judge_nearest(self, nearest: I32, flagged: Bool, seen: Bool) -> None:
        """Judge only the nearest map point of each pixel."""
        images = slices(self._views)
        for k, image in enumerate(images):
            self._past[nearest[image][flagged[image]]] |= np.uint8(1 << k)
        agreeing = nearest[images[0]][(seen & ~flagged & (nearest >= 0))[images[0]]]
        self._met[agreeing] |= ONCE | (self._met[agreeing] & ONCE) << 1

    def _flagged(self, scan_ranges: F32, map_ranges: F32) -> Bool:
        """(P,) bool: pixels whose nearest map point is dynamic.

        Ranges are infinite in empty pixels.
        """
        with np.errstate(invalid="ignore"):
            difference = scan_ranges - map_ranges
        if self.params.port:
            difference = np.abs(difference)
            difference[difference >= LARGEST] = 0
        flagged: Bool = np.isfinite(difference) & (
            difference > np.float32(self.params.threshold) * scan_ranges
        )
        return flagged

    def _dynamic(self, past: U8) -> Bool:
        verdict = self._verdicts[past]
        dynamic: Bool = (verdict >= NEARER) & (verdict < REVERTED)
        return dynamic

    def _of(self, scan: Scan, of_map: U8) -> U8:
        """(N,) uint8: the entries of an array over map points for the points of a scan."""
        entries: U8 = of_map[self._map_points[self._places[scan.index]]]
        return entries

    def _scan_side(self, scan: Scan) -> Bool:
        """(N,) bool: points around which the density of the cleaned map differs from that of the
        scan.
        """
        dynamic: Bool = self._densities(scan) >= self.params.scan_difference
        return dynamic

    def _densities(self, scan: Scan) -> F64:
        """(N,) float64, square metres: difference between the averages of the scan-side step.

        NaN if not in the map.
        """
        from scipy.spatial import cKDTree

        difference = np.full(len(scan), np.nan)
        placed = np.flatnonzero(self._map_points[self._places[scan.index]] >= 0)
        if len(placed):
            if self._tree is None:
                self._tree = cKDTree(self._map[:, ~self._dynamic(self._past[:-1])].T)
            points = scan.points[placed]
            neighbours = min(self.params.scan_neighbours, len(placed))
            own, cleaned = (
                _mean_square(tree, points, neighbours) for tree in (cKDTree(points), self._tree)
            )
            difference[placed] = np.abs(cleaned - own)
        return difference

    def _draws(self) -> bool:
        return any(self._probe.wants(state.name) for state in STATES if state.kind is RangeImage)

    def _draw(self, scan_ranges: F32, map_ranges: F32, flagged: Bool) -> None:
        """Show the images of the first resolutions."""
        with np.errstate(invalid="ignore"):
            difference = scan_ranges - map_ranges
        values = scan_ranges, map_ranges, difference, np.where(flagged, difference, np.nan)
        shown = min(SHOWN, len(self.params.resolutions))
        for k, view in enumerate(self._views[:shown], 1):
            for (name, *_), flat in zip(IMAGES, values, strict=True):
                self._probe.emit(f"{name}_{k}", picture(flat, view))

    def _draw_accused(self, scan: Scan, accused: F32) -> None:
        ranges = np.linalg.norm(accused - scan.position, axis=1).astype(np.float32)
        self._probe.emit("accused", Points(np.ascontiguousarray(accused), ranges))


# bits of SHARED.range_image.judge: pixel with a return; on a surface; on a second one
IN_VIEW = 1
ONCE = 2
AGAIN = 4


def verdicts(resolutions: int, revert_resolutions: int) -> U8:
    """(256,) uint8: reason code by the resolutions, as bits, at which scans see past a point."""
    past = np.arange(256)
    revert = ((1 << revert_resolutions) - 1) << resolutions
    reasons = np.full(256, AGREES, np.uint8)
    for k in reversed(range(resolutions)):
        reasons[past >> k & 1 == 1] = NEARER + min(k, SHOWN - 1)
    reasons[(reasons != AGREES) & (past & revert != revert)] = REVERTED
    return reasons


def _rows(which: I64) -> I64:
    """The rows of the map in some chunks."""
    return np.concatenate(
        [np.empty(0, np.int64), *(np.arange(first, last) for first, last in which)]
    )


def _mean_square(tree: cKDTree, points: F32, neighbours: int) -> F64:
    """(N,) float64, square metres: mean squared distance to the nearest neighbours.

    Infinite if there are too few.
    """
    distances, _ = tree.query(
        points, list(range(1, neighbours + 1)), workers=kernels.threads_in_use()
    )
    mean: F64 = np.square(distances).mean(1)
    return mean
