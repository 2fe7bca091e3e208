"""Pictures of points, drawn without a viewer and without a graphics card."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from dynaviz import colours
from dynaviz.arrays import F32, F64, U8
from dynaviz.contracts.scan import Outcome
from dynaviz.views.read.focus import ASIDE, CLOSEST, FIELD_OF_VIEW, distance_to
from dynaviz.views.read.reader import DrawnPoints

NEAREST = 0.5  # metres: what is nearer to the eye is not drawn
SPARE = 4  # pixels between a box and its outline
SHADES = np.array([colours.BRIGHT[outcome] for outcome in Outcome], np.uint8)


class Still:
    """A picture of a box and what is around it, from where the first view of a case looks.

    Args:
        low, high: (3,) float64, metres, world frame: the box.
        size: width and height, pixels.
        closest: metres between the eye and the middle of a small box.

    Attributes:
        pixels: (height, width, 3) uint8, RGB.
    """

    def __init__(
        self, low: F64, high: F64, size: tuple[int, int], closest: float = CLOSEST
    ) -> None:
        width, height = size
        self._low = low
        self._high = high
        self._size = size
        self._distance = distance_to(low, high, closest)
        self.pixels = np.full((height, width, 3), colours.BACKGROUND, np.uint8)

    def draw(self, xyz: F32, outcome: U8, front: Outcome | None) -> None:
        """Draw points.

        Args:
            xyz: (N, 3) float32, metres, world frame.
            outcome: (N,) of the points, which gives them their colours.
            front: points with this outcome are drawn over all others; None for nearer over farther.
        """
        width, height = self._size
        column, row, depth = self._place(xyz)
        with np.errstate(invalid="ignore"):
            shown = np.flatnonzero(
                (depth > NEAREST)
                & (np.abs(2 * column - width) < width)
                & (np.abs(2 * row - height) < height)
            )
        order = np.lexsort((-depth[shown], outcome[shown] == front))
        shown = shown[order]
        x = column[shown].astype(int)
        y = row[shown].astype(int)
        shades = SHADES[outcome[shown]]
        for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
            self.pixels[np.minimum(y + dy, height - 1), np.minimum(x + dx, width - 1)] = shades

    def outline(self) -> None:
        """Draw a thin rectangle around the box."""
        import cv2

        corners = np.array(list(product(*zip(self._low, self._high, strict=True))))
        column, row, _ = self._place(corners)
        first = (int(column.min()) - SPARE, int(row.min()) - SPARE)
        last = (int(column.max()) + SPARE, int(row.max()) + SPARE)
        cv2.rectangle(self.pixels, first, last, colours.LABEL, 1)

    def _place(self, xyz: F32 | F64) -> tuple[F64, F64, F64]:
        """Column, row and depth of points: pixels and metres."""
        width, height = self._size
        (ahead, right, up) = _axes()
        offset = xyz - (self._low + self._high) / 2 + self._distance * ahead
        depth = offset @ ahead
        scale = height / 2 / np.tan(np.radians(FIELD_OF_VIEW / 2))
        with np.errstate(divide="ignore", invalid="ignore"):
            column = width / 2 + scale * (offset @ right) / depth
            row = height / 2 - scale * (offset @ up) / depth
        return column, row, depth


def with_map(kept: F32, drawn: DrawnPoints | None) -> tuple[F32, U8]:
    """Points of a map and of a frame, (N, 3) float32, metres, world frame, and their outcomes."""
    outcome = np.full(len(kept), Outcome.STATIC_KEPT, np.uint8)
    if drawn is None:
        return kept, outcome
    return np.concatenate([kept, drawn.xyz]), np.concatenate([outcome, drawn.outcome])


def spread(frames: Sequence[int], worst: int, most: int) -> list[int]:
    """Some of the frames of a case, in order and evenly spread, the worst one among them.

    Args:
        frames: positions in the run, at least one.
        worst: kept if it is one of them.
        most: frames to choose, at most.
    """
    known = np.unique(np.asarray(frames))
    chosen = known[np.unique(np.linspace(0, len(known) - 1, most).round().astype(int))]
    if worst in known and worst not in chosen:
        chosen[np.argmin(np.abs(chosen[1:-1] - worst)) + 1] = worst
    return np.unique(chosen).tolist()  # type: ignore[no-any-return]


def _axes() -> F64:
    """(3, 3) unit vectors of the eye on a case: ahead, to the right, and up."""
    ahead = -ASIDE / np.linalg.norm(ASIDE)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.stack([ahead, right, np.cross(right, ahead)])
