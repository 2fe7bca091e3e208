"""Pictures of a map, from above or from the side.

The ground truth, and each method's result (paper, Figs. 6, 7).
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F64, U8, Intp
from dynaviz.colours import BACKGROUND as GROUND_COLOUR
from dynaviz.colours import BRIGHT, web
from dynaviz.contracts.scan import Outcome
from dynaviz.errors import DataError
from dynaviz.reports.reporting import Study, StudyOverview
from dynaviz_eval.report.boards import ScoreBoard, best_of_each_method
from dynaviz_eval.report.table import many

MAX_SIZE = (640, 480)  # pixels
SHADES = 24  # of grey, by height
MARGIN = 2.0  # metres around the map
SCALE_BAR = 10  # metres
# metres between neighbouring points of a recorded map, which has one point per voxel of 0.2 m
GAP = 0.25
FRAME_GAP = 4  # pixels between a case and its frame
LOSSLESS = 101  # WebP quality; half the size of PNG for such pictures
# palette; shades of grey start at the last
BACKGROUND, UNKNOWN, GHOST, HOLE, RIGHT, TAKEN, FRAME, GREY = range(8)
_COLOURS = (
    GROUND_COLOUR,
    (48, 50, 58),
    BRIGHT[Outcome.FALSE_NEGATIVE],
    BRIGHT[Outcome.FALSE_POSITIVE],
    BRIGHT[Outcome.DYNAMIC_REMOVED],
    BRIGHT[Outcome.UNLABELLED_REMOVED],
    (255, 255, 255),
)
_GREYS = tuple(
    (grey, grey, grey + 8) for grey in (round(70 + 120 * k / (SHADES - 1)) for k in range(SHADES))
)
_PALETTE = np.array((*_COLOURS, *_GREYS), np.uint8)  # (7 + SHADES, 3) RGB
_STATIC = (Outcome.STATIC_KEPT, Outcome.FALSE_POSITIVE)
_DYNAMIC = (Outcome.DYNAMIC_REMOVED, Outcome.FALSE_NEGATIVE)
_CORRECTED = np.arange(len(Outcome), dtype=np.uint8)  # by outcome: the outcome of a correct answer
_CORRECTED[[Outcome.FALSE_POSITIVE, Outcome.FALSE_NEGATIVE]] = (
    Outcome.STATIC_KEPT,
    Outcome.DYNAMIC_REMOVED,
)


@dataclass(frozen=True)
class Picture:
    """A picture for a page; ``webp`` is base64-encoded, ``case`` the number of a case of its run,
    or 0.
    """

    webp: str
    width: int
    height: int
    title: str
    caption: str
    alt: str
    case: int = 0


def has_truth(overview: StudyOverview) -> bool:
    """Whether any point of the map is known to be static or dynamic."""
    return bool(np.isin(overview.outcome, (*_STATIC, *_DYNAMIC)).any())


def raw(overview: StudyOverview) -> StudyOverview:
    """The map before cleaning."""
    return StudyOverview(
        overview.points, np.full(len(overview.points), Outcome.STATIC_KEPT, np.uint8)
    )


def corrected(overview: StudyOverview) -> StudyOverview:
    """The map as a perfect method would clean it."""
    return StudyOverview(overview.points, _CORRECTED[overview.outcome])


def overviews(study: Study, board: ScoreBoard) -> tuple[dict[str, StudyOverview], list[str]]:
    """The map of the best run of each method, by label, and a sentence for each run
    that has none.
    """
    found = {}
    notes = []
    for row in best_of_each_method(board):
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
            found[row.label] = overview
    return found, notes


def most_complete(found: Mapping[str, StudyOverview]) -> StudyOverview:
    """The map with the fewest removed points.

    Points are thinned by outcome, so removed ones may be thinned twice.
    """
    removed = (Outcome.FALSE_POSITIVE, Outcome.UNLABELLED_REMOVED)
    return min(found.values(), key=lambda overview: int(np.isin(overview.outcome, removed).sum()))


def maps(board: ScoreBoard, found: Mapping[str, StudyOverview]) -> list[Picture]:
    """Draw the ground truth (without it, the raw map) and the map of each method."""
    if not found:
        return []
    reference = most_complete(found)
    view = View.of_map(reference)
    if has_truth(reference):
        alt = f"Bird's-eye map of {board.title}, with dynamic points in blue"
        pictures = [
            view.picture(
                corrected(reference), "ground truth", "the result of a perfect method", alt
            )
        ]
    else:
        alt = f"Bird's-eye map of {board.title} before cleaning"
        pictures = [view.picture(raw(reference), "before", "the raw map", alt)]
    for row in board.rows:
        if row.label in found:
            ghosts, holes = (
                row.result.counts.get(name, 0) for name in ("dynamic_kept", "static_removed")
            )
            removals = row.result.sections.removals
            caption = f"{ghosts:,} dynamic points kept, {holes:,} static points removed"
            if not row.result.has_truth:
                caption = (
                    f"{many(removals.removed, 'point')} removed" if removals else "no ground truth"
                )
            alt = f"Bird's-eye map of {board.title} as cleaned by {row.label}: {caption}"
            pictures.append(view.picture(found[row.label], row.label, caption, alt))
    return pictures


@dataclass(frozen=True, eq=False)
class View:
    """A parallel projection of a map.

    Attributes:
        axes: (3, 3), the picture's axes in the world: to the right, up, and towards the viewer.
        low, high: (3,) metres, corners in these axes. Points outside are not drawn.
        heights: heights of the darkest and of the brightest grey, metres.
        pixel: edge of a pixel, metres.
        bar: length of the scale bar, metres.
        box: low and high corner of a frame to draw, (2,) metres in the first two axes; or None.
    """

    axes: F64
    low: F64
    high: F64
    heights: tuple[float, float]
    pixel: float
    bar: int = SCALE_BAR
    box: tuple[F64, F64] | None = None

    @classmethod
    def of_map(cls, overview: StudyOverview) -> View:
        """A view from above of the labelled points, without the outermost ones.

        These would make the rest too small.

        The longest side of the map is horizontal.
        """
        known = np.isin(overview.outcome, (*_STATIC, *_DYNAMIC))
        known |= not known.any()
        points = overview.points[known].astype(np.float64)
        outcome = overview.outcome[known]
        finite = np.isfinite(points).all(1)
        points = points[finite]
        outcome = outcome[finite]
        if not len(points):
            points = np.zeros((1, 3))
            outcome = np.zeros(1, np.uint8)
        axes = upright(principal_axes(points[:, :2]))
        flat = points @ axes.T
        low, high = np.percentile(flat, [1, 99], axis=0)
        dynamic = flat[np.isin(outcome, _DYNAMIC)]
        if len(dynamic):
            low = np.minimum(low, dynamic.min(0))
            high = np.maximum(high, dynamic.max(0))
        low = low - MARGIN
        high = high + MARGIN
        low[2] = -np.inf
        high[2] = np.inf
        pixel = float(((high - low)[:2] / MAX_SIZE).max())
        return cls(axes, low, high, height_range(points), pixel)

    def draw(self, overview: StudyOverview) -> U8:
        """(rows, columns) uint8 indices into the palette. A point covers at least 3 x 3 pixels.

        A pixel is a ghost where at least as many dynamic points were kept as removed, else a hole
        where more static points were removed than kept. Without ground truth, a pixel is removed
        where more points were removed than kept.
        """
        import cv2

        at, z, outcome = self._project(overview)
        size = (self.high - self.low)[:2] / self.pixel
        shape = tuple(np.maximum(np.round(size).astype(int), 1)[::-1].tolist())
        at = np.minimum(at, np.array(shape) - 1)
        index = at[:, 0] * shape[1] + at[:, 1]
        splat = (max(3, 2 * round(GAP / self.pixel / 2) + 1),) * 2
        known = has_truth(overview)

        def count(*outcomes: Outcome) -> F64:
            """Points of some outcomes by pixel, in whole numbers."""
            counts = np.bincount(index[np.isin(outcome, outcomes)], minlength=shape[0] * shape[1])
            return counts.reshape(shape).astype(np.float64)

        def count_around(*outcomes: Outcome) -> F64:
            """Points of some outcomes in the pixels around each."""
            counts = count(*outcomes)
            return np.asarray(
                cv2.boxFilter(counts, -1, splat, normalize=False, borderType=cv2.BORDER_REPLICATE)
            )

        background = (Outcome.STATIC_KEPT,) if known else (Outcome.UNLABELLED_KEPT,)
        kept = count_around(*background)
        removed = count_around(Outcome.FALSE_POSITIVE)
        ghosts = count_around(Outcome.FALSE_NEGATIVE)
        correct = count_around(Outcome.DYNAMIC_REMOVED)
        heights = np.full(shape, -np.inf)
        chosen = np.isin(outcome, background)
        np.maximum.at(heights.reshape(-1), index[chosen], z[chosen])
        highest = cv2.dilate(heights, np.ones(splat, np.uint8))[kept > 0]
        bottom, top = self.heights
        shade = np.clip(
            (highest - bottom) / max(top - bottom, 1e-3) * SHADES, 0, SHADES - 1
        ).astype(np.uint8)

        image = np.full(shape, BACKGROUND, np.uint8)
        if known:
            image[count(Outcome.UNLABELLED_KEPT) > 0] = UNKNOWN
        image[kept > 0] = GREY + shade
        image[removed > kept] = HOLE
        image[correct > 0] = RIGHT
        image[(ghosts > 0) & (ghosts >= correct)] = GHOST
        if not known:
            image[count_around(Outcome.UNLABELLED_REMOVED) > kept] = TAKEN
        return image

    def _project(self, overview: StudyOverview) -> tuple[Intp, F64, U8]:
        """Row and column, height, and outcome of each point inside the picture."""
        with np.errstate(invalid="ignore"):  # NaN, which is outside
            turned = overview.points @ self.axes.astype(np.float32).T
        inside = np.flatnonzero(((turned >= self.low) & (turned < self.high)).all(1))
        flat = turned[inside, :2].astype(np.float64)
        column = (flat[:, 0] - self.low[0]) / self.pixel
        row = (self.high[1] - flat[:, 1]) / self.pixel
        return (
            np.stack([row, column], 1).astype(np.intp),
            overview.points[inside, 2],
            overview.outcome[inside],
        )

    def picture(self, overview: StudyOverview, title: str, caption: str, alt: str) -> Picture:
        """Draw a map as WebP, with a scale bar in the lower left corner."""
        import cv2

        indices = self.draw(overview)
        height, width = indices.shape
        if self.box is not None:
            low, high = ((corner - self.low[:2]) / self.pixel for corner in self.box)
            # so that it covers no point of the case
            low = low - FRAME_GAP
            high = high + FRAME_GAP
            top_left = (int(low[0]), int(height - high[1]))
            bottom_right = (int(high[0]), int(height - low[1]))
            cv2.rectangle(indices, top_left, bottom_right, FRAME, 2)
        picture = np.ascontiguousarray(_PALETTE[indices][:, :, ::-1])  # OpenCV's order is BGR
        bar = min(round(self.bar / self.pixel), width - 20)
        if bar > 0 and height > 40:
            scale = 0.6 if width > MAX_SIZE[0] / 2 else 0.4
            colour = _PALETTE[-1, ::-1].tolist()
            cv2.rectangle(picture, (10, height - 12), (9 + bar, height - 10), colour, cv2.FILLED)
            cv2.putText(
                picture, f"{self.bar} m", (10, height - 18), cv2.FONT_HERSHEY_SIMPLEX, scale, colour
            )
        _, content = cv2.imencode(".webp", picture, [cv2.IMWRITE_WEBP_QUALITY, LOSSLESS])
        return Picture(
            base64.b64encode(content.tobytes()).decode(), width, height, title, caption, alt
        )


def legend(known: bool = True) -> list[tuple[str, str]]:
    """Colours and what they mean, for a page; ``known``: with ground truth."""
    names = {
        RIGHT: "dynamic, removed",
        GHOST: "ghost: dynamic, kept",
        HOLE: "hole: static, more removed than kept",
        UNKNOWN: "unlabelled",
    }
    first = "static, kept; brighter is higher"
    if not known:
        names = {TAKEN: "more removed than kept"}
        first = "kept; brighter is higher"
    return [("#808088", first), *((web(_COLOURS[layer]), name) for layer, name in names.items())]


def height_range(points: F64) -> tuple[float, float]:
    """Heights between which greys vary, metres, of (N, 3) points."""
    bottom, top = np.percentile(points[:, 2], [2, 95])
    return float(bottom), float(top)


def principal_axes(flat: F64) -> F64:
    """(2, 2) principal axes of (N, 2) points, the longest first; a rotation without mirroring."""
    _, axes = np.linalg.eigh(np.cov(flat.T) if len(flat) > 1 else np.eye(2))
    first = axes[:, 1] * (1 if axes[np.argmax(np.abs(axes[:, 1])), 1] > 0 else -1)
    return np.array([first, [-first[1], first[0]]])


def upright(turn: F64) -> F64:
    """(3, 3) axes of a view from above, from the picture's (2, 2) axes in the plane."""
    axes = np.eye(3)
    axes[:2, :2] = turn
    return axes
