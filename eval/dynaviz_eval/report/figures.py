"""The figures of a report, as SVG. Each function returns None if there is nothing to draw.

Each panel is an SVG of its own, so that a page can place them side by side or, on a phone, one
below the other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from dynaviz.scores.sections import ErrorDistances
from dynaviz_eval.error_distance import BIN, LIMIT
from dynaviz_eval.report.boards import KINDS, ScoreBoard, ScoreRow, best_of_each_method
from dynaviz_eval.report.drawing import FAINT, INK, line, mark, panel, style, svg
from dynaviz_eval.report.errors import TITLES, interval_name, intervals
from dynaviz_eval.report.labels import label_ends, label_marks

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BEST = " Of several variants of a method, only the best is shown."
FEW = 100  # points; an accuracy of fewer points is drawn hollow


@dataclass(frozen=True)
class ReportFigure:
    """A figure of a page: an SVG element for each panel, and the caption."""

    name: str
    panels: Sequence[str]
    caption: str


def panels(
    name: str, caption: str, count: int, height: float, draw: Callable[[int, Axes], str]
) -> ReportFigure:
    """Draw panels; ``draw`` draws a panel by number and returns its description."""
    drawn = []
    with style():
        for number in range(count):
            figure, axes = panel(height)
            title = draw(number, axes)
            drawn.append(svg(figure, f"{name}-{number}", title))
    return ReportFigure(name, drawn, caption)


def scores(boards: Sequence[ScoreBoard]) -> ReportFigure | None:
    """SA against DA, with lines of equal AA."""
    drawn = [board for board in boards if any(row.score("AA") is not None for row in board.rows)]

    def draw(number: int, axes: Axes) -> str:
        board = drawn[number]
        points = [
            (r, r.score("SA") or 0.0, r.score("DA") or 0.0)
            for r in board.rows
            if r.score("AA") is not None
        ]
        low = [
            max(0.0, value - 4) for value in (min(p[1] for p in points), min(p[2] for p in points))
        ]
        _iso(axes, low)
        for row, sa, da in points:
            axes.plot(sa, da, linestyle="", **mark(row.result.method))
        axes.set(
            title=board.title, xlabel="SA [%]: static kept", xlim=(low[0], 101), ylim=(low[1], 101)
        )
        axes.set_ylabel("DA [%]: dynamic removed")
        label_marks(axes, _named([(sa, da, row) for row, sa, da in points]))
        return f"Static against dynamic accuracy on {board.title}"

    caption = "Static against dynamic accuracy; the best corner is top right. Thin lines: equal AA."
    return panels("scores", caption, len(drawn), 3.8, draw) if drawn else None


def speed(boards: Sequence[ScoreBoard]) -> ReportFigure | None:
    """Runtime against AA."""
    drawn = [board for board in boards if _timed(board)]

    def draw(number: int, axes: Axes) -> str:
        rows = _timed(drawn[number])
        for row in rows:
            hollow: dict[str, Any] = {"markerfacecolor": "none"} if row.result.instrumented else {}
            axes.plot(
                _seconds(row),
                row.score("AA") or 0.0,
                linestyle="",
                **mark(row.result.method),
                **hollow,
            )
        axes.margins(0.12)
        axes.set(title=drawn[number].title, xlabel="seconds per frame (log)", ylabel="AA [%]")
        _log(axes)
        label_marks(axes, _named([(_seconds(row), row.score("AA") or 0.0, row) for row in rows]))
        return f"Runtime against AA on {drawn[number].title}"

    caption = "Runtime against AA; the best corner is top left."
    if any(row.result.instrumented for board in drawn for row in _timed(board)):
        caption += " Hollow: measured while states were recorded, so slower than the method alone."
    return panels("speed", caption, len(drawn), 3.4, draw) if drawn else None


MOST_NAMES = (
    16  # marks of a panel with a name; of more, only the best variant of each method has one
)


def _named(points: Sequence[tuple[float, float, ScoreRow]]) -> list[tuple[float, float, str]]:
    """Places and names of marks, best first."""
    seen: set[str] = set()
    named = []
    for x, y, row in points:
        first = row.result.method not in seen
        seen.add(row.result.method)
        named.append((x, y, row.label if first or len(points) <= MOST_NAMES else ""))
    return named


def accuracy_by(board: ScoreBoard, name: str, of: str) -> ReportFigure | None:
    """SA and DA by ``range`` or ``height``."""
    drawn = (
        [row for row in best_of_each_method(board) if intervals(row, of)] if board.has_truth else []
    )
    if not drawn:
        return None
    ticks = [interval_name(each) for each in intervals(drawn[0], of)]
    kinds = [
        (score, right, wrong)
        for score, right, wrong in KINDS.values()
        if _any_score(drawn, of, score)
    ]

    def draw(number: int, axes: Axes) -> str:
        score, right, wrong = kinds[number]
        ends = []
        for row in drawn:
            here = intervals(row, of)
            values = [np.nan if getattr(b, score) is None else getattr(b, score) for b in here]
            look = line(row.result.method)
            axes.plot(range(len(here)), values, **{**look, "marker": ""})
            few = np.array([getattr(each, right) + getattr(each, wrong) < FEW for each in here])
            for face, chosen in ({}, ~few), ({"markerfacecolor": "none"}, few):
                axes.plot(
                    np.flatnonzero(chosen),
                    np.array(values)[chosen],
                    **{**look, **face, "linestyle": ""},
                )
            known = [(at, value) for at, value in enumerate(values) if not np.isnan(value)]
            ends += [(*known[-1], row.label, look["color"])] if known else []
        said = "static kept" if score == "SA" else "dynamic removed"
        axes.set(title=f"{score}: {said}", ylabel=f"{score} [%]", xlabel=f"{TITLES[of]} [m]")
        axes.set_xticks(range(len(ticks)), ticks)
        label_ends(axes, ends)
        return f"{score} against {TITLES[of]} on {board.title}"

    caption = (
        f"Accuracy against {TITLES[of]} on {board.title}. Hollow markers: fewer than {FEW} points."
    )
    caption += BEST * (len(drawn) < len(board.rows))
    return panels(name, caption, len(kinds), 3.2, draw) if kinds else None


def _any_score(rows: Iterable[ScoreRow], of: str, score: str) -> bool:
    return any(getattr(each, score) is not None for row in rows for each in intervals(row, of))


def distances(board: ScoreBoard, name: str) -> ReportFigure | None:
    """Distances from wrong points to correct ones, a histogram per method (paper, Fig. 5)."""
    drawn = [row for row in best_of_each_method(board) if row.result.sections.error_distance]
    titles = {
        "false_negative": "dynamic points kept:\ndistance to the nearest one removed",
        "false_positive": "static points removed:\ndistance to the nearest one kept",
    }

    def draw(number: int, axes: Axes) -> str:
        kind, title = list(titles.items())[number]
        for at, row in enumerate(drawn):
            _ridge(axes, -at, row, kind)
        axes.set(title=title, xlabel="distance [m]; last bar: larger", xlim=(0, LIMIT + 0.35))
        axes.set_ylim(-len(drawn) + 0.9, 1.05)
        axes.set_yticks([-at + 0.3 for at in range(len(drawn))], [row.label for row in drawn])
        axes.tick_params(axis="y", length=0)
        axes.grid(False, axis="y")
        axes.spines["left"].set_visible(False)
        return f"{title} on {board.title}".replace("\n", " ")

    caption = (
        f"Distances from wrong points to correct ones on {board.title}. Bars: share of a method's "
        "wrong points per "
        "5 cm, each row scaled to its own maximum. Dashed line: 10 % of the points are nearer. "
        "Right: number of wrong points."
    )
    caption += BEST * (len(drawn) < len(board.rows))
    return panels(name, caption, len(titles), 0.42 * len(drawn) + 1.5, draw) if drawn else None


def _ridge(axes: Axes, base: float, row: ScoreRow, kind: str) -> None:
    section = row.result.sections.error_distance.get(kind, ErrorDistances())
    histogram = section.histogram
    number = row.result.counts.get(
        "dynamic_kept" if kind == "false_negative" else "static_removed", 0
    )
    axes.axhline(base, color=FAINT, linewidth=0.8)
    if not histogram or not sum(histogram):
        axes.text(
            0.02,
            base + 0.2,
            "no correct points" if number else "no errors",
            fontsize=7.5,
            color=INK,
        )
    else:
        shares = np.array(histogram, float) / max(histogram)
        edges = np.arange(len(histogram)) * BIN
        colour = mark(row.result.method)["color"]
        for heights, ends in (
            (shares[:-1], edges),
            (shares[-1:], LIMIT + 0.06 + np.array([0, BIN])),
        ):
            axes.stairs(
                base + 0.8 * heights, ends, baseline=base, fill=True, color=colour, linewidth=0
            )
        if section.p10 is not None:
            axes.plot(
                [section.p10] * 2,
                [base, base + 0.9],
                color=INK,
                linestyle=(0, (2, 1)),
                linewidth=1.3,
            )
    axes.text(
        LIMIT + 0.33, base + 0.45, f"{number:,}", fontsize=7.5, ha="right", va="bottom", color=INK
    )


@dataclass(frozen=True)
class _Variants:
    """A panel of variants of one method.

    Two scores, of which the second and possibly minus the first is to be high.
    """

    method: str
    rows: Sequence[ScoreRow]
    xlabel: str
    ylabel: str
    x: Callable[[ScoreRow], float]
    y: Callable[[ScoreRow], float]
    fast: bool = False


def pareto(board: ScoreBoard, name: str) -> ReportFigure | None:
    """Variants of each method that has several.

    SA against DA, AA against runtime, with the Pareto front.
    """
    variants: dict[str, list[ScoreRow]] = {}
    for row in board.rows:
        if row.score("AA") is not None:
            variants.setdefault(row.result.method, []).append(row)
    views = []
    for method, rows in sorted(variants.items()):
        timed = [row for row in rows if row.result.runtime.mean_s]
        if len(rows) > 1:
            views.append(_Variants(method, rows, "SA [%]", "DA [%]", _score("SA"), _score("DA")))
        if len(timed) > 1:
            views.append(
                _Variants(
                    method, timed, "seconds per frame (log)", "AA [%]", _seconds, _score("AA"), True
                )
            )

    def draw(number: int, axes: Axes) -> str:
        _draw_variants(axes, views[number])
        return (
            f"Variants of {views[number].method}: {views[number].ylabel} against "
            f"{views[number].xlabel}"
        )

    caption = (
        f"Variants on {board.title}. Filled and joined: variants that no other variant beats in "
        "both; "
        "hollow: all others."
    )
    return panels(name, caption, len(views), 3.2, draw) if views else None


def _draw_variants(axes: Axes, view: _Variants) -> None:
    sign = -1 if view.fast else 1
    front = _front([(sign * view.x(row), view.y(row)) for row in view.rows])
    look = mark(view.method)
    places = [(view.x(row), view.y(row)) for row in view.rows]
    axes.plot(*zip(*places, strict=True), linestyle="", markerfacecolor="none", **look)
    axes.plot(*zip(*sorted(places[k] for k in front), strict=True), **look)
    axes.margins(0.18)
    axes.set(title=view.method, xlabel=view.xlabel, ylabel=view.ylabel)
    if view.fast:
        _log(axes)
    names = [row.label.removeprefix(view.method).strip(" ()[]") or "default" for row in view.rows]
    label_marks(axes, [(x, y, names[k] if k in front else "") for k, (x, y) in enumerate(places)])


def _front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of the points that no other point beats in both coordinates; larger is better."""
    return [
        k
        for k, (a, b) in enumerate(points)
        if not any(c >= a and d >= b and (c > a or d > b) for c, d in points)
    ]


def _score(name: str) -> Callable[[ScoreRow], float]:
    return lambda row: row.score(name) or 0.0


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
                101.3 - 0.003 * low[0],
                at,
                f" {aa}",
                fontsize=7,
                color=INK,
                va="center",
                clip_on=False,
            )
            last = at
    axes.text(1.01, 1.0, "AA", transform=axes.transAxes, fontsize=7, color=INK, va="center")
    axes.grid(False)


def _log(axes: Axes) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 3.0, 5.0)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
