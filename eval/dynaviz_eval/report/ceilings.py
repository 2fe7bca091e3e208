"""What a drive showed of its moving objects, and what each method made of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from dynaviz.scores.looks import Ceiling, Estimate
from dynaviz_eval.report.boards import ScoreBoard, ScoreRow, best_of_each_method
from dynaviz_eval.report.drawing import FAINT, INK
from dynaviz_eval.report.figures import BEST, ReportFigure, panels
from dynaviz_eval.report.table import NONE, Column, Table, Value, named

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PARTS = {
    "removed_seen": ("removed, evidence", "#2f7fd6", 1.0),
    "removed_unseen": ("removed, no evidence", "#2f7fd6", 0.45),
    "kept_seen": ("kept, evidence", "#f57c00", 1.0),
    "kept_unseen": ("kept, no evidence", "#9a9a9a", 0.6),
}
"""The parts of all dynamic points: name, colour and opacity of each."""


def ceiling_table(board: ScoreBoard, number: int) -> Table:
    """The DA that the drive allows, and the dynamic points of each method by evidence."""
    columns = [Column("method", number=False)]
    columns += [Column(name, "possible DA [%]") for name in ("by point", "by object")]
    columns += [Column(name, "dynamic points [%]") for name, _, _ in PARTS.values()]
    rows = []
    for row, ceiling in _known(board):
        shares = [getattr(ceiling, part) for part in PARTS]
        cells = (ceiling.possible, ceiling.possible_by_object, *shares)
        rows.append([named(row.label), *(_estimate(cell) for cell in cells)])
    notes = [
        "A dynamic point has evidence if at least one other scan of the drive saw through its "
        "place. Possible DA: the share of points with evidence, the same for every method; by "
        "object, evidence at one place of an object counts for all of it. The intervals are those "
        "of the sample, 95 %."
    ]
    title = f"What the drive showed: {board.title}"
    return Table(f"ceiling-{number}", title, columns, rows, notes)


def ceiling_figure(board: ScoreBoard, name: str) -> ReportFigure | None:
    """A stacked bar of all dynamic points for each method."""
    best = {id(row) for row in best_of_each_method(board)}
    drawn = [(row, ceiling) for row, ceiling in _known(board) if id(row) in best]
    if not drawn:
        return None

    def draw(number: int, axes: Axes) -> str:
        for at, (_, ceiling) in enumerate(drawn):
            left = 0.0
            for part, (label, colour, opacity) in PARTS.items():
                share = _percent(getattr(ceiling, part))
                axes.barh(
                    -at, share, 0.7, left, color=colour, alpha=opacity, label="" if at else label
                )
                left += share
        possible = _percent(drawn[0][1].possible)
        axes.axvline(possible, color=INK, linestyle=(0, (2, 1)), linewidth=1.3)
        axes.set(title="dynamic points", xlabel="share [%]; dashed: possible DA", xlim=(0, 100))
        axes.set_yticks([-at for at in range(len(drawn))], [row.label for row, _ in drawn])
        axes.tick_params(axis="y", length=0)
        axes.grid(False, axis="y")
        axes.grid(True, axis="x", color=FAINT)
        axes.figure.legend(loc="outside lower center", ncols=2, fontsize=8)
        return f"Dynamic points by answer and evidence on {board.title}"

    caption = (
        f"Dynamic points on {board.title} by answer and by evidence: whether another scan of the "
        "drive saw through their places. Orange could have been removed; for grey, the drive shows "
        "nothing." + BEST * (len(drawn) < len(board.rows))
    )
    return panels(name, caption, 1, 0.36 * len(drawn) + 1.8, draw)


def _known(board: ScoreBoard) -> Sequence[tuple[ScoreRow, Ceiling]]:
    found = [(row, row.result.sections.ceiling) for row in board.rows]
    return [(row, ceiling) for row, ceiling in found if ceiling is not None and ceiling.possible]


def _percent(estimate: Estimate | None) -> float:
    return 0.0 if estimate is None else estimate.percent


def _estimate(estimate: Estimate | None) -> Value:
    return Value(NONE) if estimate is None else Value(str(estimate), estimate.percent)
