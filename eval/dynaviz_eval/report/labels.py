"""Labels next to marks and at the ends of lines, placed so that they do not cover each other."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from dynaviz.arrays import F64
from dynaviz_eval.report.drawing import INK

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LONGEST = 30  # characters of a name at the end of a line
SIZE = 8.0  # points: height of a letter's box
ADVANCE = 0.6  # width of a letter, in sizes
LINE = 1.3  # distance between lines of text, in sizes
RADII = (8.0, 15.0, 24.0, 34.0, 46.0, 60.0, 76.0)  # points: distances of a label from its mark
DIRECTIONS = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1))
MARK = 5.0  # points: half the size of a mark

Box = tuple[float, float, float, float]  # left, bottom, right, top; points


def label_marks(axes: Axes, marks: Sequence[tuple[float, float, str]]) -> None:
    """Write a name next to each mark, inside the axes, with a line to it if it is far away.

    Call it after everything else is drawn.

    Args:
        axes: of a figure with 72 dots per inch, so that dots are points.
        marks: x, y (data coordinates) and name of each mark. Marks without a name are only kept
            free.
    """
    _settle(axes)
    at = axes.transData.transform([(x, y) for x, y, _ in marks]) if marks else np.empty((0, 2))
    edge = axes.bbox
    inside: Box = (edge.x0 + 2, edge.y0, edge.x1 + 4, edge.y1 + 8)
    taken: list[Box] = [(x - MARK, y - MARK, x + MARK, y + MARK) for x, y in at.tolist()]
    for (x, y, name), place in zip(marks, at, strict=True):
        if name:
            box, offset, far = _free(place, name, taken, inside)
            taken.append(box)
            arrow = (
                {"arrowstyle": "-", "color": INK, "linewidth": 0.5, "shrinkA": 0, "shrinkB": 3}
                if far
                else None
            )
            axes.annotate(
                name, (x, y), offset, textcoords="offset "
                "points", ha="left", va="bottom", fontsize=SIZE, color=INK,
                arrowprops=arrow, annotation_clip=False,
            )  # fmt: skip


def label_ends(axes: Axes, ends: Sequence[tuple[float, float, str, str]]) -> None:
    """Write a name to the right of the end of each line, with a short line of its colour.

    Args:
        axes: of a figure with 72 dots per inch, so that dots are points.
        ends: x, y (data coordinates), name and colour of each line.
    """
    notes = [
        axes.annotate(_short(name), (1, 0.5), (20, 0), xycoords="axes "
        "fraction", textcoords="offset points",
                      fontsize=SIZE, color=INK, va="center", annotation_clip=False)
        for _, _, name, _ in ends
    ]  # fmt: skip
    _settle(axes)
    heights = [float(axes.transData.transform((x, y))[1]) for x, y, _, _ in ends]
    for note, (x, y, _, colour), height in zip(
        notes, ends, _spread(heights, axes.bbox.y0, axes.bbox.y1), strict=True
    ):
        fraction = (height - axes.bbox.y0) / axes.bbox.height
        note.xy = (1, fraction)
        start = axes.transAxes.inverted().transform(axes.transData.transform((x, y)))
        axes.plot(
            [start[0], 1 + 17 / axes.bbox.width], [start[1], fraction], transform=axes.transAxes,
            color=colour,
            linewidth=1.0, clip_on=False,
        )  # fmt: skip


def _short(name: str) -> str:
    """The name without its middle if it would leave no room for the lines.

    A path differs at its end.
    """
    return name if len(name) <= LONGEST else f"{name[: LONGEST // 2]}…{name[-LONGEST // 2 + 1 :]}"


def _settle(axes: Axes) -> None:
    """Fix position and limits of the axes, so that data coordinates can be converted."""
    from matplotlib.figure import Figure

    figure = axes.get_figure()
    assert isinstance(figure, Figure)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    axes.autoscale(False)


def _free(
    place: F64, name: str, taken: Sequence[Box], inside: Box
) -> tuple[Box, tuple[float, float], bool]:
    """The nearest free box for a name; the least covered one if none is free.

    Returns:
        The box, the offset of its lower left corner from the mark, and whether it is far from the
        mark.
    """
    width = ADVANCE * SIZE * len(name)
    height = LINE * SIZE
    best: tuple[float, Box, tuple[float, float], bool] | None = None
    for radius, (right, up) in itertools.product(RADII, DIRECTIONS):
        left = {1: radius, 0: -width / 2, -1: -radius - width}[right]
        bottom = {1: radius, 0: -height / 2, -1: -radius - height}[up]
        box = (
            place[0] + left,
            place[1] + bottom,
            place[0] + left + width,
            place[1] + bottom + height,
        )
        cost = sum(_shared(box, other) for other in taken) + _outside(box, inside)
        if best is None or cost < best[0]:
            best = cost, box, (left, bottom), radius > RADII[1]
        if not cost:
            break
    assert best is not None
    return best[1:]


def _shared(a: Box, b: Box) -> float:
    """Area that two boxes share, square points."""
    return max(0.0, min(a[2], b[2]) - max(a[0], b[0])) * max(0.0, min(a[3], b[3]) - max(a[1], b[1]))


def _outside(box: Box, inside: Box) -> float:
    """Area of a box outside another, square points; counts tenfold, because it would be cut off."""
    return 10 * ((box[2] - box[0]) * (box[3] - box[1]) - _shared(box, inside))


def _spread(heights: Sequence[float], low: float, high: float) -> list[float]:
    """Move heights apart by at least a line of text, keeping their order, inside an interval if
    they fit.
    """
    step = LINE * SIZE
    order = sorted(range(len(heights)), key=lambda k: heights[k])
    placed = dict.fromkeys(order, low)
    at = low - step
    for k in order:
        at = max(at + step, heights[k])
        placed[k] = at
    at = max(high, low + step * (len(order) - 1)) + step
    for k in reversed(order):
        at = min(at - step, placed[k])
        placed[k] = at
    return [placed[k] for k in range(len(heights))]
