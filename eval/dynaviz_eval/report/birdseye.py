"""Maps from above: the ground truth and what each method left of it (paper, Figs. 6 and 7)."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F64, U8, Bool, Intp
from dynaviz.errors import DataError
from dynaviz.reporting import Overview, Study
from dynaviz.scan import Outcome
from dynaviz_eval.report.boards import ScoreBoard
from dynaviz_eval.report.figures import best_of_each_method

WIDE, HIGH = 640, 480  # pixels at most
SHADES = 24  # of grey, by height
MARGIN = 2.0  # metres around the map
BACKGROUND, UNKNOWN, GHOST, HOLE, RIGHT, GREY = range(6)  # in the palette; from the last one on, shades of grey
_COLOURS = ((18, 20, 26), (48, 50, 58), (240, 70, 20), (245, 225, 80), (86, 160, 233))  # as in a recording
_STATIC = (Outcome.STATIC_KEPT, Outcome.FALSE_POSITIVE)
_MOVING = (Outcome.DYNAMIC_REMOVED, Outcome.FALSE_NEGATIVE)
_RIGHT = np.arange(len(Outcome), dtype=np.uint8)  # what each outcome would be, were it right
_RIGHT[[Outcome.FALSE_POSITIVE, Outcome.FALSE_NEGATIVE]] = Outcome.STATIC_KEPT, Outcome.DYNAMIC_REMOVED


@dataclass(frozen=True)
class MapImage:
    """A picture of a page, as base64 of a PNG."""

    png: str
    width: int
    height: int
    title: str
    caption: str
    alt: str


def maps(study: Study, board: ScoreBoard) -> tuple[list[MapImage], list[str]]:
    """The ground truth and one picture for the best run of each method.

    Returns:
        Pictures, and a sentence for each run without one.
    """
    overviews: dict[str, Overview] = {}
    notes = []
    rows = best_of_each_method(board)
    for row in rows:
        assert row.cell is not None
        try:
            overview = study.overview(row.cell)
        except DataError as error:
            notes.append(f"{row.label}: {error}")
            continue
        if overview is None:
            why = "its recording holds no points" if row.cell.recording else "there is no recording"
            notes.append(f"{row.label}: no picture, for {why}.")
        else:
            overviews[row.label] = overview
    if not overviews:
        return [], notes
    fewest = min(overviews.values(), key=lambda overview: int((overview.outcome == Outcome.FALSE_POSITIVE).sum()))
    view = BirdsEyeView.of(fewest)
    truth = view.draw(Overview(fewest.points, _RIGHT[fewest.outcome]))
    alt = f"Map of {board.title} from above, with what moves in blue"
    made = [view.map(truth, "ground truth", "what a perfect method would leave and remove", alt)]
    for row in rows:
        if row.label in overviews:
            ghosts, holes = (row.result.counts.get(name, 0) for name in ("dynamic_kept", "static_removed"))
            said = f"{ghosts:,} ghost points, {holes:,} removed wrongly"
            alt = f"Map that {row.label} left of {board.title}, from above: {said}"
            made.append(view.map(view.draw(overviews[row.label]), row.label, said, alt))
    return made, notes


@dataclass(frozen=True, eq=False)
class BirdsEyeView:
    """From above, turned so that the map lies lengthwise.

    Attributes:
        turn: (2, 2), the picture's axes in the world.
        low, high: (2,) metres, in the picture's axes.
        heights: of the darkest and the brightest grey, metres.
        pixel: its edge, metres.
    """

    turn: F64
    low: F64
    high: F64
    heights: tuple[float, float]
    pixel: float

    @classmethod
    def of(cls, overview: Overview) -> BirdsEyeView:
        """Of most of what has a label: the outermost points would make all others small."""
        known = np.isin(overview.outcome, (*_STATIC, *_MOVING))
        known |= not known.any()
        points, outcome = overview.points[known].astype(np.float64), overview.outcome[known]
        finite = np.isfinite(points).all(1)
        points, outcome = points[finite], outcome[finite]
        if not len(points):
            points, outcome = np.zeros((1, 3)), np.zeros(1, np.uint8)
        turn = _lengthwise(points[:, :2])
        flat = points[:, :2] @ turn.T
        low, high = np.percentile(flat, [1, 99], axis=0)
        moving = flat[np.isin(outcome, _MOVING)]
        if len(moving):
            low, high = np.minimum(low, moving.min(0)), np.maximum(high, moving.max(0))
        low, high = low - MARGIN, high + MARGIN
        pixel = float(max((high[0] - low[0]) / WIDE, (high[1] - low[1]) / HIGH))
        bottom, top = np.percentile(points[:, 2], [2, 95])
        return cls(turn, low, high, (float(bottom), float(top)), pixel)

    def draw(self, overview: Overview) -> U8:
        """(rows, columns) uint8 indices into the palette.

        A pixel shows a ghost where no less of what moves was kept than removed, and else a hole where more of what
        stands still was removed than kept.
        """
        at, heights, inside = self._place(overview)
        shape = np.maximum(((self.high - self.low) / self.pixel).astype(int), 1)[::-1]

        def splat(outcome: Outcome, reach: int) -> tuple[Intp, F64]:
            """Pixels within reach of the points of an outcome, and the points' heights; the lowest first."""
            chosen = np.flatnonzero(inside & (overview.outcome == outcome))
            chosen = chosen[np.argsort(heights[chosen], kind="stable")]
            offsets = [(dy, dx) for dy in range(-reach, reach + 1) for dx in range(-reach, reach + 1)]
            near = (at[chosen, None] + np.array(offsets)).reshape(-1, 2)
            near = np.clip(near, 0, shape - 1)
            return near[:, 0] * shape[1] + near[:, 1], np.repeat(heights[chosen], len(offsets))

        image = np.full(shape[0] * shape[1], BACKGROUND, np.uint8)
        image[splat(Outcome.UNLABELLED_KEPT, 0)[0]] = UNKNOWN
        kept, z = splat(Outcome.STATIC_KEPT, 1)
        bottom, top = self.heights
        image[kept] = GREY + np.clip((z - bottom) / max(top - bottom, 1e-3) * SHADES, 0, SHADES - 1).astype(np.uint8)
        removed = splat(Outcome.FALSE_POSITIVE, 1)[0]
        image[np.bincount(removed, minlength=len(image)) > np.bincount(kept, minlength=len(image))] = HOLE
        rightly, ghosts = (splat(outcome, 1)[0] for outcome in (Outcome.DYNAMIC_REMOVED, Outcome.FALSE_NEGATIVE))
        image[rightly] = RIGHT
        left = np.bincount(ghosts, minlength=len(image))
        image[(left > 0) & (left >= np.bincount(rightly, minlength=len(image)))] = GHOST
        picture = image.reshape(shape)
        self._scale(picture)
        return picture

    def _place(self, overview: Overview) -> tuple[Intp, F64, Bool]:
        """Row and column of each point, its height, and whether it lies in the picture."""
        points = overview.points.astype(np.float64)
        inside: Bool = np.logical_and.reduce(np.isfinite(points), axis=1)
        points[~inside] = 0
        flat = points[:, :2] @ self.turn.T
        inside &= ((flat >= self.low) & (flat < self.high)).all(1)
        flat = np.clip(flat, self.low, self.high)
        column, line = ((flat[:, 0] - self.low[0]) / self.pixel), ((self.high[1] - flat[:, 1]) / self.pixel)
        return np.stack([line, column], 1).astype(np.intp), points[:, 2], inside

    def _scale(self, image: U8) -> None:
        """Draw a bar of 10 m in the lower left corner."""
        length = min(round(10 / self.pixel), image.shape[1] - 20)
        if length > 0 and image.shape[0] > 20:
            image[-12:-9, 10 : 10 + length] = GREY + SHADES - 1

    def map(self, image: U8, title: str, caption: str, alt: str) -> MapImage:
        """A picture of its own palette as PNG."""
        from PIL import Image

        greys = [round(70 + 120 * k / (SHADES - 1)) for k in range(SHADES)]
        palette = [c for colour in (*_COLOURS, *((g, g, g + 8) for g in greys)) for c in colour]
        picture = Image.fromarray(image)
        picture.putpalette(palette)
        content = io.BytesIO()
        picture.save(content, "PNG")
        return MapImage(
            base64.b64encode(content.getvalue()).decode(), image.shape[1], image.shape[0], title, caption, alt
        )


def legend() -> Sequence[tuple[str, str]]:
    """Colours and what they mean, for a page."""
    names = {
        RIGHT: "dynamic, removed",
        GHOST: "ghost: dynamic, but left",
        HOLE: "hole: static, more removed than kept",
        UNKNOWN: "without a label",
    }
    listed = [("#{:02x}{:02x}{:02x}".format(*_COLOURS[layer]), name) for layer, name in names.items()]
    return [("#808088", "static, kept; brighter is higher"), *listed]


def _lengthwise(flat: F64) -> F64:
    """(2, 2) axes of (N, 2) points: the longest first, turned but not mirrored."""
    _, axes = np.linalg.eigh(np.cov(flat.T) if len(flat) > 1 else np.eye(2))
    first = axes[:, 1] * (1 if axes[np.argmax(np.abs(axes[:, 1])), 1] > 0 else -1)
    return np.array([first, [-first[1], first[0]]])
