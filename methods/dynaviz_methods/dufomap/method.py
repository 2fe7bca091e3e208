"""DUFOMap: points in voxels that were void in any scan are dynamic.

Duberg, Zhang et al. 2024. Space that one scan reliably observes as empty is free; a point there at
any time is dynamic.

    for each scan
        hit:       mark the voxels of points, and those up to hit_margin in front of them along the
                   ray
        observed:  mark the voxels from the sensor to the first hit voxel, and unknown_margin voxels
                   beyond it
        void:      select the observed voxels that are not hit and whose cube of unknown_margin
                   voxels to each side is observed
        seen free: add the void voxels, permanently
    label a point dynamic if its voxel was ever seen free

One ray is cast for each occupied voxel, to its centre. ``hit_margin`` accounts for sensor noise
(d_s in the paper), ``unknown_margin`` for pose and discretisation errors (d_p). A voxel next to
unknown space is not void, but a voxel next to a hit one may be, which is why rays continue beyond
the hit. The order of the scans does not matter, except in online mode (DUFOMap* in the paper),
where a point is judged by the scans so far. Only voxels near points have state, two bits each.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import I64, Bool
from dynaviz.blocks.blocks import VOXELS, read, voxels_of
from dynaviz.contracts.evidence import Asked, Evidence, Quantity, Rule, Term, voxels_around
from dynaviz.contracts.method import Cause, Context, Halo, Labels, MethodInfo, Reason
from dynaviz.contracts.params import require
from dynaviz.contracts.probe import State, Voxels
from dynaviz.contracts.scan import Scan
from dynaviz_methods.dufomap.voids import VoidGrid, VoidMarks
from dynaviz_methods.shared.lookups import MarkedBlocks, around

SHARED = kernels.load("dynaviz_methods.shared.kernels")


@dataclass(frozen=True)
class DufoMapParams:
    """Parameters of DUFOMap.

    Attributes:
        resolution: edge of a voxel, metres.
        hit_margin: distance in front of a point, towards the sensor, that counts as hit, metres;
            the paper's d_s.
        unknown_margin: distance from unknown space within which no voxel is void, voxels; the
            paper's d_p.
        min_range: points closer to the sensor are not integrated, metres; they would enclose it.
        max_range: points farther from the sensor are not integrated, metres; 0 for no limit.
    """

    resolution: float = 0.1
    hit_margin: float = 0.2
    unknown_margin: int = 1
    min_range: float = 0.2
    max_range: float = 0.0

    def __post_init__(self) -> None:
        near = self.min_range
        require(self, "resolution", lambda edge: 0 < edge < np.inf, "metres above 0")
        require(
            self,
            "hit_margin min_range",
            lambda metres: 0 <= metres < np.inf,
            "metres of at least 0",
        )
        require(
            self,
            "unknown_margin",
            lambda voxels: 0 <= voxels <= 100,
            "a number of voxels from 0 to 100",
        )
        what = f"metres above min_range, {near}, or 0 for no limit"
        require(self, "max_range", lambda far: far == 0 or near < far < np.inf, what)


VOID_SEEN, BESIDE_UNKNOWN, NEVER_CROSSED, OUT_OF_RANGE, OUT_OF_REACH = range(5)
REASONS = (
    Reason("void_seen", "removed: its voxel was void in a scan", Cause.PARTLY_EMPTY),
    Reason(
        "beside_unknown",
        "kept: rays crossed its voxel, but always next to unknown space",
        Cause.SPARSE_RINGS,
    ),
    Reason(
        "never_crossed",
        "kept: no ray crossed its voxel in a scan that did not hit it",
        Cause.NOTHING_BEHIND,
    ),
    Reason(
        "out_of_range",
        "kept: closer than min_range or farther than max_range, and its voxel was never void",
        Cause.OUT_OF_RANGE,
    ),
    Reason(
        "out_of_reach",
        "kept unjudged: not finite, or more than 32768 voxels from the world's origin",
        Cause.OUT_OF_RANGE,
    ),
)
SAW = ("hit", "near unknown", "void")  # what a scan saw of a voxel that it observed
STATES = (
    State(
        "hit", Voxels, "Voxels of this scan's points, and those up to hit_margin in front of them"
    ),
    State(
        "observed",
        Voxels,
        "Voxels with points of any scan that this scan observed without hitting them",
    ),
    State(
        "void",
        Voxels,
        "Observed voxels without unknown space around them: seen free from this scan on",
    ),
    State(
        "seen_free",
        Voxels,
        "Voxels with points that have been void in any scan, in the blocks this scan observed",
    ),
)


class DufoMap:
    """DUFOMap; in online mode DUFOMap*."""

    info: ClassVar[MethodInfo] = MethodInfo(
        "dufomap",
        "DUFOMap",
        "Duberg, Zhang et al., RA-L 2024",
        REASONS,
        STATES,
        colour=(225, 15, 210),
    )
    Params: ClassVar[type[Any]] = DufoMapParams

    def __init__(self, params: Any) -> None:
        self.params = params

    def begin(self, context: Context) -> None:
        """Allocate the grid where points will lie, and around it."""
        params = self.params
        self._probe = context.probe
        self._grid = VoidGrid(
            context.extent, params.resolution, params.hit_margin, params.unknown_margin
        )
        rows = len(self._grid) + 1  # points without a voxel (-1) read the last row
        # bits as in VoidMarks
        self._seen_free = self._grid.per_block(np.zeros((rows, 8), np.int64))
        self._crossed = self._grid.per_block(np.zeros((rows, 8), np.int64))
        self._listened = any(self._probe.wants(state.name) for state in STATES)
        self._with_points = np.zeros((rows if self._listened else 0, 8), np.int64)
        if self._listened:
            self._grid.per_block(self._with_points)

    def observe(self, scan: Scan) -> None:
        """Find the scan's void voxels and mark them as seen free."""
        voxels, within = located = self._located(scan)
        self._last = scan.index, located
        self._seen = seen = self._grid.see(scan, voxels, within & (voxels >= 0))
        self._marked = MarkedBlocks(seen.blocks)
        SHARED.voids.remember(
            seen.blocks, seen.hit, seen.observed, seen.void, self._seen_free, self._crossed
        )
        if self._listened:
            self._show(seen, voxels[voxels >= 0])

    def label(self, scan: Scan) -> Labels:
        """Label points dynamic whose voxel was ever seen free."""
        index, located = self._last
        voxels, within = located if index == scan.index else self._located(scan)
        dynamic = read(self._seen_free, voxels)
        reasons = np.where(read(self._crossed, voxels), BESIDE_UNKNOWN, NEVER_CROSSED).astype(
            np.uint8
        )
        reasons[~within] = OUT_OF_RANGE
        reasons[dynamic] = VOID_SEEN
        reasons[voxels < 0] = OUT_OF_REACH
        return Labels(dynamic, reasons)

    def forget(self, index: int) -> None:
        """Nothing: scans leave only voxels."""

    def halo(self) -> Halo:
        """Voxels that decide whether others are void, and the hits that end rays."""
        p = self.params
        return Halo(
            max(p.hit_margin, p.unknown_margin * p.resolution) + p.resolution, along_rays=True
        )

    def evidence(self, asked: Asked) -> Evidence:
        """Whether the last scan saw the points' voxels void, and how much of the cubes around them
        it observed.
        """
        seen = self._seen
        voxels = self._grid.locate(asked.points)
        margin = self.params.unknown_margin
        cubes = around(self._grid, voxels, margin)
        marked = self._marked
        observed = marked.read(seen.observed, cubes.ravel()).reshape(cubes.shape).sum(1)
        own, hit = (marked.read(bits, voxels) for bits in (seen.observed, seen.hit))
        void = ~hit & (observed >= cubes.shape[1])
        saw = Quantity("saw", np.where(hit, 0.0, np.where(own, 1.0 + void, np.nan)), legend=SAW)
        count = Quantity("observed", np.where(own, observed, np.nan), threshold=cubes.shape[1])
        free = Quantity(
            "seen free", read(self._seen_free, voxels).astype(float), total=True, threshold=1
        )
        around_it = Term(
            "voxels observed in the cube around it",
            observed,
            ">=",
            cubes.shape[1],
            parameter="unknown_margin",
            follows="otherwise",
        )
        rule = Rule("void", (Term("hit by the scan", hit, "<", 1), around_it), lasting=True)
        return Evidence(
            voxels_around(asked.points, self.params.resolution), (saw, count, free), (rule,)
        )

    def _located(self, scan: Scan) -> tuple[I64, Bool]:
        """The voxel of each point, (N,) int64, -1 for none.

        And whether its range is within the limits, (N,) bool.
        """
        nearest = float(self.params.min_range)
        farthest = float(self.params.max_range or np.inf)
        within: Bool = SHARED.voids.in_range(scan.points, scan.origins, nearest, farthest)
        return self._grid.locate(scan.points), within

    def _show(self, seen: VoidMarks, voxels: I64) -> None:
        np.bitwise_or.at(
            self._with_points, (voxels // VOXELS, voxels % VOXELS // 64), np.int64(1) << voxels % 64
        )
        known = self._with_points[seen.blocks]
        shown = {
            "hit": seen.hit,
            "observed": seen.observed & ~seen.hit & known,
            "void": seen.void & known,
            "seen_free": self._seen_free[seen.blocks] & known,
        }
        for name, bits in shown.items():
            if self._probe.wants(name):
                keys = self._grid.keys(voxels_of(seen.blocks, bits))
                self._probe.emit(name, Voxels(keys, self._grid.resolution))
