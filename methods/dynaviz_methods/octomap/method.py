"""OctoMap and its two variants.

``octomap``, ``octomap_g`` (ground) and ``octomap_gf`` (ground and noise filter).

Hornung et al. 2013; the variants are those of the benchmark (Zhang et al. 2023, Section III-C). One
algorithm:

    for each scan
        F  noise:   find points far from their neighbours (statistical outlier removal)
        G  ground:  fit one plane to the other points (RANSAC); points near it are ground
        free:       find the voxels that rays cross; for each, once: log-odds += logit(prob_miss),
                    clamp
        occupied:   find the voxels of all points except ground; for each, once: log-odds +=
                    logit(prob_hit), clamp
    label a point static if the log-odds of its voxel are at least 0, or if it is ground

Noise casts no ray. A ray crosses the voxels from the sensor's up to, but not including, the voxel
of its point. If a scan both crosses and hits a voxel, both updates count. Log-odds are float32;
only voxels near points store them (``dynaviz.blocks.blocks``). Keys have 16 bits per axis, as in
the original: points more than 32768 voxels from the world's origin, and points that are not finite,
are kept unjudged. A sensor beyond that reach casts no rays, but its points still hit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import U8, Bool
from dynaviz.blocks.blocks import VOXELS, BlockGrid, Marks, read, voxels_of
from dynaviz.contracts.evidence import Asked, Evidence, Quantity, Rule, Step, Term, voxels_around
from dynaviz.contracts.method import Cause, Context, Halo, Labels, MethodInfo, Reason
from dynaviz.contracts.params import require
from dynaviz.contracts.probe import Mask, Plane, State, Voxels
from dynaviz.contracts.scan import Scan
from dynaviz_methods.octomap.filters import ground_plane, outliers
from dynaviz_methods.shared.lookups import MarkedBlocks, known

KERNELS = kernels.load("dynaviz_methods.octomap.kernels")


@dataclass(frozen=True)
class OctoMapParams:
    """Parameters of OctoMap.

    Attributes:
        resolution: edge of a voxel, metres.
        prob_hit: occupancy probability of a voxel in which a ray ends.
        prob_miss: occupancy probability of a voxel that a ray crosses.
        clamp_min: minimum occupancy probability.
        clamp_max: maximum occupancy probability.
    """

    resolution: float = 0.1
    prob_hit: float = 0.7
    prob_miss: float = 0.4
    clamp_min: float = 0.12
    clamp_max: float = 0.97

    def __post_init__(self) -> None:
        _positive(self, "resolution")
        what = "a probability above 0 and below 1"
        require(self, "prob_hit prob_miss clamp_min clamp_max", lambda value: 0 < value < 1, what)


@dataclass(frozen=True)
class OctoMapGParams(OctoMapParams):
    """Parameters of OctoMap with ground estimation, in addition to OctoMap's.

    Attributes:
        ground_distance: points closer than this to the ground plane are ground, metres.
        ground_angle: maximum angle between the plane's normal and the vertical, radians.
        cast_ground_rays: cast rays to ground points, as the public program does, from which the
            paper's tables come; the paper's text excludes these rays.
    """

    ground_distance: float = 0.04
    ground_angle: float = 0.15
    cast_ground_rays: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        _positive(self, "ground_distance ground_angle")


@dataclass(frozen=True)
class OctoMapGFParams(OctoMapGParams):
    """Parameters of OctoMap with ground estimation and noise filter, in addition to those of both.

    Attributes:
        noise_neighbours: number of nearest neighbours over which a point's mean distance is
            computed.
        noise_stddev: a point is noise if its mean distance exceeds the mean over all points by this
            many standard deviations.
    """

    noise_neighbours: int = 50
    noise_stddev: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        _positive(self, "noise_neighbours")


def logit(probability: float) -> float:
    """Log-odds of a probability."""
    return math.log(probability / (1 - probability))


def _positive(params: OctoMapParams, names: str) -> None:
    require(params, names, lambda value: 0 < value < math.inf, "a number above 0")


HIT, CROSSED, NEVER_CROSSED, OUT_OF_REACH, GROUND, NOISE = range(6)
REASONS = (
    Reason(
        "hit_more_than_missed",
        "kept: rays crossed the voxel, but hits outweigh misses",
        Cause.STANDING,
    ),
    Reason(
        "crossed_by_rays",
        "removed: rays crossed the voxel, and misses outweigh hits",
        Cause.PARTLY_EMPTY,
    ),
    Reason("never_crossed", "kept: no ray crossed the voxel", Cause.NOTHING_BEHIND),
    Reason(
        "out_of_reach",
        "kept unjudged: not finite, or more than 32768 voxels from the world's origin",
        Cause.OUT_OF_RANGE,
    ),
    Reason("ground_plane", "kept: on the ground plane of its scan", Cause.TAKEN_FOR_GROUND),
    Reason(
        "noise_cell",
        "kept: noise in its scan, which marks its voxel occupied without a ray",
        Cause.SPARSE_RINGS,
    ),
)
ODDS_RANGE = (logit(OctoMapParams.clamp_min), logit(OctoMapParams.clamp_max))
STATES = (
    State(
        "crossed",
        Voxels,
        "Voxels with points that rays of this scan crossed; log-odds",
        value_range=ODDS_RANGE,
        threshold=0.0,
    ),
    State(
        "hit",
        Voxels,
        "Voxels that this scan marked occupied; log-odds",
        value_range=ODDS_RANGE,
        threshold=0.0,
    ),
    State(
        "log_odds",
        Voxels,
        "Voxels with points that this scan crossed or hit; log-odds",
        value_range=ODDS_RANGE,
        threshold=0.0,
    ),
    State("ground", Mask, "Points on the ground plane: always static"),
    State("ground_plane", Plane, "Ground plane fitted to this scan"),
    State(
        "noise",
        Mask,
        "Points far from their neighbours: they mark their voxel occupied but cast no ray",
    ),
)


class OctoMap:
    """OctoMap; a point gets the label of its voxel."""

    info: ClassVar[MethodInfo] = MethodInfo(
        "octomap",
        "OctoMap",
        "Hornung et al., Autonomous Robots 2013",
        REASONS[:4],
        STATES[:3],
        colour=(150, 165, 0),
    )
    Params: ClassVar[type[Any]] = OctoMapParams
    _alone = (
        True  # each voxel is judged by its own rays; ground and noise are found in the whole scan
    )

    def __init__(self, params: Any) -> None:
        self.params = params

    def begin(self, context: Context) -> None:
        """Allocate the map where points will lie."""
        self._seed = context.seed
        self._probe = context.probe
        self._grid = BlockGrid(context.extent, self.params.resolution)
        rows = len(self._grid) + 1  # points without a voxel (-1) read the last row
        self._log_odds = self._grid.per_block(np.zeros((rows, VOXELS), np.float32))
        # voxels crossed or hit by any scan so far; bits as in Marks
        self._ever = self._grid.per_block(np.zeros((rows, 16), np.int64))
        probabilities = (
            self.params.prob_miss,
            self.params.prob_hit,
            self.params.clamp_min,
            self.params.clamp_max,
        )
        self._logits = tuple(np.float32(logit(p)) for p in probabilities)
        self._ground: dict[int, U8] = {}  # by scan index: the mask of its ground points, packed
        self._noise: dict[int, U8] = {}

    def observe(self, scan: Scan) -> None:
        """Mark the voxels that the scan's rays cross and hit, then update each marked
        voxel once.
        """
        noise = self._find_noise(scan)
        ground = self._find_ground(scan, ~noise)
        marks = self._grid.mark(scan, casts=self._casts(noise, ground), hits=~ground)
        KERNELS.log_odds.update(self._log_odds, self._ever, marks.blocks, marks.bits, *self._logits)
        self._marks = marks
        self._marked = MarkedBlocks(marks.blocks)
        if any(self._probe.wants(state.name) for state in STATES[:3]):
            self._show(marks)

    def label(self, scan: Scan) -> Labels:
        """Label points dynamic whose voxel has log-odds below 0, unless they are ground.

        The reason of noise points that are kept is always ``NOISE``.
        """
        voxels = self._grid.locate(scan.points)
        ground = _unpack(self._ground, scan)
        dynamic = (self._log_odds.ravel()[voxels] < 0) & ~ground
        reasons = np.where(read(self._ever, voxels), HIT, NEVER_CROSSED).astype(np.uint8)
        reasons[_unpack(self._noise, scan)] = NOISE
        reasons[dynamic] = CROSSED
        reasons[ground] = GROUND
        reasons[voxels < 0] = OUT_OF_REACH
        return Labels(dynamic, reasons)

    def forget(self, index: int) -> None:
        """Drop the masks of a scan."""
        self._ground.pop(index, None)
        self._noise.pop(index, None)

    def halo(self) -> Halo:
        """Nothing else: a voxel is judged by the rays that cross or hit it."""
        return Halo(0.0)

    def evidence(self, asked: Asked) -> Evidence:
        """The log-odds of the points' voxels, to which each scan adds its hit and its miss."""
        voxels = self._grid.locate(asked.points)
        log_odds = known(self._log_odds.ravel()[voxels], voxels)
        rule = Rule("free", (Term("log-odds", log_odds, "<", 0.0), *self._exceptions(asked)))
        steps = tuple(
            Step(name, parameter, self._marked.read(bits, voxels))
            for name, parameter, bits in (
                ("crossed", "prob_miss", self._marks.bits[:, :8]),
                ("hit", "prob_hit", self._marks.bits[:, 8:]),
            )
        )
        limits = "clamp_min", "clamp_max"
        total = Quantity(
            "log-odds", log_odds, total=True, threshold=0.0, steps=steps, limits=limits
        )
        return Evidence(
            voxels_around(asked.points, self.params.resolution),
            (total,),
            (rule,),
            alone=self._alone,
        )

    def _exceptions(self, asked: Asked) -> tuple[Term, ...]:
        return ()

    def _find_noise(self, scan: Scan) -> Bool:
        return np.zeros(len(scan), np.bool_)

    def _find_ground(self, scan: Scan, among: Bool) -> Bool:
        return np.zeros(len(scan), np.bool_)

    def _casts(self, noise: Bool, ground: Bool) -> Bool:
        return ~noise

    def _show(self, marks: Marks) -> None:
        crossed = marks.bits[:, :8]
        hit = marks.bits[:, 8:]
        with_points = self._ever[marks.blocks, 8:]
        shown = {
            "crossed": crossed & with_points,
            "hit": hit,
            "log_odds": (crossed | hit) & with_points,
        }
        for name, bits in shown.items():
            if self._probe.wants(name):
                voxels = voxels_of(marks.blocks, bits)
                values = self._log_odds.ravel()[voxels]
                self._probe.emit(
                    name, Voxels(self._grid.keys(voxels), self._grid.resolution, values)
                )


