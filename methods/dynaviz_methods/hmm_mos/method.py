"""HMM-MOS: points in or near voxels that have just turned from free to occupied are dynamic.

Bhandari, James, Phillips and McAree 2024. Each voxel has a hidden Markov model with the states
unknown, occupied and free. The algorithm, online:

    for each scan
        a  observe:    cast an integer line to each voxel with points; all its voxels up to
                       max_range are observed
        b  filter:     set the likelihood of occupied to exp(-d^2 / 2 resolution^2), d the distance
                       of the voxel from the nearest one with points in this scan or the last;
                       update the belief of each observed voxel
                       decide its state, occupied or free, if that belief exceeds belief
        c  score:      for each voxel with points, count the voxels in a cube of kernel voxels that
                       have points and just turned from free to occupied, minus those of unknown
                       state; at least 0
                       take the median over adjacent voxels with points, and sum these of the last
                       window scans
        d  threshold:  split the sums by Otsu's threshold; a voxel above it is dynamic
                       so is a voxel that was dynamic in the last scan and whose sum exceeds
                       min_score
                       so are voxels with points next to these
    label a point dynamic if its voxel is dynamic when the point arrives, and the threshold exceeds
        min_score

"Dynamic" means moving now: an object that waits is static. Voxels that no scan observes for
forget_after scans, or farther than 1.5 max_range, are unknown again. The first window + 1 scans,
points closer than min_range, points farther than max_range, points that are not finite, and points
more than 32768 voxels from the world's origin are kept. Only voxels near points have state. Labels
are decided when a scan is observed, and stored with four bits per point.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F64, I32, I64, U8, Bool
from dynaviz.blocks.blocks import VOXELS
from dynaviz.contracts.evidence import Asked, Evidence, Quantity, Rule, Term, voxels_around
from dynaviz.contracts.method import Cause, Context, Labels, MethodInfo, Reason
from dynaviz.contracts.params import require
from dynaviz.contracts.probe import PointClasses, Scalar, State, Voxels
from dynaviz.contracts.scan import Scan
from dynaviz_methods.hmm_mos.belief_map import BeliefMap, Scores
from dynaviz_methods.shared.codes import pack_codes, unpack_codes
from dynaviz_methods.shared.lookups import around, known

KERNELS = kernels.load("dynaviz_methods.hmm_mos.kernels")

OCCUPIED = 1  # state of a voxel
BINS = 100  # of the histogram for the threshold, as published
SHOWN = 25.0  # metres around the sensor: range of the slices to show


@dataclass(frozen=True)
class HmmMosParams:
    """Parameters of HMM-MOS.

    The defaults are the published ones for a car with a 64-ring sensor (Apollo).

    Attributes:
        resolution: edge of a voxel, metres; also the standard deviation of the likelihood.
        belief: belief above which a voxel's state is decided.
        kernel: edge of the cube in which changes count, voxels; odd.
        window: scans over which scores are summed.
        forget_after: scans after which a voxel that is not observed becomes unknown.
        min_score: smallest threshold that separates dynamic voxels from noise, voxels.
        min_range: closer points are ignored, metres.
        max_range: greatest range that is observed and labelled, metres.
        port: reproduce two traits of the public program: indices of points are rounded towards
            zero, and voxels last seen in the first forget_after scans never become unknown through
            age.
    """

    resolution: float = 0.25
    belief: float = 0.99
    kernel: int = 5
    window: int = 5
    forget_after: int = 300
    min_score: int = 3
    min_range: float = 1.5
    max_range: float = 120.0
    port: bool = False

    def __post_init__(self) -> None:
        near = self.min_range
        voxels = 20_000
        require(self, "resolution", lambda edge: 0 < edge < np.inf, "metres above 0")
        require(
            self, "belief", lambda belief: 0.5 <= belief < 1, "a probability from 0.5 to below 1"
        )
        require(
            self, "kernel", lambda k: 1 <= k <= 17 and k % 2, "an odd number of voxels from 1 to 17"
        )
        require(
            self,
            "window forget_after",
            lambda scans: 1 <= scans <= 65534,
            "a number of scans from 1 to 65534",
        )
        require(
            self,
            "min_score",
            lambda score: 0 <= score < 1 << 31,
            "a number of voxels of at least 0",
        )
        require(self, "min_range", lambda metres: 0 <= metres < np.inf, "metres of at least 0")
        require(
            self,
            "max_range",
            lambda far: near < far < np.inf,
            f"more metres than min_range = {near}",
        )
        what = f"at most {voxels * self.resolution:g} metres, {voxels} voxels"
        require(self, "max_range", lambda far: far / self.resolution <= voxels, what)


(
    OUT_OF_RANGE,
    OUT_OF_REACH,
    WARM_UP,
    UNDECIDED,
    ABOVE,
    CARRIED,
    BESIDE,
    BELOW,
    UNKNOWN_AROUND,
    LONG,
    NO_CHANGE,
) = range(11)
REASONS = (
    Reason(
        "out_of_range",
        "kept unjudged: closer than min_range or farther than max_range",
        Cause.OUT_OF_RANGE,
    ),
    Reason(
        "out_of_reach",
        "kept unjudged: not finite, or more than 32768 voxels from the world's origin",
        Cause.OUT_OF_RANGE,
    ),
    Reason("warm_up", "kept: in one of the first window + 1 scans", Cause.NOT_YET_FREE),
    Reason(
        "scan_undecided",
        "kept: its voxel is dynamic, but the scan's threshold is at most min_score",
    ),
    Reason(
        "above_threshold",
        "removed: enough voxels around it have just turned occupied",
        Cause.PARTLY_EMPTY,
    ),
    Reason(
        "carried",
        "removed: its voxel was dynamic one scan ago, and its score exceeds min_score",
        Cause.SHARED_CELL,
    ),
    Reason("beside_dynamic", "removed: its voxel touches a dynamic voxel", Cause.SHARED_CELL),
    Reason(
        "below_threshold",
        "kept: voxels around it have just turned occupied, but too few of them",
        Cause.SPARSE_RINGS,
    ),
    Reason(
        "unknown_around",
        "kept: nothing around it has just turned occupied, and most of it is unknown",
        Cause.NOT_YET_FREE,
    ),
    Reason(
        "long_occupied",
        "kept: its voxel has been occupied without change for at least a window of scans",
        Cause.STANDING,
    ),
    Reason("no_change", "kept: nothing around it has just turned occupied"),
)
STATES = (
    State(
        "dynamic",
        PointClasses,
        "Points by voxel: dynamic by the threshold, by the last scan, or by a neighbour; dynamic "
        "in an undecided scan",
        legend=("none", "above threshold", "carried", "next to dynamic", "undecided"),
    ),
    State("turned", Voxels, "Voxels with points that turn from free to occupied in this scan"),
    State(
        "score",
        Voxels,
        "Voxels with changes around them in this scan; number of changes",
        value_range=(0.0, 30.0),
    ),
    State(
        "window_score",
        Voxels,
        "Voxels with points whose summed median score is above 0; that score",
        value_range=(0.0, 60.0),
    ),
    State(
        "likelihood",
        Voxels,
        "Observed voxels near the sensor, at its height; likelihood that they are occupied",
        value_range=(0.0, 1.0),
    ),
    State(
        "belief",
        Voxels,
        "Observed voxels near the sensor, at its height; belief that they are occupied",
        value_range=(0.0, 1.0),
    ),
    State(
        "threshold",
        Scalar,
        "Otsu's threshold of the summed scores; the scan is undecided up to min_score",
    ),
)
CLASS = np.zeros(len(REASONS), np.uint8)  # reason code to class of the legend
CLASS[[ABOVE, CARRIED, BESIDE, UNDECIDED]] = 1, 2, 3, 4


class HmmMos:
    """HMM-MOS; each point is labelled when it arrives."""

    info: ClassVar[MethodInfo] = MethodInfo(
        "hmm_mos",
        "HMM-MOS",
        "Bhandari et al., IROS workshop 2024",
        REASONS,
        STATES,
        colour=(140, 170, 180),
        compiles_long=True,
    )
    Params: ClassVar[type[Any]] = HmmMosParams

    def __init__(self, params: Any) -> None:
        self.params = params

    def begin(self, context: Context) -> None:
        """Allocate the map where points will lie."""
        p = self.params
        self._probe = context.probe
        self._map = BeliefMap(
            context.extent, p.resolution, p.kernel // 2, p.max_range, p.forget_after, p.port
        )
        # voxels with a median above 0, and that median
        self._window: deque[tuple[I64, I32]] = deque(maxlen=p.window)
        self._last = np.empty(0, np.int64)  # dynamic voxels of the last scan
        size = len(self._map) * VOXELS + 1  # points without a voxel (-1) use the last entry
        # by voxel; 0 between scans
        self._sums = np.zeros(size, np.int32)
        self._codes = np.zeros(size, np.uint8)
        self._reasons: dict[int, U8] = {}  # by scan index: four bits per point, packed

    def observe(self, scan: Scan) -> None:
        """Integrate the scan, and label its points by the changes that it makes."""
        p = self.params
        voxels = self._map.place(scan.points)
        self._drop_gone()
        origin = (
            scan.position.astype(np.float32).astype(np.float64) if p.port else scan.position.copy()
        )
        used = (voxels >= 0) & (
            KERNELS.integer_lines.squared_ranges(scan.points, origin) > p.min_range**2
        )
        self._map.see(voxels[used], origin)
        self._map.learn(p.belief, keep_field=self._probe.wants("likelihood"))
        scores = self._map.score()
        sums = self._summed(scores)
        threshold = otsu(sums)
        self._judged = scan.index, voxels, used, scores.voxels, sums, threshold, self._last
        self._codes[scores.voxels] = self._judge(scores, sums, threshold)
        reasons = np.where(used, self._codes[voxels], OUT_OF_RANGE).astype(np.uint8)
        reasons[voxels < 0] = OUT_OF_REACH
        self._codes[scores.voxels] = OUT_OF_RANGE
        self._reasons[scan.index] = pack_codes(reasons)
        self._show(scores, sums, threshold, reasons)
        self._map.done()

    def forget(self, index: int) -> None:
        """Drop the labels of a scan."""
        self._reasons.pop(index, None)

    def _drop_gone(self) -> None:
        """Drop what earlier scans remember of voxels that are gone."""
        if self._map.rolls:
            self._last = self._map.remaining_voxels(self._last)
            for n, (voxels, medians) in enumerate(self._window):
                exist = self._map.existing()[voxels >> 9]
                self._window[n] = voxels[exist], medians[exist]

    def label(self, scan: Scan) -> Labels:
        """Label points dynamic whose voxel was dynamic when the scan was observed."""
        reasons = unpack_codes(self._reasons[scan.index], len(scan))
        return Labels((reasons >= ABOVE) & (reasons <= BESIDE), reasons)

    def evidence(self, asked: Asked) -> Evidence:
        """State and belief of the points' voxels, and the changes around them that are summed over
        the window.
        """
        voxels = self._map.place(asked.points)
        belief = self._map.belief.ravel()[voxels]
        state = self._map.state.ravel()[voxels]
        index, own, used, occupied, sums, threshold, last = self._judged
        quantities = (
            Quantity("state", known(state, voxels), legend=("unknown", "occupied", "free")),
            Quantity(
                "belief",
                np.where(state == 0, np.nan, known(belief, voxels)),
                total=True,
                threshold=0.5,
            ),
            Quantity("score", _values_at(sums, occupied, voxels), threshold=self.params.min_score),
        )
        rules: tuple[Rule, ...] = ()
        if index == asked.scan.index:
            rules = self._rules(
                np.where(used, own, -1)[asked.rows], occupied, sums, threshold, last
            )
        return Evidence(
            voxels_around(asked.points, self.params.resolution),
            quantities,
            rules,
            final=bool(rules),
        )

    def _rules(
        self, voxels: I64, occupied: I64, sums: I32, threshold: float, last: I64
    ) -> tuple[Rule, ...]:
        """What decided the labels of the scan that was observed last."""
        p = self.params
        decided = (
            Term("scans so far", np.full(len(voxels), self._map.number), ">", p.window + 1),
            Term(
                "threshold of the scan",
                np.full(len(voxels), threshold),
                ">",
                p.min_score,
                parameter="min_score",
                follows="otherwise",
            ),
        )
        score = _values_at(sums, occupied, voxels)
        enough = Term(
            "summed score", score, ">", p.min_score, parameter="min_score", follows="otherwise"
        )
        was = _values_at(_among(last, occupied), occupied, voxels)
        above = (sums > threshold) | (_among(last, occupied) & (sums > p.min_score))
        near = np.isin(around(self._map, voxels), occupied[above]).sum(1)
        return (
            Rule("above", (*decided, Term("summed score", score, ">", threshold))),
            Rule(
                "carried",
                (*decided, Term("dynamic one scan ago", was, ">=", 1), enough),
            ),
            Rule(
                "next to dynamic",
                (*decided, Term("dynamic voxels around it", known(near, voxels), ">=", 1)),
            ),
        )

    def _summed(self, scores: Scores) -> I32:
        """(N,) int32: the medians of the last scans, this one included, summed for the occupied
        voxels.
        """
        changed = scores.median > 0 if self._judges else np.zeros(len(scores.voxels), np.bool_)
        self._window.append((scores.voxels[changed], scores.median[changed]))
        for voxels, medians in self._window:
            self._sums[voxels] += medians
        sums = self._sums[scores.voxels]
        for voxels, _ in self._window:
            self._sums[voxels] = 0
        return sums

    def _judge(self, scores: Scores, sums: I32, threshold: float) -> U8:
        """Reason code of each occupied voxel, (N,) uint8; remembers the dynamic ones."""
        p = self.params
        voxels = scores.voxels
        if not self._judges:
            return np.full(len(voxels), WARM_UP, np.uint8)
        above = (sums > threshold) & (len(sums) > 0 and sums.min() < sums.max())
        carried = _among(self._last, voxels) & (sums > p.min_score)
        dynamic = _among(self._map.beside(voxels[above | carried]), voxels)
        self._last = voxels[dynamic]

        place = voxels // VOXELS, voxels % VOXELS
        lasting = (self._map.state[place] == OCCUPIED) & (
            self._map.number - self._map.since[place] >= p.window
        )
        codes = np.where(lasting, LONG, NO_CHANGE).astype(np.uint8)
        codes[2 * scores.known < p.kernel**3] = UNKNOWN_AROUND
        codes[sums > 0] = BELOW
        codes[dynamic] = BESIDE
        codes[carried] = CARRIED
        codes[above] = ABOVE
        if threshold <= p.min_score:
            codes[dynamic] = UNDECIDED
        return codes

    @property
    def _judges(self) -> bool:
        """Whether this scan is judged: the first window + 1 are not."""
        return bool(self._map.number > self.params.window + 1)

    def _show(self, scores: Scores, sums: I32, threshold: float, reasons: U8) -> None:
        wants = self._probe.wants
        emit = self._probe.emit
        size = self.params.resolution
        if wants("threshold"):
            emit("threshold", Scalar(threshold))
        if wants("dynamic"):
            emit("dynamic", PointClasses(CLASS[reasons]))
        for name, values in (("score", scores.raw), ("window_score", sums)):
            if wants(name):
                some = values > 0
                emit(
                    name,
                    Voxels(
                        self._map.keys(scores.voxels[some]), size, values[some].astype(np.float32)
                    ),
                )
        if wants("turned"):
            emit("turned", Voxels(self._map.keys(self._map.turned_voxels()), size))
        if wants("likelihood") or wants("belief"):
            keys, likelihood, belief = self._map.slice(SHOWN)
            emit("likelihood", Voxels(keys, size, likelihood))
            emit("belief", Voxels(keys, size, belief))


def otsu(sums: I32) -> float:
    """Otsu's threshold of integer values (N,), from a histogram of 100 bins.

    0 if all values are equal.

    Bins are closed on the right. Of equally good splits, the last is used: the threshold is the
    lower edge of the first bin of the upper class.
    """
    if not len(sums) or sums.min() == sums.max():
        return 0.0
    low = int(sums.min())
    high = int(sums.max())
    counts = np.bincount(sums - low)
    values = np.arange(len(counts))
    bins = np.ceil(values / ((high - low) / BINS)).astype(np.int64) - 1
    bins[0] = 0
    bins[-1] = BINS - 1
    histogram = np.bincount(bins, counts, BINS)
    # number of values below each bin, and sum of their bins
    below = np.append(0.0, np.cumsum(histogram)[:-1])
    moment = np.append(0.0, np.cumsum(histogram * np.arange(BINS))[:-1])
    above = len(sums) - below
    splits = np.flatnonzero((below > 0) & (above > 0))
    below = below[splits]
    above = above[splits]
    moment = moment[splits]
    total = (histogram * np.arange(BINS)).sum()
    between = below * above * (moment / below - (total - moment) / above) ** 2
    level = splits[np.flatnonzero(between == between.max())[-1]]
    return low + float(level) * (high - low) / BINS


def _values_at(values: I32 | Bool, occupied: I64, voxels: I64) -> F64:
    """(K,) float64: the values (N,) of sorted voxels (N,) at voxels (K,); NaN where absent."""
    at = np.searchsorted(occupied, voxels)
    inside = np.append(occupied, -2)[at] == voxels
    return np.where(inside, np.append(values, 0)[at], np.nan)


def _among(some: I64, voxels: I64) -> Bool:
    """(N,) bool: which of the voxels (N,), sorted, are among some others."""
    chosen = np.zeros(len(voxels), np.bool_)
    if len(voxels):
        at = np.minimum(np.searchsorted(voxels, some), len(voxels) - 1)
        chosen[at[voxels[at] == some]] = True
    return chosen
