"""What differs between two runs on the same points, in numbers: scores, who is right, and where and when it changes.

Everything follows from counts of points. A change is told as a *gain*: how much less the second run loses than the
first, in percentage points of SA and of DA. Gains add up: those of all frames, or of all places, are the difference of
the runs' scores. So a hundred static points weigh little beside a hundred dynamic ones, as they do in the scores.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynaviz.arrays import F32, F64, I64, U8, Bool, Intp
from dynaviz.comparison.answers import BAND_NAMES, Answers
from dynaviz.scan import Label, Outcome

TRUTHS = ("static", "dynamic")
AGREEMENT = ("neither", "only_first", "only_second", "both")  # bit 0: the first run is right; bit 1: the second is
NEITHER, FIRST, SECOND, BOTH = range(4)
SCORES = ("SA", "DA", "AA", "HA")  # percent
WRONG = ("FP", "FN")  # points: static ones removed, dynamic ones kept
MOST = 10  # frames and places that are named
PLACE = 5.0  # metres: edge of the cells of the ground that are called places
LEVEL = 0.95
RESAMPLES = 4000
SEED = 0
_REASONS = 256
_REACH = 1 << 31  # cells along y


def agreement(truth: U8, first: Bool, second: Bool) -> U8:
    """(N,) uint8, an index into ``AGREEMENT`` per point; truth (N,) uint8, answers (N,) bool, True = dynamic."""
    moves = truth == Label.DYNAMIC
    right: U8 = (first == moves) + np.uint8(2) * (second == moves)
    return right


@dataclass(frozen=True, slots=True, eq=False)
class AgreementCounts:
    """The labelled points of two runs, crossed.

    Attributes:
        index: (F,) int64, numbers of the frames in their data set.
        frames: (F, 2, 4) int64, points by frame, truth (``TRUTHS``) and who is right (``AGREEMENT``).
        bands: (2, 4, 5) int64, points by truth, who is right and range band.
        reasons: (2, 4, 256, 256) int64, points that not both have right, by the first's and the second's reason code.
    """

    index: I64
    frames: I64
    bands: I64
    reasons: I64

    @property
    def points(self) -> I64:
        """(2, 4) int64: points by truth and who is right."""
        points: I64 = self.frames.sum(0)
        return points


def count_agreement(first: Iterable[Answers], second: Iterable[Answers]) -> AgreementCounts:
    """Cross two runs, frame by frame.

    Raises:
        ValueError: where the answers are not of the same points.
    """
    index, frames = [], []
    bands = np.zeros((len(TRUTHS), len(AGREEMENT), len(BAND_NAMES)), np.int64)
    reasons = np.zeros((len(TRUTHS), len(AGREEMENT), _REASONS, _REASONS), np.int64)
    for a, b in zip(first, second, strict=True):
        if not np.array_equal(a.truth, b.truth):
            raise ValueError(f"in frame {a.frame} the ground truth differs")
        labelled = a.truth != Label.UNLABELLED
        kind = a.truth * np.uint8(len(AGREEMENT)) + agreement(a.truth, a.dynamic, b.dynamic)
        kind, band = kind[labelled].astype(np.intp), a.bands[labelled]
        frames.append(np.bincount(kind, minlength=8).reshape(2, 4))
        bands += np.bincount(kind * len(BAND_NAMES) + band, minlength=bands.size).reshape(bands.shape)
        wrong = kind % len(AGREEMENT) != BOTH
        codes = (kind[wrong] * _REASONS + a.reasons[labelled][wrong]) * _REASONS + b.reasons[labelled][wrong]
        reasons += np.bincount(codes, minlength=reasons.size).reshape(reasons.shape)
        index.append(a.index)
    counts = np.array(frames, np.int64).reshape(-1, len(TRUTHS), len(AGREEMENT))
    return AgreementCounts(np.array(index, np.int64), counts, bands, reasons)


def scores(counts: I64 | F64) -> tuple[dict[str, F64], dict[str, F64]]:
    """SA, DA, AA, HA in percent, and FP and FN in points, of the first and of the second run.

    Args:
        counts: (..., 2, 4), points by truth and who is right.

    Returns:
        Two dictionaries of (...) float64; NaN where undefined.
    """
    total = counts.sum(-1)
    found = []
    for side in (FIRST, SECOND):
        right = counts[..., side] + counts[..., BOTH]
        with np.errstate(invalid="ignore", divide="ignore"):
            accuracy = 100.0 * right / total
            sa, da = accuracy[..., 0], accuracy[..., 1]
            ha = np.where(sa + da == 0, 0.0, 2 * sa * da / (sa + da))
        wrong = (total - right).astype(np.float64)
        values = (sa, da, np.sqrt(sa * da), ha, wrong[..., 0], wrong[..., 1])
        found.append(dict(zip((*SCORES, *WRONG), values, strict=True)))
    return found[0], found[1]


def block_length(frames: int) -> int:
    """Frames in a block of the resampling: the square root of their number."""
    return max(1, round(math.sqrt(frames)))


def intervals(frames: I64, resamples: int = RESAMPLES, level: float = LEVEL) -> dict[str, tuple[float, float] | None]:
    """Confidence intervals of the differences of all scores, by a paired bootstrap over blocks of frames.

    A resample draws blocks of successive frames with replacement, the same ones for both runs, and takes the scores of
    the summed counts. Blocks, since a frame shows nearly the same points and objects as the one before: drawn one by
    one, as ``scipy.stats.bootstrap`` does, correlated frames would pass for independent ones, and the interval
    would be several times too narrow. They are circular (the last frame is followed by the first), so that each frame
    is drawn equally often, and as long as the square root of the number of frames. The percentile interval holds for
    this drive: how much the difference depends on its stretches. Of other drives it says nothing.

    Args:
        frames: (F, 2, 4), points by frame, truth and who is right.
        resamples: how many.
        level: of confidence.

    Returns:
        (low, high) of second minus first by score; None below two frames, or where no resample defines it.
    """
    n = len(frames)
    names = (*SCORES, *WRONG)
    if n < 2:
        return dict.fromkeys(names)
    length = block_length(n)
    around = np.concatenate([frames, frames[: length - 1]]).astype(np.float64)
    sums = np.concatenate([np.zeros((1, *frames.shape[1:])), around.cumsum(0)])
    blocks = sums[length:] - sums[:-length]
    starts = np.random.default_rng(SEED).integers(0, n, (resamples, -(-n // length)))
    drawn = blocks[starts].sum(1) * (n / (starts.shape[1] * length))
    first, second = scores(drawn)
    found: dict[str, tuple[float, float] | None] = {}
    for name in names:
        differences = second[name] - first[name]
        differences = differences[np.isfinite(differences)]
        tail = (1 - level) / 2
        low_high = np.quantile(differences, [tail, 1 - tail]).tolist() if len(differences) else None
        found[name] = None if low_high is None else (low_high[0], low_high[1])
    return found


def gains(wrong_first: I64, wrong_second: I64, total: I64) -> F64:
    """How much less the second loses than the first.

    Args:
        wrong_first, wrong_second: (..., 2), wrong points by truth.
        total: (2,), all points of the run by truth.

    Returns:
        (..., 2) float64, percentage points of SA and of DA; 0 where the score is undefined.
    """
    gain: F64 = 100.0 * (wrong_first - wrong_second) / np.maximum(total, 1)
    return gain


def frame_gains(crossed: AgreementCounts) -> F64:
    """(F, 2) float64: the gain of each frame, percentage points of the run's SA and DA; adding up to the difference."""
    return gains(crossed.frames[..., SECOND], crossed.frames[..., FIRST], crossed.points.sum(1))


