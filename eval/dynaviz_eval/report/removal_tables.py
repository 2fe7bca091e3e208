"""Runs without ground truth: how many points each method removed, why, and where."""

from __future__ import annotations

from collections.abc import Mapping

from dynaviz_eval.report.boards import ScoreBoard
from dynaviz_eval.report.errors import interval_name
from dynaviz_eval.report.table import NONE, Column, Table, Value, count, named, percent

REASONS = 3  # in a row


def removal_table(board: ScoreBoard, number: int) -> Table:
    """Removed points of each method: number, share, share by range, and main reasons; empty with ground truth."""
    found = [] if board.has_truth else [(row, row.result.sections.removals) for row in board.rows]
    known = [(row, removals) for row, removals in found if removals is not None]
    names = [interval_name(each) for each in known[0][1].range] if known else []
    columns = [Column("method", number=False), Column("points", "removed"), Column("share [%]", "removed")]
    columns += [Column(name, "removed by range [m], [%]") for name in names]
    columns += [Column("main reasons", number=False)]
    rows = []
    for row, removals in known:
        shares = {
            interval_name(each): 100 * each.removed / each.points if each.points else None for each in removals.range
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
    notes = ["There is no ground truth, so it is unknown which of these points were removed rightly."]
    return Table(f"removals-{number}", f"Removed points: {board.title}", columns, rows, notes)


def _reasons(reasons: Mapping[str, int], whole: int) -> str:
    if not whole:
        return "none removed"
    listed = [f"{name.replace('_', ' ')} {100 * n / whole:.0f} %" for name, n in list(reasons.items())[:REASONS]]
    return ", ".join(listed) or NONE
