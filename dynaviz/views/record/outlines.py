"""Where cases are in range images and polar grids."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import rerun as rr

from dynaviz import colours
from dynaviz.arrays import F32, F64
from dynaviz.contracts.probe import ImageSpan, PolarGrid, RangeImage, Value
from dynaviz.contracts.scan import Outcome
from dynaviz.views.record import states

SPARE = 1.5  # pixels between a case and its outline
WIDTH = rr.Radius.ui_points(1.2)
FRONT = 12.0  # drawn over the rings of a polar grid


class FlatStates:
    """The states of a run that are drawn as pictures, and how places map into each."""

    def __init__(self) -> None:
        self._images: dict[str, tuple[ImageSpan, tuple[int, int, int]]] = {}
        self._grids: dict[str, float] = {}

    def add(self, path: str, value: Value) -> None:
        """Remember a picture.

        Args:
            path: where it is drawn.
            value: as the method emitted it.
        """
        if isinstance(value, PolarGrid):
            self._grids[path] = value.max_range
        elif isinstance(value, RangeImage) and value.span is not None and value.ranges.size:
            rows, columns = value.ranges.shape
            self._images[path] = value.span, (rows, columns, states.repeated(rows, columns))

    @property
    def paths(self) -> list[str]:
        """Of the pictures in which places are known."""
        return [*self._images, *self._grids]

    def outline(self, path: str, low: F64, high: F64, T_world_sensor: F64) -> F32 | None:
        """(5, 2) float32, pixels: a closed rectangle around a box; None if it is out of view.

        Args:
            path: of the picture.
            low, high: (3,) metres, world frame.
            T_world_sensor: (4, 4) pose of the sensor when the picture was made.
        """
        corners = np.array(list(product(*zip(low, high, strict=True))), np.float64)
        if path in self._grids:
            return _in_grid(corners - T_world_sensor[:3, 3], self._grids[path])
        local = (corners - T_world_sensor[:3, 3]) @ T_world_sensor[:3, :3]
        return _in_image(local, *self._images[path])


STYLE = rr.LineStrips2D.from_fields(radii=WIDTH, draw_order=FRONT)  # the same for all


def drawn(outline: F32, outcome: Outcome) -> Any:
    """The archetype to log for an outline."""
    return rr.LineStrips2D.from_fields(strips=[outline], colors=[colours.BRIGHT[outcome]])


def _in_grid(offset: F64, max_range: float) -> F32 | None:
    half = states.PICTURE / 2
    x = half * (1 + offset[:, 0] / max_range)
    y = half * (1 - offset[:, 1] / max_range)
    return _rectangle(x, y, (states.PICTURE, states.PICTURE))


def _in_image(local: F64, span: ImageSpan, size: tuple[int, int, int]) -> F32 | None:
    """The rectangle of a box; size: rows, columns, and how often each row is drawn.

    Of a box that the left and the right border of the image cut, the larger part.
    """
    rows, columns, repeated = size
    azimuth = np.arctan2(local[:, 1], local[:, 0])
    elevation = np.arctan2(local[:, 2], np.hypot(local[:, 0], local[:, 1]))
    middle = np.arctan2(np.sin(azimuth).mean(), np.cos(azimuth).mean())
    about = middle + np.angle(np.exp(1j * (azimuth - middle)))  # continuous over the box
    centre = (span.left + span.right) / 2
    about += 2 * np.pi * np.round((centre - middle) / (2 * np.pi))
    x = columns * (about - span.left) / (span.right - span.left)
    y = rows * (elevation - span.top) / (span.bottom - span.top)
    return _rectangle(x, y * repeated, (columns, rows * repeated), repeated)


def _rectangle(x: F64, y: F64, size: tuple[int, int], row: int = 1) -> F32 | None:
    """Around pixels, cut at the border of the picture; None if nothing is left.

    Args:
        x, y: of corners, pixels.
        size: width and height of the picture.
        row: height of one of its rows, pixels.
    """
    width, height = size
    left, right = np.clip((x.min() - SPARE, x.max() + SPARE), 0, width)
    top, bottom = np.clip((y.min() - SPARE * row, y.max() + SPARE * row), 0, height)
    if right - left < 1 or bottom - top < 1:
        return None
    corners = [(left, top), (right, top), (right, bottom), (left, bottom), (left, top)]
    return np.array(corners, np.float32)
