"""Causes of failure cases: a decision list over looks, distances to movers, and the method's rule.

Every criterion is in figures, and ``eval/README.md`` states them. The words are the same for all
methods, and a method needs to declare nothing.
"""

from __future__ import annotations

import math
from collections import Counter
from enum import StrEnum

import numpy as np

from dynaviz.arrays import F32, F64, I64, Intp
from dynaviz.contracts.looks import CountedLooks, Look
from dynaviz.contracts.method import Cause as Word
from dynaviz.scores.looks import CaseLooks

MOST = 0.5  # of the points or looks
ENOUGH = 0.25  # of the points on a surface, to speak of the angles of all
STOOD = 4  # times as many hits as passes: what was passed now and then still stood there
FEW = 1  # other scans that hit a place in the median: it was seen in one or two scans
HALVES = 16  # of the sampled points of a case
RARE = 8  # a cause that less than one in so many halves gives is not near
IN_CELL = 0.5  # metres: a mover in the cell of a point, or in the next
NEAR = 3.0  # metres: a mover in the bin or the cluster of a point


class MeasuredCause(StrEnum):
    """Why a case is wrong."""

    # of dynamic points that were kept
    STOOD = "stood there"
    HIDDEN = "hidden"
    BETWEEN = "between rays"
    OUTSIDE = "outside of the view"
    OUTWEIGHED = "seen through, but hits outweigh"
    FORGOTTEN = "seen through before it came"
    DEMAND = "seen through, but the method demands more"
    LIMIT = "seen through, but beyond a limit"
    GROUND = "seen through, but taken for ground"
    # of static points that were removed
    NO_RAY_CELL = "no ray through most of it: a mover in its cell"
    NO_RAY_MOVER = "no ray through most of it: a mover near"
    NO_RAY = "no ray through most of it: no mover near"
    BRIEF = "seen in one or two scans only"
    GRAZING = "grazing rays"
    POSES = "poses disagree"
    THIN = "thin or rough"
    OTHER_TIMES = "seen through at other times"
    # of both
    UNKNOWN = "cannot be told"


RULES = {
    Word.TAKEN_FOR_GROUND: MeasuredCause.GROUND,
    Word.HEIGHT_LIMIT: MeasuredCause.LIMIT,
    Word.OUT_OF_RANGE: MeasuredCause.LIMIT,
}
"""What a method's own word for the rule that kept a point says, if rays went through it."""


def looks_of(seen: CountedLooks, rows: Intp) -> CaseLooks:
    """The looks at the sampled points of a case, (K,) rows, K >= 1, of what was seen."""
    (looks,) = looks_of_parts(seen, rows[None])
    return looks


def looks_of_parts(seen: CountedLooks, parts: Intp) -> list[CaseLooks]:
    """The same for H parts of a case with equally many points, (H, K) rows, K >= 1."""
    counts = seen.counts[parts]
    total = counts.sum(1)
    every = np.maximum(total.sum(1), 1)
    share = [_rounded(100.0 * count / every) for count in total.T]
    through = seen.through[parts]
    passes = through.sum(1)
    known = seen.angle_known[parts]
    grazing = _of(total[:, Look.GRAZING], np.where(known, through, 0).sum(1))
    close = _of(seen.close[parts].sum(1), passes)
    before = _of(seen.before[parts].sum(1), passes)
    after = _of(seen.after[parts].sum(1), passes)
    seen_through = _rounded(100.0 * (through > 0).mean(1))
    surface = _rounded(100.0 * known.mean(1))
    hits = np.median(counts[:, :, Look.HIT], axis=1)
    throughs = np.median(through, axis=1)
    mover = _metres(seen.mover[parts])
    mover_ever = _metres(seen.mover_ever[parts])
    return [
        CaseLooks(
            points=parts.shape[1],
            hit=share[Look.HIT][part],
            through=round(share[Look.THROUGH][part] + share[Look.GRAZING][part], 1),
            hidden=share[Look.HIDDEN][part],
            between=share[Look.BETWEEN][part],
            outside=share[Look.OUTSIDE][part],
            seen_through=seen_through[part],
            hits=float(hits[part]),
            throughs=float(throughs[part]),
            grazing=grazing[part],
            close=close[part],
            before=before[part],
            after=after[part],
            surface=surface[part],
            mover=mover[part],
            mover_ever=mover_ever[part],
        )
        for part in range(len(parts))
    ]


