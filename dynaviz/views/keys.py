"""Keys of states: what their colours mean, as a strip below each state's view.

And guides in polar grids.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
import rerun as rr

from dynaviz import colours
from dynaviz.arrays import F32, F64, U8
from dynaviz.contracts.method import MethodInfo
from dynaviz.contracts.probe import Mask, Plane, PolarGrid, RangeImage, State
from dynaviz.contracts.scan import Outcome, Scan
from dynaviz.views import paths

STACK = 2  # range images in one tab
# pixels of a strip, and of each of its rows; small, so that its text is large in a small view
WIDTH = 380
ROW = 36
BAR = 11  # pixels: height of a colour bar or swatch
STEPS = 44  # of a colour bar; a smooth one would be a larger file
MARGIN = 8
TEXT: colours.Colour = (225, 225, 230)
FONT_SCALE = 0.62
NAME_WIDTH = 120  # pixels for the name, where a strip has several rows
# of viridis: without its near-black, and without its yellow, which is the colour of holes
PART = (
    0.25,
    0.8,
)
GREYS = (0.22, 1.0)  # part of the greys in use in pictures: black is for empty pixels
CIRCLE = np.linspace(0.0, 2 * np.pi, 73)
RING_COLOUR: colours.Colour = (150, 150, 160)
APART = 0.2  # of a colour bar: numbers closer to the threshold are left out
LEGEND_WIDTH = 900  # pixels
# words of the legend of a recording
POINTS: dict[Outcome, str] = {
    Outcome.STATIC_KEPT: "kept",
    Outcome.DYNAMIC_REMOVED: "removed",
    Outcome.FALSE_POSITIVE: "hole",
    Outcome.FALSE_NEGATIVE: "ghost",
    Outcome.UNLABELLED_KEPT: "unlabelled",
}
POINTS_WITHOUT_TRUTH: dict[Outcome, str] = {
    Outcome.UNLABELLED_KEPT: "kept",
    Outcome.UNLABELLED_REMOVED: "removed",
}
RAYS = {
    colours.HIT: "ray: hit",
    colours.CROSSED: "ray: through",
    colours.GRAZED: "ray: grazing",
}
STANDING = 0.05  # metres between two scans: less is no motion


def tabs(info: MethodInfo) -> list[tuple[State, ...]]:
    """The states of a method that are drawn, by tab.

    Consecutive range images share one, because they are low.
    """
    found: list[tuple[State, ...]] = []
    for kind, group in itertools.groupby(info.emits, lambda state: state.kind):
        if issubclass(kind, (*paths.SOLID, *paths.FLAT)):
            states = tuple(group)
            together = STACK if kind is RangeImage else 1
            found += [states[first : first + together] for first in range(0, len(states), together)]
    return found


def plain(name: str) -> str:
    """The name of a state as words."""
    return name.replace("_", " ")


def title(state: State) -> str:
    """The name of a state as words."""
    return plain(state.name)


def legend(truth: bool) -> rr.EncodedImage:
    """The colours of outcomes and rays as a picture.

    Args:
        truth: whether the run has ground truth.
    """
    points = POINTS if truth else POINTS_WITHOUT_TRUTH
    shades = colours.BRIGHT if truth else colours.UNSCORED
    entries = [(words, shades[outcome]) for outcome, words in points.items()]
    entries += [(words, colours.RAYS[kind]) for kind, words in RAYS.items()]
    picture = _empty(1, LEGEND_WIDTH)
    _swatches(picture, entries)
    return _png(picture)


def strip(states: Sequence[State], params: Mapping[str, Any] | None = None) -> rr.EncodedImage:
    """The key of the states of a tab as a picture.

    A colour bar with numbers and the threshold, or a swatch for each class.

    Args:
        states: of the tab.
        params: of the run; without them, no threshold of a parameter is drawn.
    """
    picture = _empty(len(states), WIDTH)
    for k, state in enumerate(states):
        row = picture[k * ROW : (k + 1) * ROW]
        left = MARGIN
        if len(states) > 1:
            _text(row, title(state), left, ROW // 2 + 5)
            left += NAME_WIDTH
        if state.legend:
            shades = itertools.cycle(colours.CLASSES)
            _swatches(
                row,
                [(name, shade) for name, shade in zip(state.legend, shades, strict=False) if name],
            )
        elif state.kind in (Mask, Plane) or (
            state.kind not in paths.FLAT and state.value_range is None
        ):
            _swatches(row, [(title(state), colours.STATE)])
        else:
            _bar(row, left, state, _threshold(state, params or {}))
    return _png(picture)


def _empty(rows: int, width: int) -> U8:
    """(ROW * rows, width, 3) uint8: an empty strip."""
    return np.tile(np.array(colours.BACKGROUND, np.uint8), (ROW * rows, width, 1))


def _png(picture: U8) -> rr.EncodedImage:
    import cv2

    png = cv2.imencode(".png", picture[:, :, ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])[1]
    return rr.EncodedImage(contents=png.tobytes(), media_type="image/png")


def _threshold(state: State, params: Mapping[str, Any]) -> float | None:
    """The value at which a verdict changes; None if it is unknown or outside the range."""
    value = state.threshold
    if isinstance(value, str):
        value = params.get(value)
    if value is None or state.value_range is None:
        return None
    low, high = state.value_range
    return float(value) if low <= value <= high else None


def heading(states: Sequence[State]) -> str:
    """What the states of a tab show, in one line."""
    return (
        states[0].meaning
        if len(states) == 1
        else "; ".join(dict.fromkeys(state.meaning for state in states))
    )


def stretched(low: float, high: float, part: tuple[float, float] = PART) -> tuple[float, float]:
    """The range of a whole colour scale, of which a part covers low to high."""
    unit = (high - low) / (part[1] - part[0])
    return low - part[0] * unit, high + (1 - part[1]) * unit


def coloured(shares: F32) -> U8:
    """(N, 3) uint8 RGB of (N,) shares of a range, 0 to 1."""
    at = PART[0] + (PART[1] - PART[0]) * shares
    rgb: U8 = _viridis()[(255 * at).round().astype(np.uint8)]
    return rgb


@cache
def _viridis() -> U8:
    """(256, 3) uint8 RGB, from dark to bright, also with colour blindness."""
    import cv2

    levels = np.arange(256, dtype=np.uint8)[:, None]
    return np.ascontiguousarray(
        cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS)[:, 0, ::-1], np.uint8
    )


def _bar(row: U8, left: int, state: State, threshold: float | None) -> None:
    right = WIDTH - MARGIN
    value_range = state.value_range
    shares = (np.arange(right - left) * STEPS // (right - left) / (STEPS - 1)).astype(np.float32)
    grey = (255 * (GREYS[0] + (GREYS[1] - GREYS[0]) * shares)).astype(np.uint8)[:, None]
    row[3 : 3 + BAR, left:right] = grey if issubclass(state.kind, paths.FLAT) else coloured(shares)
    low, high = value_range or (0.0, 1.0)
    marked = None if threshold is None else (threshold - low) / (high - low)
    if marked is not None:
        mark = int(left + marked * (right - left - 1))
        row[: BAR + 6, max(mark - 1, left) : mark + 1] = TEXT
        words = f"| {threshold:.3g}"
        _text(row, words, min(mark - 1, right - _width(words)), ROW - 6)
    for share in (0.0, 0.5, 1.0):
        if marked is not None and abs(share - marked) < APART:
            continue
        words = (
            f"{low + share * (high - low):.3g}"
            if value_range
            else {0.0: "lowest", 1.0: "highest"}.get(share, "")
        )
        at = left + share * (right - left - _width(words))
        _text(row, words, int(at), ROW - 6)


def _swatches(row: U8, entries: Sequence[tuple[str, colours.Colour]]) -> None:
    wide = (row.shape[1] - 2 * MARGIN) // max(len(entries), 1)
    scale = FONT_SCALE * min(
        1.0, (wide - 10) / max((_width(name) for name, _ in entries), default=1)
    )
    for k, (name, colour) in enumerate(entries):
        left = MARGIN + k * wide
        row[3 : 3 + BAR, left : left + wide - 8] = colour
        _text(row, name, left, ROW - 6, scale)


def _text(row: U8, words: str, left: int, base: int, scale: float = FONT_SCALE) -> None:
    import cv2

    cv2.putText(row, words, (left, base), cv2.FONT_HERSHEY_SIMPLEX, scale, TEXT, 1, cv2.LINE_AA)


def _width(words: str) -> int:
    import cv2

    return int(cv2.getTextSize(words, cv2.FONT_HERSHEY_SIMPLEX, FONT_SCALE, 1)[0][0])


def rings(grid: PolarGrid, picture: int) -> tuple[rr.LineStrips2D, rr.Points2D]:
    """Circles at round distances over a polar grid from above, and every second radius at its top.

    The circles themselves would have their labels in the middle, on top of each other. picture: its
    edge in pixels.
    """
    half = picture / 2
    step = next(
        step for step in (1, 2, 5, 10, 20, 50, 100) if step * 5 > grid.max_range or step == 100
    )
    distances = np.arange(step, grid.max_range + 1e-6, step)
    lengths = distances / grid.max_range * half
    circles = [half + length * np.stack([-np.sin(CIRCLE), np.cos(CIRCLE)], 1) for length in lengths]
    lines = rr.LineStrips2D(
        circles, colors=RING_COLOUR, radii=rr.Radius.ui_points(0.5), draw_order=10.0
    )
    names = rr.Points2D(
        np.stack([np.full(len(lengths[1::2]), half), half - lengths[1::2]], 1),
        labels=[f"{d:g} m" for d in distances[1::2]],
        colors=colours.LABEL, radii=rr.Radius.ui_points(0.0), show_labels=True, draw_order=10.0,
    )  # fmt: skip
    return lines, names


class Heading:
    """The direction of travel, from the positions of successive scans."""

    def __init__(self) -> None:
        self._index: int | None = None
        self._last: F64 | None = None
        self._ahead: F64 | None = None

    def of(self, scan: Scan) -> F64 | None:
        """(2,) unit vector in the world's plane; None before the first motion."""
        if scan.index != self._index:
            moved = np.zeros(2) if self._last is None else (scan.position - self._last)[:2]
            if (length := float(np.linalg.norm(moved))) > STANDING:
                self._ahead = moved / length
            self._index = scan.index
            self._last = scan.position
        return self._ahead


def arrow(ahead: F64, picture: int) -> Any:
    """The direction of travel in a polar grid from above."""
    middle = picture / 2
    length = picture / 8
    return rr.Arrows2D(
        origins=[[middle, middle]], vectors=[[ahead[0] * length, -ahead[1] * length]],
        labels=["travel"],
        colors=TEXT, radii=rr.Radius.ui_points(1.5), show_labels=True, draw_order=11.0,
    )  # fmt: skip
