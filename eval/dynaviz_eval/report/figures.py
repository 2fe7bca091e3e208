"""The figures of a report, as SVG. Each function returns None if there is nothing to draw."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from dynaviz.results.sections import ErrorDistances, IntervalRow
from dynaviz_eval.error_distance import BIN, LIMIT
from dynaviz_eval.report.boards import KINDS, ScoreBoard, ScoreRow, by_method, losses
from dynaviz_eval.report.drawing import FAINT, INK, Palette, panels, style, svg

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BEST = " Of several variants of a method, only the best is shown."
LEGEND_ENTRY = 1.5  # inches: width of an entry of a legend
FEW = 100  # points; an accuracy of fewer points is drawn hollow


@dataclass(frozen=True)
class ReportFigure:
    """A figure of a page: the SVG element and its caption."""

    name: str
    svg: str
    caption: str


def scores(boards: Sequence[ScoreBoard], palette: Palette) -> ReportFigure | None:
    """SA against DA, with lines of equal AA."""
    drawn = [board for board in boards if any(row.score("AA") is not None for row in board.rows)]
    if not drawn:
        return None
    with style():
        figure, grid = panels(len(drawn), 3.4)
        for axes, board in zip(grid, drawn, strict=True):
            points = [
                (row, row.score("SA") or 0.0, row.score("DA") or 0.0)
                for row in board.rows
                if row.score("AA") is not None
            ]
            low = [max(0.0, value - 4) for value in (min(p[1] for p in points), min(p[2] for p in points))]
            _iso(axes, low)
            for row, sa, da in points:
                axes.plot(sa, da, linestyle="", **palette.point(row.result.method))
            for row, sa, da in points:
                if row.label in board.best("AA"):
                    _name(axes, row.label, sa, da, low)
            axes.set(title=board.title, xlabel="SA [%]: static kept", xlim=(low[0], 101), ylim=(low[1], 101))
        _legend(figure, [row for board in drawn for row in board.rows], palette, lines=False)
        grid[0].set_ylabel("DA [%]: dynamic removed")
        caption = (
            "Static against dynamic accuracy; the best corner is top right. Thin lines: equal AA. The best method of "
            "each sequence is named."
        )
        return ReportFigure("scores", svg(figure, "scores", caption), caption)


def speed(boards: Sequence[ScoreBoard], palette: Palette) -> ReportFigure | None:
    """Runtime against AA."""
    drawn = [board for board in boards if _timed(board)]
    if not drawn:
        return None
    with style():
        figure, grid = panels(len(drawn), 3.2)
        for axes, board in zip(grid, drawn, strict=True):
            for row in _timed(board):
                look = palette.point(row.result.method)
                hollow: dict[str, Any] = {"markerfacecolor": "none"} if row.result.instrumented else {}
                axes.plot(_seconds(row), row.score("AA") or 0.0, linestyle="", **look, **hollow)
            axes.set(title=board.title, xlabel="seconds per frame (log)")
            _log(axes)
        _legend(figure, [row for board in drawn for row in board.rows], palette, lines=False)
        grid[0].set_ylabel("AA [%]")
        hollow_note = (
            " Hollow: measured while states were recorded, so slower than the method alone."
            if any(row.result.instrumented for b in drawn for row in b.rows)
            else ""
        )
        caption = "Runtime against AA; the best corner is top left." + hollow_note
        return ReportFigure("speed", svg(figure, "speed", caption), caption)


def ranges(board: ScoreBoard, name: str, palette: Palette) -> ReportFigure | None:
    """SA and DA by range from the sensor."""
    drawn = [row for row in best_of_each_method(board) if ranges_of(row)]
    if not drawn:
        return None
    with style():
        figure, grid = panels(2, 2.9, across=2)
        bins = ranges_of(drawn[0])
        ticks = [f"{b.low or 0:.0f}–{b.high:.0f}" if b.high is not None else f"{b.low:.0f}+" for b in bins]
        for axes, (kind, (score, right, wrong)) in zip(grid, KINDS.items(), strict=True):
            for row in drawn:
                here = ranges_of(row)
                values = [np.nan if getattr(b, score) is None else getattr(b, score) for b in here]
                few = [getattr(b, right) + getattr(b, wrong) < FEW for b in here]
                look = palette.line(row.result.method)
                axes.plot(range(len(here)), values, **{**look, "marker": ""})
                for at, (value, hollow) in enumerate(zip(values, few, strict=True)):
                    face: dict[str, Any] = {"markerfacecolor": "none"} if hollow else {}
                    axes.plot(
                        at, value, linestyle="", **{k: look[k] for k in ("color", "marker", "markersize")}, **face
                    )
            said = "static kept" if kind == "false_positive" else "dynamic removed"
            axes.set(title=f"{score}: {said}", ylabel=f"{score} [%]", xlabel="range from the sensor [m]")
            axes.set_xticks(range(len(ticks)), ticks)
        _legend(figure, drawn, palette)
        caption = f"Accuracy against range on {board.title}. Hollow markers: fewer than {FEW} points."
        caption += BEST * (len(drawn) < len(board.rows))
        return ReportFigure(name, svg(figure, name, caption), caption)


def distances(board: ScoreBoard, name: str, palette: Palette) -> ReportFigure | None:
    """Distances from wrong points to correct ones, a histogram per method (paper, Fig. 5)."""
    drawn = [row for row in best_of_each_method(board) if row.result.sections.error_distance]
    if not drawn:
        return None
    titles = {
        "false_negative": "dynamic points kept:\ndistance to the nearest one removed",
        "false_positive": "static points removed:\ndistance to the nearest one kept",
    }
    with style():
        figure, grid = panels(2, 0.42 * len(drawn) + 1.1, across=2)
        for axes, (kind, title) in zip(grid, titles.items(), strict=True):
            for at, row in enumerate(drawn):
                _ridge(axes, -at, row, kind, palette)
            axes.set(
                title=title,
                xlabel="distance [m]; last bar: larger",
                xlim=(0, LIMIT + 0.35),
                ylim=(-len(drawn) + 0.9, 1.05),
            )
            axes.set_yticks([-at + 0.3 for at in range(len(drawn))], [row.label for row in drawn])
            axes.tick_params(axis="y", length=0)
            axes.grid(False, axis="y")
            axes.spines["left"].set_visible(False)
        grid[1].set_yticklabels([])
        caption = (
            f"Distances from wrong points to correct ones on {board.title}. Bars: share of a method's wrong points per "
            "5 cm, each row scaled to its own maximum. Dashed line: 10 % of the points are nearer. "
            "Right: number of wrong points."
        )
        caption += BEST * (len(drawn) < len(board.rows))
        return ReportFigure(name, svg(figure, name, caption), caption)


def ranges_of(row: ScoreRow) -> tuple[IntervalRow, ...]:
    """A run's scores by range."""
    return row.result.sections.breakdown.range if row.result.sections.breakdown else ()


