"""How well two rankings agree: one by the movers of a sequence, one by implants.

Used by ``benchmarks/implants.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

AVERAGES = ("points", "movers", "matched")
# points of a mover in a band of range; fewer do not count, except in the average over points
FEW = 20
DRAWS = 500


@dataclass(frozen=True, eq=False)
class Scores:
    """What each of E methods or parameter sets removed of each mover in each band of range.

    C cells.

    Attributes:
        sa: (E,) percent.
        movers: (C,) index of the mover of each cell, from 0.
        seeds: (C,) seed of the mover.
        kinds: (C,) ``vehicle``, ``cyclist`` or ``person``.
        bands: (C,) number of the band of range.
        points: (C,) points.
        removed: (E, C) points removed.
    """

    sa: np.ndarray
    movers: np.ndarray
    seeds: np.ndarray
    kinds: np.ndarray
    bands: np.ndarray
    points: np.ndarray
    removed: np.ndarray

    def __len__(self) -> int:
        """Number of movers."""
        return int(self.movers.max()) + 1

    def once(self) -> np.ndarray:
        """(movers,) ones: each mover once."""
        return np.ones(len(self))

    def drawn(self, rng: np.random.Generator) -> np.ndarray:
        """(movers,) how often each mover is drawn, with replacement."""
        return np.bincount(rng.integers(len(self), size=len(self)), minlength=len(self)).astype(
            float
        )

    def da(self, average: str, times: np.ndarray) -> np.ndarray:
        """(E,) percent of removed points, over all points, or the mean over the cells.

        Each mover some times.
        """
        weight = times[self.movers]
        if average == "movers":
            weight = weight * (self.points >= FEW) / self.points
        return 100 * (self.removed @ weight) / max(float(self.points @ weight), 1e-9)

    def matched(
        self, other: Scores, times: np.ndarray, other_times: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(E,) DA of these movers, and what other movers of the same kind and range predict for
        them, percent.

        Each cell counts once. If no other mover of the kind is in the band, all movers in the band
        predict; if there is none, the cell is left out of both.
        """
        share = other.removed / other.points
        weight = other_times[other.movers] * (other.points >= FEW)
        own = np.zeros(len(self.sa))
        predicted = np.zeros(len(self.sa))
        total = 0.0
        for cell in np.flatnonzero((self.points >= FEW) & (times[self.movers] > 0)):
            near = weight * (other.bands == self.bands[cell])
            same = near * (other.kinds == self.kinds[cell])
            chosen = same if same.any() else near
            if chosen.any():
                times_here = times[self.movers[cell]]
                own += times_here * self.removed[:, cell] / self.points[cell]
                predicted += times_here * (share @ chosen) / chosen.sum()
                total += times_here
        return 100 * own / max(total, 1e-9), 100 * predicted / max(total, 1e-9)


def compared(
    average: str, true: Scores, other: Scores, times: np.ndarray, other_times: np.ndarray
) -> Any:
    """(2, E) DA of the sequence's movers and of the implants, percent."""
    if average == "matched":
        return np.array(true.matched(other, times, other_times))
    return np.array([true.da(average, times), other.da(average, other_times)])


def agreement(average: str, true: Scores, other: Scores) -> dict[str, Any]:
    """Rank correlation of AA by the movers of a sequence with AA by implants, and how sure it is.

    Returns:
        ``SA``, ``DA``, ``AA``: Spearman's correlations; ``interval``: 90 % of those of AA if movers
        are drawn again on both sides; ``pairs``: pairs of methods whose true AA differs in 95 % of
        the draws, and ``tau``: Kendall's tau over these pairs, so 1 if implants order all of them
        correctly; ``wrong``: those that they do not; ``few``: the correlation that as few implants
        as there are true movers, of the same kinds, reach with the other implants, median and 90 %
        interval; ``seeds``: the correlation of the first seed with the others.
    """
    rng = np.random.default_rng(0)
    sa = np.array([true.sa, other.sa])
    da = compared(average, true, other, true.once(), other.once())
    aa = np.sqrt(sa * da)
    drawn = np.array(
        [
            np.sqrt(sa * compared(average, true, other, true.drawn(rng), other.drawn(rng)))
            for _ in range(DRAWS)
        ]
    )
    draws = [rank_correlation(*one) for one in drawn]
    surely = [pair for pair in combinations(range(len(true.sa)), 2) if _differs(drawn[:, 0], *pair)]
    signs = [np.sign(aa[:, a] - aa[:, b]).prod() for a, b in surely]
    facts: dict[str, Any] = {
        "SA": rank_correlation(*sa),
        "DA": rank_correlation(*da),
        "AA": rank_correlation(*aa),
        "interval": np.nanquantile(draws, [0.05, 0.95]).round(2).tolist(),
        "pairs": len(surely),
        "tau": round(float(np.mean(signs)), 2) if surely else None,
        "wrong": [pair for pair, sign in zip(surely, signs, strict=True) if sign < 0],
        "few": _few(average, true, other, rng),
    }
    first = other.seeds == other.seeds.min()
    if not first.all():
        halves = [np.bincount(other.movers, mask, len(other)) > 0 for mask in (first, ~first)]
        own = [np.sqrt(other.sa * other.da(_plain(average), half.astype(float))) for half in halves]
        facts["seeds"] = rank_correlation(*own)
    return facts


def _plain(average: str) -> str:
    return "points" if average == "points" else "movers"


def _differs(aa: np.ndarray, a: int, b: int) -> bool:
    """Whether two columns of (draws, E) differ, in the same direction, in 95 % of the draws."""
    low, high = np.quantile(aa[:, a] - aa[:, b], [0.025, 0.975])
    return bool(low > 0 or high < 0)


def _few(average: str, true: Scores, other: Scores, rng: np.random.Generator) -> list[float]:
    kinds = [other.kinds[other.movers == mover][0] for mover in range(len(other))]
    wanted = [true.kinds[true.movers == mover][0] for mover in range(len(true))]
    draws = []
    for _ in range(DRAWS):
        times = np.zeros(len(other))
        for kind in wanted:
            same = [mover for mover in range(len(other)) if kinds[mover] == kind] or range(
                len(other)
            )
            times[rng.choice(same)] += 1
        rest = (times == 0).astype(float)
        if rest.any():
            pair = [
                np.sqrt(other.sa * other.da(_plain(average), chosen)) for chosen in (times, rest)
            ]
            draws.append(rank_correlation(*pair))
    return np.nanquantile(draws, [0.5, 0.05, 0.95]).round(2).tolist() if draws else []


def rank_correlation(a: Sequence[float] | np.ndarray, b: Sequence[float] | np.ndarray) -> float:
    """Spearman's correlation; NaN if one side does not vary."""
    from scipy.stats import spearmanr

    if np.ptp(a) == 0 or np.ptp(b) == 0:
        return float("nan")
    return round(float(spearmanr(a, b).statistic), 2)