def _rounded(shares: F64) -> list[float]:
    return [round(share, 1) for share in shares.tolist()]


def _of(some: I64, every: I64) -> list[float | None]:
    """Shares in percent; None of nothing."""
    return [
        round(100.0 * part / whole, 1) if whole else None
        for part, whole in zip(some.tolist(), every.tolist(), strict=True)
    ]


def _metres(distances: F32) -> list[float | None]:
    """The median of each row of (H, K) distances; None where it is infinite."""
    middle = np.median(distances, axis=1).tolist()
    return [round(each, 2) if math.isfinite(each) else None for each in middle]


def cause_of(kind: str, looks: CaseLooks | None, word: Word | None = None) -> MeasuredCause:
    """The cause of a case.

    Args:
        kind: ``false_negative`` or ``false_positive``.
        looks: at its points; None if nothing was measured.
        word: the method's own word for the rule that kept most of its points.
    """
    if looks is None:
        return MeasuredCause.UNKNOWN
    return _removed(looks) if kind == "false_positive" else _kept(looks, word)


def near_cause(
    kind: str, seen: CountedLooks, rows: Intp, cause: MeasuredCause, word: Word | None = None
) -> MeasuredCause | None:
    """The other cause that halves of the sampled points of a case give most often.

    None if less than one in ``RARE`` gives another, and of a single point. A half differs from the
    sample as much as the sample from all points.

    Args:
        kind, word: as for ``cause_of``.
        seen: the looks at sampled points; rows: (K,) those of the case.
        cause: that all of them give.
    """
    rng = np.random.default_rng(0)
    half = len(rows) // 2
    if not half:
        return None
    halves = np.stack([rng.permutation(rows)[:half] for _ in range(HALVES)])
    found = Counter(cause_of(kind, looks, word) for looks in looks_of_parts(seen, halves))
    del found[cause]
    if not found:
        return None
    other, times = found.most_common(1)[0]
    return other if times * RARE >= HALVES else None


def _kept(looks: CaseLooks, word: Word | None) -> MeasuredCause:
    """Why dynamic points were kept."""
    stood = looks.hit >= STOOD * looks.through
    stood &= looks.hit >= max(looks.hidden, looks.between)
    if looks.seen_through >= 100 * MOST and not (stood and looks.hit):
        if word in RULES:
            return RULES[word]
        if looks.hit >= looks.through:
            return MeasuredCause.OUTWEIGHED
        if looks.before is not None and looks.before >= 100 * MOST and looks.hits >= 1:
            return MeasuredCause.FORGOTTEN
        return MeasuredCause.DEMAND
    known = {
        MeasuredCause.STOOD: looks.hit,
        MeasuredCause.HIDDEN: looks.hidden,
        MeasuredCause.BETWEEN: looks.between,
    }
    most = max(known, key=lambda name: known[name])
    if known[most] == 0:
        return MeasuredCause.OUTSIDE if looks.outside else MeasuredCause.UNKNOWN
    return most


def _removed(looks: CaseLooks) -> MeasuredCause:
    """Why static points were removed."""
    if looks.hit + looks.through + looks.hidden == 0 and looks.mover is None:
        return MeasuredCause.UNKNOWN
    if looks.seen_through < 100 * MOST:
        if looks.mover is None or looks.mover > NEAR:
            return MeasuredCause.NO_RAY
        return MeasuredCause.NO_RAY_CELL if looks.mover <= IN_CELL else MeasuredCause.NO_RAY_MOVER
    if looks.hits <= FEW:
        return MeasuredCause.BRIEF
    grazing = looks.grazing is not None and looks.grazing > 100 * MOST
    if grazing and looks.surface >= 100 * ENOUGH:
        return MeasuredCause.GRAZING
    smooth = looks.surface >= 100 * MOST
    if smooth and looks.close is not None and looks.close >= 100 * MOST:
        return MeasuredCause.POSES
    apart = (looks.before or 0.0) + (looks.after or 0.0)
    return MeasuredCause.OTHER_TIMES if apart > 100 * MOST else MeasuredCause.THIN
