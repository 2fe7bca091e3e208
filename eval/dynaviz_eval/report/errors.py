"""Tables of errors: accuracy lost by cause, accuracy by range and height.

Without ground truth, removed points.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence

from dynaviz.scores.sections import IntervalRow, RemovedInterval
from dynaviz_eval.report.boards import (
    ERRORS,
    KINDS,
    Losses,
    ScoreBoard,
    ScoreRow,
    best_of_each_method,
    by_method,
    losses,
)
from dynaviz_eval.report.table import ABSENT, NONE, Column, Table, Value, count, named, percent

TINY = 0.005  # percentage points; less is printed as 0.00


def cause_table(single: Sequence[ScoreBoard], order: Sequence[str]) -> Table:
    """Method by cause: percentage points lost, static points removed and dynamic points kept apart.

    Args:
        single: boards of single sequences.
        order: labels, best first.
    """
    groups = by_method([board for board in single if board.has_truth])
    several = len({scoring for _, scoring in groups}) > 1
    keys = sorted(groups, key=lambda key: order.index(key[0]))
    found = {(key, kind): losses(groups[key], kind) for key in keys for kind in KINDS}
    causes = {kind: _causes([found[key, kind] for key in keys]) for kind in KINDS}
    columns = [Column("method", number=False)]
    for kind, (score, _, _) in KINDS.items():
        columns += [
            Column(name, f"{ERRORS[kind]}, {score} lost [%]") for name in ("all", *causes[kind])
        ]
    rows = []
    for key in keys:
        row = [named(", ".join(key) if several else key[0])]
        for kind in KINDS:
            most = max((cost for k in keys for cost in found[k, kind].causes.values()), default=0.0)
            row += _cells(found[key, kind], causes[kind], most)
        rows.append(row)
    return Table("failures", "Errors by cause", columns, rows, _cause_notes(groups))


def _causes(every: Sequence[Losses]) -> list[str]:
    """All causes, costliest first."""
    totals: Counter[str] = Counter()
    for loss in every:
        totals.update(loss.causes)
    return sorted(totals, key=lambda cause: (-totals[cause], cause))


def _cells(loss: Losses, causes: Sequence[str], most: float) -> list[Value]:
    """The fields of one method and kind of error."""
    if loss.cost is None:
        return [Value(NONE)] * (1 + len(causes))
    if loss.cost and not loss.causes:
        return [percent(loss.cost), *[Value(ABSENT)] * len(causes)]
    return [percent(loss.cost), *(_cell(loss.causes.get(cause, 0.0), most) for cause in causes)]


def _cell(cost: float, most: float) -> Value:
    """A cost; its square root sets the colour, so that small costs remain visible."""
    if cost < TINY:
        return Value("<0.01" if cost else "0", cost)
    return Value(f"{cost:.2f}", cost, heat=round(math.sqrt(cost / most), 2))


def _cause_notes(groups: Mapping[tuple[str, str], Sequence[ScoreRow]]) -> list[str]:
    notes = [
        "Percentage points, over the sequences that a method ran on, with points added up. "
        "eval/README.md explains the "
        "causes."
    ]
    most = max((len(mine) for mine in groups.values()), default=0)
    fewer = [f"{label} on {len(mine)}" for (label, _), mine in groups.items() if len(mine) < most]
    if fewer:
        notes.append(f"Not on all {most} sequences, so not comparable: {', '.join(fewer)}.")
    return notes


def intervals(row: ScoreRow, of: str) -> tuple[IntervalRow, ...]:
    """A run's scores by ``range`` or ``height``."""
    breakdown = row.result.sections.breakdown
    found: tuple[IntervalRow, ...] = getattr(breakdown, of) if breakdown else ()
    return found


def interval_name(interval: IntervalRow | RemovedInterval) -> str:
    """An interval in metres, such as ``10-20``."""
    low = interval.low
    high = interval.high
    if low is None:
        return "all" if high is None else f"< {high:g}"
    return f"≥ {low:g}" if high is None else f"{low:g}–{high:g}"


TITLES = {"range": "range from the sensor", "height": "height above the ground"}


def interval_table(board: ScoreBoard, of: str, number: int) -> Table:
    """SA and DA of each method by ``range`` or ``height``."""
    drawn = (
        [row for row in best_of_each_method(board) if intervals(row, of)] if board.has_truth else []
    )
    names = [interval_name(each) for each in intervals(drawn[0], of)] if drawn else []
    columns = [Column("method", number=False)]
    columns += [
        Column(name, f"{score} [%] by {of} [m]") for score in ("SA", "DA") for name in names
    ]
    rows = []
    for row in drawn:
        if [interval_name(each) for each in intervals(row, of)] == names:
            scores = [
                percent(getattr(each, score))
                for score in ("SA", "DA")
                for each in intervals(row, of)
            ]
            rows.append([named(row.label), *scores])
    return Table(f"{of}-{number}", f"Accuracy by {TITLES[of]}: {board.title}", columns, rows)


REASONS = 3  # in a row


def removal_table(board: ScoreBoard, number: int) -> Table:
    """Removed points of each method: number, share, share by range, and main reasons.

    Empty with ground truth.
    """
    found = [] if board.has_truth else [(row, row.result.sections.removals) for row in board.rows]
    known = [(row, removals) for row, removals in found if removals is not None]
    names = [interval_name(each) for each in known[0][1].range] if known else []
    columns = [
        Column("method", number=False),
        Column("points", "removed"),
        Column("share [%]", "removed"),
    ]
    columns += [Column(name, "removed by range [m], [%]") for name in names]
    columns += [Column("main reasons", number=False)]
    rows = []
    for row, removals in known:
        shares = {
            interval_name(each): 100 * each.removed / each.points if each.points else None
            for each in removals.range
        }
        rows.append(
            [
                named(row.label),
                count(removals.removed),
                percent(removals.percent),
                *(percent(shares.get(name)) for name in names),
                Value(_reasons(removals.reasons, removals.removed)),
            ]
        )
    notes = [
        "There is no ground truth, so it is unknown which of these points were removed rightly."
    ]
    return Table(f"removals-{number}", f"Removed points: {board.title}", columns, rows, notes)


def _reasons(reasons: Mapping[str, int], whole: int) -> str:
    if not whole:
        return "none removed"
    listed = [
        f"{name.replace('_', ' ')} {100 * n / whole:.0f} %"
        for name, n in list(reasons.items())[:REASONS]
    ]
    return ", ".join(listed) or NONE