class SpatialCells:
    """Where a run is wrong: its wrong points by square columns of the world, from the points that were drawn.

    Columns begin at whole metres, as the voxels do in which a recording thins false positives; so one of whole metres
    holds all points that a drawn one stands for, but for some within rounding of its border.

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
        """Add drawn points: xyz (M, 3) metres, world frame; outcome (M,), stands_for (M,). Finite ones have a place."""
        wrong = np.isin(outcome, (Outcome.FALSE_POSITIVE, Outcome.FALSE_NEGATIVE)) & np.isfinite(xyz).all(1)
        xyz, weight = xyz[wrong].astype(np.float64), stands_for[wrong]
        cell = np.floor(xyz[:, :2] / self.size).astype(np.int64)
        keys, of = np.unique(cell[:, 0] * _REACH + cell[:, 1], return_inverse=True)
        missed = (outcome[wrong] == Outcome.FALSE_NEGATIVE).astype(np.intp)
        self._keys.append(keys)
        self._counts.append(np.bincount(of * 2 + missed, weight, 2 * len(keys)).reshape(-1, 2).astype(np.int64))
        self._heights.append(np.bincount(of, weight * xyz[:, 2], len(keys)).astype(np.float64))
        self._frames.append(frame)

    def rows(self) -> tuple[I64, I64, I64, F64]:
        """A cell in a frame each: packed cells (K,), frames (K,), wrong points by truth (K, 2), their summed z (K,)."""
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
    """Places where one of two runs is wrong.

    Attributes:
        low: (K, 3) float64, metres, world frame: lower corner in x and y, mean height of wrong points in z.
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
        """(K,) largest change first; those without any left out."""
        return _largest(self.gain)


