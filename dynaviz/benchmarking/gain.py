"""Is a gain on implants more than chance? Depends on the movers, so they are drawn again with
replacement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F64, I64
from dynaviz.scores.movers import LEVEL, drawn, interval
from dynaviz.scores.result import Result

SA_LOSS = 1.0  # points of SA that a gain may cost


@dataclass(frozen=True)
class Gain:
    """What one parameter set gains over another on the same sequences, in percentage points.

    Attributes:
        aa: gain of AA over all points.
        low, high: ends of the 95 % interval of ``aa`` over drawn movers.
        movers: gain of AA if each mover counts once in DA.
        sa: change of SA.
    """

    aa: float
    low: float
    high: float
    movers: float
    sa: float

    @property
    def doubts(self) -> list[str]:
        """Why the gain may not apply to other movers, one clause each; empty if it is proven."""
        found = []
        if self.low <= 0:
            found.append(
                f"the {100 * LEVEL:.0f} % interval of the gain over drawn movers is not above zero"
            )
        if self.movers <= 0:
            found.append("AA does not rise if each mover counts once")
        if self.sa < -SA_LOSS:
            found.append(f"SA drops by more than {SA_LOSS:g} point")
        return found

    def __str__(self) -> str:
        return (
            f"AA {self.aa:+.2f} points on other implants, {100 * LEVEL:.0f} % interval "
            f"{self.low:+.2f} to {self.high:+.2f}; {self.movers:+.2f} if each mover counts once; "
            f"SA {self.sa:+.2f}"
        )


def gain(before: Sequence[Result], after: Sequence[Result]) -> Gain:
    """Compare two parameter sets.

    Args:
        before, after: results on the same sequences in the same order. Without a breakdown by
            object, a whole sequence counts as one mover.
    """
    static = np.array([_static(results) for results in (before, after)], np.float64)
    counts: I64 = np.concatenate(
        [_movers(one, other) for one, other in zip(before, after, strict=True)]
    )
    sa = static[:, 0] / np.maximum(static.sum(1), 1)
    low, high = interval(_gain(sa, drawn(counts)))
    shares = (counts[:, 1:] / np.maximum(counts[:, :1], 1)).mean(0)
    by_mover = 100 * float(np.sqrt(sa[1] * shares[1]) - np.sqrt(sa[0] * shares[0]))
    whole = float(_gain(sa, counts.sum(0)[None])[0])
    return Gain(whole, low, high, by_mover, 100 * float(sa[1] - sa[0]))


def _gain(sa: F64, counts: I64) -> F64:
    """(N,) gains of AA, in percentage points, of (N, 3) points of movers, and those removed before
    and after.
    """
    da = counts[:, 1:] / np.maximum(counts[:, :1], 1)
    gains: F64 = 100 * (np.sqrt(sa[1] * da[:, 1]) - np.sqrt(sa[0] * da[:, 0]))
    return gains


def _static(results: Sequence[Result]) -> tuple[int, int]:
    """Static points kept and removed."""
    counts = [result.counts for result in results]
    return sum(each["static_kept"] for each in counts), sum(
        each["static_removed"] for each in counts
    )


def _movers(before: Result, after: Result) -> I64:
    """(M, 3) int64: for each mover of a sequence its points, and how many of them are removed
    before and after.
    """
    rows = [
        {
            (row.class_, row.instance): (row.dynamic_removed, row.dynamic_kept)
            for row in result.breakdown.object
        }
        if result.breakdown
        else {}
        for result in (before.sections, after.sections)
    ]
    if not rows[0] or rows[0].keys() != rows[1].keys():
        removed, other = (result.counts["dynamic_removed"] for result in (before, after))
        return np.array([(removed + before.counts["dynamic_kept"], removed, other)], np.int64)
    return np.array(
        [(sum(counts), counts[0], rows[1][key][0]) for key, counts in rows[0].items()], np.int64
    )
