"""How much a score depends on which objects happened to move: movers are drawn with replacement.

A drive has few movers, and a large one counts more than ten small ones. The interval shows what AA
would be if other movers of the same kinds had passed; static points stay as they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from dynaviz.arrays import F64, I64
from dynaviz.scores.result import Result

LEVEL = 0.95
DRAWS = 2000
FEWEST = 3  # movers, below which an interval over drawn movers says nothing

Movers = dict[tuple[int | None, int | None], tuple[int, int]]
"""Dynamic points removed, and all dynamic points, by class and number of the object."""


def drawn(movers: I64) -> I64:
    """(DRAWS, K) int64: sums over (M, K) counts of movers, which are drawn with replacement."""
    rows = np.random.default_rng(0).integers(len(movers), size=(DRAWS, len(movers)))
    totals: I64 = movers[rows].sum(1)
    return totals


def interval(values: F64) -> tuple[float, float]:
    """The ends of the interval that contains ``LEVEL`` of the values."""
    low, high = np.quantile(values, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return float(low), float(high)


def aa_interval(results: Sequence[Result]) -> tuple[float, float] | None:
    """The interval of AA over drawn movers, percent.

    Args:
        results: of one method; counts of several sequences are added up.

    Returns:
        Its ends; None for fewer than ``FEWEST`` movers, without static points, or if dynamic points
        have no objects.
    """
    known = [movers_of(result) for result in results]
    counts = np.array([pair for movers in known for pair in movers.values()], np.int64)
    static = _static(results)
    if len(counts) < FEWEST or static is None or not all(known):
        return None
    sums = drawn(counts)
    return interval(100 * np.sqrt(static * sums[:, 0] / sums[:, 1]))


def change_intervals(first: Result, second: Result) -> Mapping[str, tuple[float, float]]:
    """Intervals over drawn movers of the change of DA and AA from one run to another, in percentage
    points; the same movers are drawn for both. Empty where ``aa_interval`` is None.
    """
    before = movers_of(first)
    after = movers_of(second)
    shares = [_static([result]) for result in (first, second)]
    if len(before) < FEWEST or before.keys() != after.keys() or None in shares:
        return {}
    rows = np.array([(*before[key], after[key][0]) for key in before], np.int64)
    sums = drawn(rows)
    was = sums[:, 0] / sums[:, 1]
    now = sums[:, 2] / sums[:, 1]
    static = np.array(shares, np.float64)
    return {
        "DA": interval(100 * (now - was)),
        "AA": interval(100 * (np.sqrt(static[1] * now) - np.sqrt(static[0] * was))),
    }


def movers_of(result: Result) -> Movers:
    """The movers of a run; empty if some of its dynamic points have no number of an object."""
    breakdown = result.sections.breakdown
    movers = {
        (row.class_, row.instance): (row.dynamic_removed, points)
        for row in (breakdown.object if breakdown else ())
        if (points := row.dynamic_removed + row.dynamic_kept)
    }
    return movers if all(number for _, number in movers) else {}


def _static(results: Sequence[Result]) -> float | None:
    """The share of static points that are kept; None without static points."""
    kept = sum(result.counts.get("static_kept", 0) for result in results)
    removed = sum(result.counts.get("static_removed", 0) for result in results)
    return kept / (kept + removed) if kept + removed else None