def spatial_gains(first: SpatialCells, second: SpatialCells, total: I64) -> SpatialGains:
    """Cross the places of two runs; total (2,): all points of the run by truth."""
    sides = [first.rows(), second.rows()]
    keys, frames, counts, heights = (np.concatenate(parts) for parts in zip(*sides, strict=True))
    side = np.repeat([0, 1], [len(part[0]) for part in sides])
    unique, of = np.unique(keys, return_inverse=True)
    wrong = np.zeros((len(unique), 2, 2), np.int64)
    np.add.at(wrong, (of, side), counts)
    gain = gains(wrong[:, 0], wrong[:, 1], total)
    height = np.bincount(of, heights, len(unique)) / wrong.sum((1, 2))
    low = np.column_stack([first.corners(unique), height])
    return SpatialGains(low, first.size, wrong, gain, _worst_frames(of, frames, side, counts, gain, total))


def _worst_frames(of: I64, frames: I64, side: I64, counts: I64, gain: F64, total: I64) -> I64:
    """The frame in which each place changes most towards its winner."""
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
    worst[place[order]] = frame[order]  # the last one written is the largest
    return worst


def _largest(gain: F64) -> Intp:
    """Rows by the size of their summed gain, the largest first; those that change nothing left out."""
    total = np.abs(gain.sum(1))
    order = np.argsort(-total, kind="stable")
    chosen: Intp = order[total[order] > 0]
    return chosen


def run_scores(points: I64) -> tuple[dict[str, float | None], dict[str, float | None]]:
    """Scores of the first and of the second run as plain JSON values; points (2, 4) by truth and who is right."""
    first, second = scores(points)
    return {n: _plain(v) for n, v in first.items()}, {n: _plain(v) for n, v in second.items()}


def compare_pair(
    crossed: AgreementCounts, places: SpatialGains | None, reasons: tuple[Mapping[int, str], Mapping[int, str]]
) -> dict[str, Any]:
    """All that differs, as plain JSON values; percentages are None where undefined.

    Args:
        crossed: the runs' points.
        places: where each is wrong, or None where a recording holds no coordinates.
        reasons: names of the reason codes of the first and of the second.
    """
    a, b = scores(crossed.points)
    within = intervals(crossed.frames)
    return {
        "scores": {
            name: {
                "first": _plain(a[name]),
                "second": _plain(b[name]),
                "delta": _plain(b[name] - a[name]),
                "interval": within[name],
            }
            for name in (*SCORES, *WRONG)
        },
        "right": _by_truth(crossed.points),
        "by_range": [{"band": name, **_by_truth(crossed.bands[..., i])} for i, name in enumerate(BAND_NAMES)],
        "by_reason": _by_reason(crossed.reasons, reasons),
        "frames": _frames(crossed),
        "places": None if places is None else _places(places),
    }


def _by_truth(points: I64) -> dict[str, dict[str, int]]:
    return {truth: dict(zip(AGREEMENT, row.tolist(), strict=True)) for truth, row in zip(TRUTHS, points, strict=True)}


def _by_reason(counts: I64, names: tuple[Mapping[int, str], Mapping[int, str]]) -> list[dict[str, Any]]:
    """Points by the reason of whoever is wrong; None for whoever is right. The largest number first."""
    rows: list[dict[str, Any]] = []
    for truth, kind in np.ndindex(len(TRUTHS), BOTH):
        crossed = counts[truth, kind]
        # Whoever is right needs no excuse: its reasons are summed.
        summed = crossed.sum(0, keepdims=True) if kind == FIRST else crossed
        summed = crossed.sum(1, keepdims=True) if kind == SECOND else summed
        for i, j in np.argwhere(summed).tolist():
            first = None if kind == FIRST else names[0].get(i, str(i))
            second = None if kind == SECOND else names[1].get(j, str(j))
            place = {"truth": TRUTHS[truth], "right": AGREEMENT[kind], "first_reason": first, "second_reason": second}
            rows.append({**place, "points": int(summed[i, j])})
    return sorted(rows, key=lambda row: -row["points"])


def _frames(crossed: AgreementCounts) -> list[dict[str, Any]]:
    gain = frame_gains(crossed)
    order = _largest(gain)[:MOST]
    a, b = scores(crossed.frames)
    return [
        {
            "frame": int(f),
            "index": int(crossed.index[f]),
            **_gain(gain[f]),
            **{side: {name: int(s[name][f]) for name in WRONG} for side, s in (("first", a), ("second", b))},
        }
        for f in order
    ]


def _places(places: SpatialGains) -> list[dict[str, Any]]:
    return [
        {
            "low": places.low[k, :2].tolist(),
            "high": (places.low[k, :2] + places.size).tolist(),
            "height": float(places.low[k, 2]),
            "frame": int(places.frame[k]),
            **_gain(places.gain[k]),
            **{
                side: dict(zip(WRONG, wrong.tolist(), strict=True))
                for side, wrong in zip(("first", "second"), places.wrong[k], strict=True)
            },
        }
        for k in places.order()[:MOST]
    ]


def _gain(gain: F64) -> dict[str, Any]:
    return {"gain": float(gain.sum()), "gain_SA": float(gain[0]), "gain_DA": float(gain[1])}


def _plain(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