def _ridge(axes: Axes, base: float, row: ScoreRow, kind: str, palette: Palette) -> None:
    section = row.result.sections.error_distance.get(kind, ErrorDistances())
    histogram, number = (
        section.histogram,
        row.result.counts.get("dynamic_kept" if kind == "false_negative" else "static_removed", 0),
    )
    axes.axhline(base, color=FAINT, linewidth=0.8)
    if not histogram or not sum(histogram):
        axes.text(0.02, base + 0.2, "no correct points" if number else "no errors", fontsize=7.5, color=INK)
    else:
        shares = np.array(histogram, float) / max(histogram)
        edges = np.arange(len(histogram)) * BIN
        colour = palette.point(row.result.method)["color"]
        for heights, ends in ((shares[:-1], edges), (shares[-1:], LIMIT + 0.06 + np.array([0, BIN]))):
            axes.stairs(base + 0.8 * heights, ends, baseline=base, fill=True, color=colour, linewidth=0)
        if section.p10 is not None:
            axes.plot([section.p10] * 2, [base, base + 0.9], color=INK, linestyle=(0, (2, 1)), linewidth=1.3)
    axes.text(LIMIT + 0.33, base + 0.45, f"{number:,}", fontsize=7.5, ha="right", va="bottom", color=INK)


