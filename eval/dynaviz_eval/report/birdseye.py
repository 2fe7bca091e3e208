"""Bird's-eye pictures of the map: the ground truth, and what each method left of it (paper, Figs. 6 and 7)."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F64, U8, Bool, Intp
from dynaviz.errors import DataError
from dynaviz.reporting import Overview, Study
from dynaviz.scan import Outcome
from dynaviz_eval.report.boards import ScoreBoard
from dynaviz_eval.report.figures import best_of_each_method

MAX_WIDTH, MAX_HEIGHT = 640, 480  # pixels
SHADES = 24  # of grey, by height
MARGIN = 2.0  # metres around the map
SCALE_BAR = 10  # metres
BACKGROUND, UNKNOWN, GHOST, HOLE, RIGHT, GREY = range(6)  # palette indices; shades of grey start at the last
_COLOURS = ((18, 20, 26), (48, 50, 58), (240, 70, 20), (245, 225, 80), (86, 160, 233))  # RGB, as in a recording
_GREYS = tuple((grey, grey, grey + 8) for grey in (round(70 + 120 * k / (SHADES - 1)) for k in range(SHADES)))
_PALETTE = np.array((*_COLOURS, *_GREYS), np.uint8)  # (5 + SHADES, 3) RGB
_STATIC = (Outcome.STATIC_KEPT, Outcome.FALSE_POSITIVE)
_DYNAMIC = (Outcome.DYNAMIC_REMOVED, Outcome.FALSE_NEGATIVE)
_CORRECTED = np.arange(len(Outcome), dtype=np.uint8)  # by outcome: the outcome of a correct answer
_CORRECTED[[Outcome.FALSE_POSITIVE, Outcome.FALSE_NEGATIVE]] = Outcome.STATIC_KEPT, Outcome.DYNAMIC_REMOVED


@dataclass(frozen=True)
class MapImage:
    """A picture for a page; ``png`` is base64-encoded."""

    png: str
    width: int
    height: int
    title: str
    caption: str
    alt: str


def maps(study: Study, board: ScoreBoard) -> tuple[list[MapImage], list[str]]:
    """Draw the ground truth and the map of the best run of each method.

    Returns:
        The pictures, and a sentence for each run that has none.
    """
    overviews: dict[str, Overview] = {}
    notes = []
    rows = best_of_each_method(board)
    for row in rows:
        assert row.run is not None
        try:
            overview = study.overview(row.run)
        except DataError as error:
            notes.append(f"{row.label}: {error}")
            continue
        if overview is None:
            why = "its recording contains no points" if row.run.recording else "it has no recording"
            notes.append(f"{row.label}: no picture, because {why}.")
        else:
            overviews[row.label] = overview
    if not overviews:
        return [], notes
    fewest = min(overviews.values(), key=lambda overview: int((overview.outcome == Outcome.FALSE_POSITIVE).sum()))
    view = BirdsEyeView.of(fewest)
    truth = view.draw(Overview(fewest.points, _CORRECTED[fewest.outcome]))
    alt = f"Bird's-eye map of {board.title}, with dynamic points in blue"
    images = [view.image(truth, "ground truth", "the result of a perfect method", alt)]
    for row in rows:
        if row.label in overviews:
            ghosts, holes = (row.result.counts.get(name, 0) for name in ("dynamic_kept", "static_removed"))
            caption = f"{ghosts:,} dynamic points kept, {holes:,} static points removed"
            alt = f"Bird's-eye map of {board.title} as cleaned by {row.label}: {caption}"
            images.append(view.image(view.draw(overviews[row.label]), row.label, caption, alt))
    return images, notes


@dataclass(frozen=True, eq=False)
class BirdsEyeView:
    """A view from above, rotated so that the longest side of the map is horizontal.

    Attributes:
        turn: (2, 2), the picture's axes in the world.
        low, high: (2,) metres, corners in the picture's axes.
        heights: heights of the darkest and of the brightest grey, metres.
        pixel: edge of a pixel, metres.
    """

    turn: F64
    low: F64
    high: F64
    heights: tuple[float, float]
    pixel: float

    @classmethod
    def of(cls, overview: Overview) -> BirdsEyeView:
        """Fit a view to the labelled points, without the outermost ones: these would make the rest too small."""
        known = np.isin(overview.outcome, (*_STATIC, *_DYNAMIC))
        known |= not known.any()
        points, outcome = overview.points[known].astype(np.float64), overview.outcome[known]
        finite = np.isfinite(points).all(1)
        points, outcome = points[finite], outcome[finite]
        if not len(points):
            points, outcome = np.zeros((1, 3)), np.zeros(1, np.uint8)
        turn = _principal_axes(points[:, :2])
        flat = points[:, :2] @ turn.T
        low, high = np.percentile(flat, [1, 99], axis=0)
        dynamic = flat[np.isin(outcome, _DYNAMIC)]
        if len(dynamic):
            low, high = np.minimum(low, dynamic.min(0)), np.maximum(high, dynamic.max(0))
        low, high = low - MARGIN, high + MARGIN
        pixel = float(max((high[0] - low[0]) / MAX_WIDTH, (high[1] - low[1]) / MAX_HEIGHT))
        bottom, top = np.percentile(points[:, 2], [2, 95])
        return cls(turn, low, high, (float(bottom), float(top)), pixel)

    def draw(self, overview: Overview) -> U8:
        """(rows, columns) uint8 indices into the palette. Labelled points cover 3 x 3 pixels.

        A pixel is a ghost where at least as many dynamic points were kept as removed, else a hole where more static
        points were removed than kept.
        """
        import cv2

        at, z, inside = self._project(overview)
        shape = tuple(np.maximum(((self.high - self.low) / self.pixel).astype(int), 1)[::-1].tolist())
        at = np.minimum(at, np.array(shape) - 1)
        index = at[:, 0] * shape[1] + at[:, 1]

        def count(outcome: Outcome) -> F64:
            """Points of an outcome by pixel, in whole numbers."""
            chosen = index[inside & (overview.outcome == outcome)]
            return np.bincount(chosen, minlength=shape[0] * shape[1]).reshape(shape).astype(np.float64)

        def count_around(outcome: Outcome) -> F64:
            """Points of an outcome in the 3 x 3 pixels around each."""
            return np.asarray(
                cv2.boxFilter(count(outcome), -1, (3, 3), normalize=False, borderType=cv2.BORDER_REPLICATE), np.float64
            )

        kept, removed, ghosts, correct = map(
            count_around,
            (Outcome.STATIC_KEPT, Outcome.FALSE_POSITIVE, Outcome.FALSE_NEGATIVE, Outcome.DYNAMIC_REMOVED),
        )
        heights = np.full(shape, -np.inf)
        chosen = inside & (overview.outcome == Outcome.STATIC_KEPT)
        np.maximum.at(heights.reshape(-1), index[chosen], z[chosen])
        highest = cv2.dilate(heights, np.ones((3, 3), np.uint8))[kept > 0]
        bottom, top = self.heights
        shade = np.clip((highest - bottom) / max(top - bottom, 1e-3) * SHADES, 0, SHADES - 1).astype(np.uint8)

        image = np.full(shape, BACKGROUND, np.uint8)
        image[count(Outcome.UNLABELLED_KEPT) > 0] = UNKNOWN
        image[kept > 0] = GREY + shade
        image[removed > kept] = HOLE
        image[correct > 0] = RIGHT
        image[(ghosts > 0) & (ghosts >= correct)] = GHOST
        return image

    def _project(self, overview: Overview) -> tuple[Intp, F64, Bool]:
        """Row and column of each point, its height, and whether it is inside the picture."""
        points = overview.points.astype(np.float64)
        inside: Bool = np.logical_and.reduce(np.isfinite(points), axis=1)
        points[~inside] = 0
        flat = points[:, :2] @ self.turn.T
        inside &= ((flat >= self.low) & (flat < self.high)).all(1)
        flat = np.clip(flat, self.low, self.high)
        column, row = ((flat[:, 0] - self.low[0]) / self.pixel), ((self.high[1] - flat[:, 1]) / self.pixel)
        return np.stack([row, column], 1).astype(np.intp), points[:, 2], inside

    def image(self, indices: U8, title: str, caption: str, alt: str) -> MapImage:
        """Encode a drawn view as PNG, with a scale bar in the lower left corner."""
        import cv2

        height, width = indices.shape
        picture = np.ascontiguousarray(_PALETTE[indices][:, :, ::-1])  # OpenCV's order is BGR
        bar = min(round(SCALE_BAR / self.pixel), width - 20)
        if bar > 0 and height > 40:
            colour = _PALETTE[-1, ::-1].tolist()
            cv2.rectangle(picture, (10, height - 12), (9 + bar, height - 10), colour, cv2.FILLED)
            cv2.putText(picture, f"{SCALE_BAR} m", (10, height - 18), cv2.FONT_HERSHEY_SIMPLEX, 0.6, colour)
        _, content = cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])
        return MapImage(base64.b64encode(content.tobytes()).decode(), width, height, title, caption, alt)


def legend() -> Sequence[tuple[str, str]]:
    """Colours and what they mean, for a page."""
    names = {
        RIGHT: "dynamic, removed",
        GHOST: "ghost: dynamic, kept",
        HOLE: "hole: static, more removed than kept",
        UNKNOWN: "unlabelled",
    }
    listed = [("#{:02x}{:02x}{:02x}".format(*_COLOURS[layer]), name) for layer, name in names.items()]
    return [("#808088", "static, kept; brighter is higher"), *listed]


def _principal_axes(flat: F64) -> F64:
    """(2, 2) principal axes of (N, 2) points, the longest first; a rotation without mirroring."""
    _, axes = np.linalg.eigh(np.cov(flat.T) if len(flat) > 1 else np.eye(2))
    first = axes[:, 1] * (1 if axes[np.argmax(np.abs(axes[:, 1])), 1] > 0 else -1)
    return np.array([first, [-first[1], first[0]]])
