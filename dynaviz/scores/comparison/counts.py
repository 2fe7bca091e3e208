"""Numbers behind a comparison of two runs on the same points.

Scores, agreement, and gains by frame and place.

Everything follows from counts of points. A *gain* is how much less the second run loses than the
first, in percentage points of SA and of DA. Gains are additive: summed over all frames, or over all
places, they give the difference of the scores. Because a sequence has far more static than dynamic
points, 100 static points change a gain far less than 100 dynamic ones, just as in the scores.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from dynaviz.arrays import F32, F64, I64, U8, Bool, Intp
from dynaviz.contracts.scan import TRUTH, Label, Outcome
from dynaviz.scores.comparison.frame_answers import BAND_NAMES, FrameAnswers
from dynaviz.scores.scores import accuracies, percentage_points_lost

TRUTHS = tuple(TRUTH.values())
# bit 0: the first run is right; bit 1: the second is
AGREEMENT = (
    "neither",
    "only_first",
    "only_second",
    "both",
)
NEITHER, FIRST, SECOND, BOTH = range(4)
REMOVED_BY = AGREEMENT  # of points without ground truth: which of the runs removed them
WRONG = ("FP", "FN")  # points: static points removed, dynamic points kept
PLACE = 5.0  # metres: edge of the square columns called places
LEVEL = 0.95
RESAMPLES = 4000
SEED = 0
_REASONS = 256
_REACH = 1 << 31  # cells along y

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class ByScore(Generic[T]):
    """One value for each score: SA, DA, AA and HA in percent, FP and FN in points."""

    SA: T
    DA: T
    AA: T
    HA: T
    FP: T
    FN: T

    def items(self) -> Iterator[tuple[str, T]]:
        """Names and values, in the order of tables."""
        for field in dataclasses.fields(self):
            yield field.name, getattr(self, field.name)


def agreement(truth: U8, first: Bool, second: Bool) -> U8:
    """(N,) uint8, an index into ``AGREEMENT`` per point.

    Truth (N,) uint8, answers (N,) bool, True = dynamic.
    """
    dynamic = truth == Label.DYNAMIC
    right: U8 = (first == dynamic) + np.uint8(2) * (second == dynamic)
    return right


@dataclass(frozen=True, slots=True, eq=False)
class AgreementCounts:
    """Counts of the labelled points by which of two runs labelled them correctly.

    Attributes:
        index: (F,) int64, numbers of the frames in their data set.
        frames: (F, 2, 4) int64, points by frame, truth (``TRUTHS``) and agreement (``AGREEMENT``).
        bands: (2, 4, 5) int64, points by truth, agreement and range band.
        reasons: (2, 4, 256, 256) int64, points that at least one run got wrong, by truth, agreement
            and the reason codes of the first and of the second run.
        removed_bands: (4, 5) int64, unlabelled points by ``REMOVED_BY`` and range band.
        removed_reasons: (4, 256, 256) int64, unlabelled points that only one run removed, by
            ``REMOVED_BY`` and the reason codes of the first and of the second run.
    """

    index: I64
    frames: I64
    bands: I64
    reasons: I64
    removed_bands: I64
    removed_reasons: I64

    @property
    def points(self) -> I64:
        """(2, 4) int64: points by truth and agreement."""
        points: I64 = self.frames.sum(0)
        return points


def count_agreement(
    first: Iterable[FrameAnswers], second: Iterable[FrameAnswers]
) -> AgreementCounts:
    """Count agreement between two runs, frame by frame.

    Raises:
        ValueError: if the two runs differ in their frames or points.
    """
    index = []
    frames = []
    bands = np.zeros((len(TRUTHS), len(AGREEMENT), len(BAND_NAMES)), np.int64)
    reasons = np.zeros((len(TRUTHS), len(AGREEMENT), _REASONS, _REASONS), np.int64)
    removed_bands = np.zeros((len(REMOVED_BY), len(BAND_NAMES)), np.int64)
    removed_reasons = np.zeros((len(REMOVED_BY), _REASONS, _REASONS), np.int64)
    for a, b in zip(first, second, strict=True):
        if not np.array_equal(a.truth, b.truth):
            raise ValueError(f"in frame {a.frame} the ground truth differs")
        labelled = a.truth != Label.UNLABELLED
        kind = a.truth * np.uint8(len(AGREEMENT)) + agreement(a.truth, a.dynamic, b.dynamic)
        kind = kind[labelled].astype(np.intp)
        band = a.bands[labelled]
        frames.append(np.bincount(kind, minlength=8).reshape(2, 4))
        bands += np.bincount(kind * len(BAND_NAMES) + band, minlength=bands.size).reshape(
            bands.shape
        )
        wrong = kind % len(AGREEMENT) != BOTH
        codes = (kind[wrong] * _REASONS + a.reasons[labelled][wrong]) * _REASONS + b.reasons[
            labelled
        ][wrong]
        reasons += np.bincount(codes, minlength=reasons.size).reshape(reasons.shape)
        if not labelled.all():
            _count_removed(a, b, ~labelled, removed_bands, removed_reasons)
        index.append(a.index)
    counts = np.array(frames, np.int64).reshape(-1, len(TRUTHS), len(AGREEMENT))
    return AgreementCounts(
        np.array(index, np.int64), counts, bands, reasons, removed_bands, removed_reasons
    )


def _count_removed(
    a: FrameAnswers, b: FrameAnswers, chosen: Bool, bands: I64, reasons: I64
) -> None:
    """Add the chosen points of a frame to counts by which run removed them."""
    by = (a.dynamic[chosen] + np.uint8(2) * b.dynamic[chosen]).astype(np.intp)
    bands += np.bincount(by * len(BAND_NAMES) + a.bands[chosen], minlength=bands.size).reshape(
        bands.shape
    )
    differ = (by == FIRST) | (by == SECOND)
    codes = (by[differ] * _REASONS + a.reasons[chosen][differ]) * _REASONS + b.reasons[chosen][
        differ
    ]
    reasons += np.bincount(codes, minlength=reasons.size).reshape(reasons.shape)


def scores(counts: I64 | F64) -> tuple[ByScore[F64], ByScore[F64]]:
    """Scores of the first and of the second run.

    Args:
        counts: (..., 2, 4), points by truth and agreement.

    Returns:
        For each run (...) float64 per score; NaN where undefined.
    """
    total = counts.sum(-1)
    found = []
    for side in (FIRST, SECOND):
        right = counts[..., side] + counts[..., BOTH]
        values = accuracies(right[..., 0], total[..., 0], right[..., 1], total[..., 1])
        wrong = (total - right).astype(np.float64)
        found.append(ByScore(**values, FP=wrong[..., 0], FN=wrong[..., 1]))
    return found[0], found[1]


def block_length(frames: int) -> int:
    """Frames per block of the bootstrap: the square root of their number."""
    return max(1, round(math.sqrt(frames)))


def intervals(
    frames: I64, resamples: int = RESAMPLES, level: float = LEVEL
) -> ByScore[tuple[float, float] | None]:
    """Confidence intervals of the score differences, by a paired circular block bootstrap over
    frames.

    Each resample draws blocks of consecutive frames with replacement, the same blocks for both
    runs, and computes the scores of the summed counts. Blocks are needed because consecutive frames
    show nearly the same points and objects: drawing single frames, as ``scipy.stats.bootstrap``
    does, would treat correlated frames as independent and make the interval several times too
    narrow. Blocks are circular (the last frame is followed by the first), so that each frame is
    drawn equally often, and their length is the square root of the number of frames. The percentile
    interval is valid for this drive: it shows how much the difference depends on single stretches
    of it. It says nothing about other drives.

    Args:
        frames: (F, 2, 4), points by frame, truth and agreement.
        resamples: number of resamples.
        level: confidence level.

    Returns:
        (low, high) of second minus first by score; None below two frames, or if no resample defines
        the score.
    """
    n = len(frames)
    if n < 2:
        return ByScore(None, None, None, None, None, None)
    length = block_length(n)
    around = np.concatenate([frames, frames[: length - 1]]).astype(np.float64)
    sums = np.concatenate([np.zeros((1, *frames.shape[1:])), around.cumsum(0)])
    blocks = sums[length:] - sums[:-length]
    starts = np.random.default_rng(SEED).integers(0, n, (resamples, -(-n // length)))
    drawn = blocks[starts].sum(1) * (n / (starts.shape[1] * length))
    first, second = scores(drawn)
    pairs = zip(first.items(), second.items(), strict=True)
    return ByScore(*(_percentiles(b - a, level) for (_, a), (_, b) in pairs))


def _percentiles(differences: F64, level: float) -> tuple[float, float] | None:
    differences = differences[np.isfinite(differences)]
    if not len(differences):
        return None
    tail = (1 - level) / 2
    low, high = np.quantile(differences, [tail, 1 - tail]).tolist()
    return low, high


def gains(wrong_first: I64, wrong_second: I64, total: I64) -> F64:
    """How much less the second run loses than the first.

    Args:
        wrong_first, wrong_second: (..., 2), wrong points by truth.
        total: (2,), all points of the run by truth.

    Returns:
        (..., 2) float64, percentage points of SA and of DA; 0 where the score is undefined.
    """
    return percentage_points_lost(wrong_first - wrong_second, np.maximum(total, 1))


def frame_gains(counts: AgreementCounts) -> F64:
    """(F, 2) float64: the gain of each frame in percentage points of the run's SA and DA.

    Sums to the difference.
    """
    return gains(counts.frames[..., SECOND], counts.frames[..., FIRST], counts.points.sum(1))


class SpatialCells:
    """Wrong points of a run, counted by square columns of the world, from the points that were
    drawn.

    Columns start at whole metres, like the voxels used to downsample false positives in a
    recording. A column whose size is a whole number of metres therefore contains all points a drawn
    point stands for, except for rounding at its border.

    Args:
        size: edge of a column, metres.
    """

    def __init__(self, size: float = PLACE) -> None:
        self.size = size
        self._keys: list[I64] = []
        self._counts: list[I64] = []
        self._heights: list[F64] = []
        self._frames: list[int] = []

    def add(self, frame: int, xyz: F32, outcome: U8, stands_for: I64) -> None:
        """Add drawn points: xyz (M, 3) metres, world frame; outcome (M,), stands_for (M,).

        Skips non-finite points.
        """
        wrong = np.isin(outcome, (Outcome.FALSE_POSITIVE, Outcome.FALSE_NEGATIVE)) & np.isfinite(
            xyz
        ).all(1)
        xyz = xyz[wrong].astype(np.float64)
        weight = stands_for[wrong]
        cell = np.floor(xyz[:, :2] / self.size).astype(np.int64)
        keys, of = np.unique(cell[:, 0] * _REACH + cell[:, 1], return_inverse=True)
        missed = (outcome[wrong] == Outcome.FALSE_NEGATIVE).astype(np.intp)
        self._keys.append(keys)
        self._counts.append(
            np.bincount(of * 2 + missed, weight, 2 * len(keys)).reshape(-1, 2).astype(np.int64)
        )
        self._heights.append(np.bincount(of, weight * xyz[:, 2], len(keys)).astype(np.float64))
        self._frames.append(frame)

    def rows(self) -> tuple[I64, I64, I64, F64]:
        """One row per cell and frame.

        Packed cells (K,), frames (K,), wrong points by truth (K, 2), summed z (K,).
        """
        counts: I64 = np.concatenate([np.empty((0, 2), np.int64), *self._counts])
        frames = np.repeat(np.array(self._frames, np.int64), [len(part) for part in self._keys])
        keys = np.concatenate([np.empty(0, np.int64), *self._keys])
        return keys, frames, counts, np.concatenate([np.empty(0), *self._heights])

    def corners(self, keys: I64) -> F64:
        """(K, 2) metres, world frame: lower corners of packed cells."""
        x = (keys + _REACH // 2) // _REACH
        return np.stack([x, keys - x * _REACH], 1) * float(self.size)


@dataclass(frozen=True, slots=True, eq=False)
class SpatialGains:
    """Places where at least one of two runs is wrong.

    Attributes:
        low: (K, 3) float64, metres, world frame: lower corner in x and y, mean height of wrong
            points in z.
        size: edge, metres.
        wrong: (K, 2, 2) int64, wrong points by run and truth.
        gain: (K, 2) float64, percentage points of SA and DA.
        frame: (K,) int64, the frame that contributes most to the gain.
    """

    low: F64
    size: float
    wrong: I64
    gain: F64
    frame: I64

    def order(self) -> Intp:
        """(K,) places by absolute gain, largest first; unchanged places are left out."""
        return largest(self.gain)


def spatial_gains(first: SpatialCells, second: SpatialCells, total: I64) -> SpatialGains:
    """Gains by place; total (2,): all points of the run by truth."""
    sides = [first.rows(), second.rows()]
    keys, frames, counts, heights = (np.concatenate(parts) for parts in zip(*sides, strict=True))
    side = np.repeat([0, 1], [len(part[0]) for part in sides])
    unique, of = np.unique(keys, return_inverse=True)
    wrong = np.zeros((len(unique), 2, 2), np.int64)
    np.add.at(wrong, (of, side), counts)
    gain = gains(wrong[:, 0], wrong[:, 1], total)
    height = np.bincount(of, heights, len(unique)) / wrong.sum((1, 2))
    low = np.column_stack([first.corners(unique), height])
    return SpatialGains(
        low, first.size, wrong, gain, _worst_frames(of, frames, side, counts, gain, total)
    )


def _worst_frames(of: I64, frames: I64, side: I64, counts: I64, gain: F64, total: I64) -> I64:
    """The frame in which each place changes most in the direction of its total gain."""
    worst = np.zeros(len(gain), np.int64)
    if not len(of):
        return worst
    visits, visit = np.unique(of * (frames.max() + 1) + frames, return_inverse=True)
    signed = np.where(side == 0, 1, -1)[:, None] * counts
    change = np.zeros((len(visits), 2), np.int64)
    np.add.at(change, visit, signed)
    towards = gains(change, np.zeros_like(change), total).sum(1)
    place, frame = np.divmod(visits, frames.max() + 1)
    towards *= np.sign(gain.sum(1))[place]
    order = np.argsort(towards, kind="stable")
    worst[place[order]] = frame[order]  # the last write is the largest
    return worst


def largest(gain: F64) -> Intp:
    """Rows of (K, 2) gains by the absolute value of their sum, largest first.

    Zero rows are left out.
    """
    total = np.abs(gain.sum(1))
    order = np.argsort(-total, kind="stable")
    chosen: Intp = order[total[order] > 0]
    return chosen