def causes(boards: Sequence[ScoreBoard], order: Sequence[str]) -> ReportFigure | None:
    """The cost of each cause for each method, as bars."""
    groups = by_method(boards)
    several = len({scoring for _, scoring in groups}) > 1
    first: dict[tuple[str, str], tuple[str, str]] = {}
    for key in sorted(groups, key=lambda key: order.index(key[0])):
        first.setdefault((groups[key][0].result.method, key[1]), key)
    keys = list(first.values())
    found = {(key, kind): losses(groups[key], kind) for key in keys for kind in KINDS}
    totals: dict[str, float] = {}
    for loss in found.values():
        for cause, cost in loss.causes.items():
            totals[cause] = totals.get(cause, 0.0) + cost
    if not totals:
        return None
    shown = sorted(totals, key=lambda cause: (-totals[cause], cause))[: len(_FILLS) - 1]
    rest = ["other"] if len(totals) > len(shown) else []
    with style():
        import matplotlib as mpl

        mpl.rcParams["hatch.linewidth"] = 0.7
        figure, grid = panels(2, 0.3 * len(keys) + 1.2, across=2)
        for axes, kind in zip(grid, KINDS, strict=True):
            left = np.zeros(len(keys))
            for cause, (colour, hatch) in zip([*shown, *rest], _FILLS, strict=False):
                costs = [
                    sum(
                        cost
                        for name, cost in found[key, kind].causes.items()
                        if name == cause or (cause == "other" and name not in shown)
                    )
                    for key in keys
                ]
                axes.barh(
                    range(len(keys)),
                    costs,
                    0.7,
                    left=left,
                    label=cause,
                    color=colour,
                    hatch=hatch,
                    edgecolor="#ffffff",
                    linewidth=0.4,
                )
                left += costs
            said = "static points removed" if kind == "false_positive" else "dynamic points kept"
            axes.set(title=said, xlabel=f"{KINDS[kind][0]} lost [percentage points]")
            axes.set_yticks(range(len(keys)), [f"{label}, {scoring}" if several else label for label, scoring in keys])
            axes.invert_yaxis()
            axes.grid(False, axis="y")
        grid[1].set_yticklabels([])
        figure.legend(*grid[0].get_legend_handles_labels(), loc="outside upper center", ncols=5, handleheight=1.1)
        caption = "Accuracy lost to each cause, over all sequences that a method ran on. Short bars are good."
        caption += BEST * (len(keys) < len(groups))
        return ReportFigure("causes", svg(figure, "causes", caption), caption)


_FILLS = (
    ("#0a7abf", ""), ("#d55e00", "//"), ("#009e73", ".."), ("#c7669e", "xx"), ("#b58900", "--"),
    ("#3fa7dd", "\\\\"), ("#8a6fd1", "++"), ("#7d7d7d", "oo"), ("#555555", ""),
)  # fmt: skip