class OctoMapG(OctoMap):
    """OctoMap with ground estimation.

    Ground points are static and do not mark their voxels occupied.
    """

    info: ClassVar[MethodInfo] = MethodInfo(
        "octomap_g",
        "OctoMap w G",
        "Zhang et al., ITSC 2023",
        REASONS[:5],
        STATES[:5],
        colour=(30, 105, 75),
    )
    Params: ClassVar[type[Any]] = OctoMapGParams
    _alone = False

    def _find_ground(self, scan: Scan, among: Bool) -> Bool:
        ground = np.zeros(len(scan), np.bool_)
        chosen = np.flatnonzero(among & np.isfinite(scan.points).all(1))
        random = np.random.default_rng((self._seed, scan.index))
        near, plane = ground_plane(
            scan.points[chosen], self.params.ground_distance, self.params.ground_angle, random
        )
        ground[chosen[near]] = True
        self._ground[scan.index] = np.packbits(ground)
        self._probe.emit("ground", Mask(ground))
        if plane is not None:
            self._probe.emit("ground_plane", plane)
        return ground

    def _exceptions(self, asked: Asked) -> tuple[Term, ...]:
        return (Term("on the ground plane", _unpack(self._ground, asked.scan)[asked.rows], "<", 1),)

    def _casts(self, noise: Bool, ground: Bool) -> Bool:
        return ~noise if self.params.cast_ground_rays else ~(noise | ground)


class OctoMapGF(OctoMapG):
    """OctoMap with ground estimation and noise filter.

    Noise marks its voxels occupied, but casts no rays.
    """

    info: ClassVar[MethodInfo] = MethodInfo(
        "octomap_gf",
        "OctoMap w GF",
        "Zhang et al., ITSC 2023",
        REASONS,
        STATES,
        colour=(90, 150, 255),
    )
    Params: ClassVar[type[Any]] = OctoMapGFParams

    def _find_noise(self, scan: Scan) -> Bool:
        noise = np.zeros(len(scan), np.bool_)
        finite = np.flatnonzero(np.isfinite(scan.points).all(1))
        far = outliers(scan.points[finite], self.params.noise_neighbours, self.params.noise_stddev)
        noise[finite[far]] = True
        self._noise[scan.index] = np.packbits(noise)
        self._probe.emit("noise", Mask(noise))
        return noise


def _unpack(masks: dict[int, U8], scan: Scan) -> Bool:
    """The mask of a scan from its packed bits; all False if none is stored."""
    if scan.index not in masks:
        return np.zeros(len(scan), np.bool_)
    return np.unpackbits(masks[scan.index], count=len(scan)).astype(np.bool_)
