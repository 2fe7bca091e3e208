"""A gallery of cases: the same crop of each method's map, next to the raw map and the truth (paper,
Fig. 6).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynaviz.arrays import F64
from dynaviz.contracts.scan import ERRORS, Outcome
from dynaviz.reports.reporting import StudyOverview
from dynaviz_eval.report.birdseye import (
    Picture,
    View,
    corrected,
    has_truth,
    height_range,
    most_complete,
    principal_axes,
    raw,
    upright,
)
from dynaviz_eval.report.spots import SharedCase, Spot

SIZE = (360, 270)  # pixels of a crop, of which the page shows about half, and all in its zoom
SMALLEST = 6.0  # metres: width of the smallest crop
AROUND = 1.5  # width of a crop, in widths of the case
DEPTH = 1.0  # metres in front of and behind the case that are drawn
BARS = (1, 2, 5, 10, 20, 50)  # metres: lengths of scale bars
_OUTCOMES: dict[str, Outcome] = {**ERRORS, "removed": Outcome.UNLABELLED_REMOVED}


@dataclass(frozen=True)
class GalleryRow:
    """A case, its pictures, and from where they are taken."""

    case: SharedCase
    pictures: Sequence[Picture]
    seen_from: str


def gallery(
    cases: Sequence[SharedCase], labels: Sequence[str], found: Mapping[str, StudyOverview]
) -> list[GalleryRow]:
    """Draw each case as left by each method.

    Args:
        cases: what to draw.
        labels: of the methods, in the order of the crops.
        found: recorded maps by label.

    Returns:
        The rows; none without recorded maps.
    """
    if not found:
        return []
    reference = most_complete(found)
    rows = []
    for case in cases:
        view, seen_from = crop(case.worst, found.get(case.worst.label, reference))
        alt = f"{case.title}, seen {seen_from}"
        pictures = [view.picture(raw(reference), "before", "raw map", f"{alt}: raw map")]
        if has_truth(reference):
            pictures.append(
                view.picture(
                    corrected(reference), "truth", "dynamic in blue", f"{alt}: ground truth"
                )
            )
        for label in labels:
            if label in found:
                spot = case.spot(label)
                caption = f"{spot.verdict}: {spot.cause}" if spot else "no case here"
                drawn = view.picture(found[label], label, caption, f"{alt}: {label}, {caption}")
                pictures.append(replace(drawn, case=spot.number if spot else 0))
        rows.append(GalleryRow(case, pictures, seen_from))
    return rows


def crop(spot: Spot, overview: StudyOverview) -> tuple[View, str]:
    """A view of a case, from above or from the side, whichever shows more of it.

    Its points fill about two thirds of the width. Of what lies in front of it or behind it, only
    ``DEPTH`` is drawn.

    Returns:
        The view, and in words where the viewer is.
    """
    points = _points(spot, overview)
    turn = principal_axes(points[:, :2])
    flat = points @ upright(turn).T
    size = np.ptp(flat, axis=0)
    above = bool(size[1] >= size[2])
    axes = (
        upright(turn) if above else np.array([[*turn[0], 0.0], [0.0, 0.0, 1.0], [*-turn[1], 0.0]])
    )
    turned = points @ axes.T
    box = turned.min(0), turned.max(0)
    middle = (box[0] + box[1]) / 2
    size = box[1] - box[0]
    ratio = SIZE[0] / SIZE[1]
    width = max(SMALLEST, AROUND * float(size[0]), AROUND * ratio * float(size[1]))
    half = np.array([width, width / ratio, float(size[2]) + 2 * DEPTH]) / 2
    near = overview.points[
        np.abs(overview.points @ axes.T.astype(np.float32) - middle).max(1) < half.max()
    ]
    heights = height_range(near.astype(np.float64) if len(near) else points)
    bar = max((length for length in BARS if length <= width / 3), default=BARS[0])
    view = View(
        axes, middle - half, middle + half, heights, width / SIZE[0], bar, (box[0][:2], box[1][:2])
    )
    return view, "from above" if above else "from the side"


def _points(spot: Spot, overview: StudyOverview) -> F64:
    """(N, 3) the case's wrong points in a recorded map.

    The corners of its box if they were not recorded.
    """
    low = np.array(spot.low)
    high = np.array(spot.high)
    wrong = overview.outcome == _OUTCOMES[spot.kind]
    points: F64 = overview.points[wrong].astype(np.float64)
    points = points[((points >= low - 0.01) & (points <= high + 0.01)).all(1)]
    if len(points) < 2:
        corners = np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), -1)
        return corners.reshape(-1, 3)
    return points