def pareto(board: ScoreBoard, name: str, palette: Palette) -> ReportFigure | None:
    """Variants of each method that has several: SA against DA, AA against runtime, with the Pareto front."""
    variants: dict[str, list[ScoreRow]] = {}
    for row in board.rows:
        if row.score("AA") is not None:
            variants.setdefault(row.result.method, []).append(row)
    drawn = {method: rows for method, rows in sorted(variants.items()) if len(rows) > 1}
    if not drawn:
        return None
    timed = {method: [row for row in rows if row.result.runtime.mean_s] for method, rows in drawn.items()}
    views: list[tuple[str, list[ScoreRow], str, str, Callable[[ScoreRow], float], Callable[[ScoreRow], float]]] = []
    for method, rows in drawn.items():
        views.append((method, rows, "SA [%]", "DA [%]", lambda r: r.score("SA") or 0.0, lambda r: r.score("DA") or 0.0))
        if len(timed[method]) > 1:
            views.append(
                (
                    method,
                    timed[method],
                    "seconds per frame (log)",
                    "AA [%]",
                    _seconds,
                    lambda r: r.score("AA") or 0.0,
                )
            )
    with style():
        figure, grid = panels(len(views), 3.1)
        for axes, (method, rows, xlabel, ylabel, x, y) in zip(grid, views, strict=True):
            fast = xlabel.startswith("seconds")
            front = _front([(-x(row) if fast else x(row), y(row)) for row in rows])
            look = palette.point(method)
            axes.plot([x(row) for row in rows], [y(row) for row in rows], linestyle="", markerfacecolor="none", **look)
            best = sorted((rows[k] for k in front), key=x)
            axes.plot([x(row) for row in best], [y(row) for row in best], **look)
            for row in best:
                text = row.label.removeprefix(method).strip(" ()[]") or "default"
                axes.annotate(text, (x(row), y(row)), (4, 4), textcoords="offset points", fontsize=7.5, color=INK)
            axes.margins(0.18)
            axes.set(title=method, xlabel=xlabel, ylabel=ylabel)
            if fast:
                _log(axes)
        caption = (
            f"Variants on {board.title}. Filled and joined: variants that no other variant beats in both; "
            "hollow: all others."
        )
        return ReportFigure(name, svg(figure, name, caption), caption)


def _front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of the points that no other point beats in both coordinates; larger is better."""
    return [k for k, (a, b) in enumerate(points) if not any(c >= a and d >= b and (c > a or d > b) for c, d in points)]


def best_of_each_method(board: ScoreBoard) -> list[ScoreRow]:
    """The row with the best AA of each method, best method first."""
    best: dict[str, ScoreRow] = {}
    for row in board.rows:
        best.setdefault(row.result.method, row)
    return list(best.values())


def _seconds(row: ScoreRow) -> float:
    return row.result.runtime.mean_s or 0.0


def _timed(board: ScoreBoard) -> list[ScoreRow]:
    return [row for row in board.rows if row.result.runtime.mean_s and row.score("AA") is not None]


def _iso(axes: Axes, low: Sequence[float]) -> None:
    """Lines of equal AA = sqrt(SA * DA), with their values at the right edge."""
    last = -np.inf
    for aa in range(10, 100, 10):
        sa = np.linspace(max(low[0], 1e-6, aa * aa / 101), 101, 60)
        axes.plot(sa, aa * aa / sa, color=FAINT, linewidth=1.0, zorder=0.5)
        at = aa * aa / 101
        if low[1] < at and at - last > 0.07 * (101 - low[1]):
            axes.text(
                101.3 - 0.003 * low[0], at, f" {aa}", fontsize=7, color=INK, alpha=0.7, va="center", clip_on=False
            )
            last = at
    axes.text(1.01, 1.0, "AA", transform=axes.transAxes, fontsize=7, color=INK, alpha=0.7, va="center")
    axes.grid(False)


def _name(axes: Axes, label: str, x: float, y: float, low: Sequence[float]) -> None:
    side = "right" if x > (low[0] + 101) / 2 else "left"
    place = (6 if side == "right" else -6, -14 if y > 0.9 * 101 + 0.1 * low[1] else 7)
    axes.annotate(label, (x, y), place, textcoords="offset points", ha=side, fontsize=8, color=INK)


def _log(axes: Axes) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 3.0, 5.0)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def _legend(figure: Figure, rows: Sequence[ScoreRow], palette: Palette, lines: bool = True) -> None:
    """One legend of methods above all panels, with their lines or only their markers."""
    from matplotlib.lines import Line2D

    methods = list(dict.fromkeys(row.result.method for row in rows))
    bare = {} if lines else {"linestyle": ""}
    handles = [Line2D([], [], **{**palette.line(m), **bare}, label=m) for m in methods]
    columns = min(len(methods), int(figure.get_figwidth() / LEGEND_ENTRY))
    figure.legend(handles=handles, loc="outside upper center", ncols=columns, handlelength=2.4, columnspacing=1.4)
