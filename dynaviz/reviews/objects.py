"""Moving points as objects with a number over time, and their boxes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynaviz.arrays import F32, F64, U16
from dynaviz.reviews.candidates import joined

EDGE = 0.4  # metres: points in cells that touch, also from one frame to the next, are one object
MOST = (1 << 16) - 1  # numbers that a label file can store
TURNS = np.radians(np.arange(0.0, 90.0, 1.0))  # of a box, that are tried


def numbered(moving: Sequence[F32]) -> list[U16]:
    """Numbers of objects.

    Args:
        moving: (N, 3) float32, metres, world frame, for each frame: its moving points.

    Returns:
        (N,) uint16 for each frame: 1 for the object with most points; 0 for those beyond ``MOST``.
    """
    lengths = [len(points) for points in moving]
    if not sum(lengths):
        return [np.zeros(0, np.uint16) for _ in moving]
    frame = np.repeat(np.arange(len(lengths), dtype=np.int32), lengths)
    cell = np.floor(np.concatenate(moving).astype(np.float64) / EDGE).astype(np.int32)
    rows, inverse = np.unique(np.column_stack([frame, cell]), axis=0, return_inverse=True)
    objects = joined(rows[:, 0], rows[:, 1:])[inverse.ravel()]
    order = np.argsort(-np.bincount(objects), kind="stable")
    numbers = np.empty(len(order), np.int64)
    numbers[order] = np.arange(1, len(order) + 1)
    numbers[numbers > MOST] = 0
    return np.split(numbers[objects].astype(np.uint16), np.cumsum(lengths)[:-1])


def box_around(xyz: F64) -> tuple[F64, F64, float]:
    """The box with the smallest area from above that contains (N, 3) points, metres.

    Returns:
        (3,) middle; (3,) length, width and height, metres; and the angle from the x axis to the
        length, radians, from -pi/2 to pi/2.
    """
    origin = xyz.mean(0)
    best = (np.inf, 0.0)
    for turn in TURNS.tolist():
        flat = (xyz[:, :2] - origin[:2]) @ _turned(turn)
        size = np.ptp(flat, axis=0)
        best = min(best, (float(size[0] * size[1]), turn))
    turn = best[1]
    axes = _turned(turn)
    flat = (xyz[:, :2] - origin[:2]) @ axes
    size = np.append(np.ptp(flat, axis=0), np.ptp(xyz[:, 2]))
    middle = np.append(
        origin[:2] + axes @ ((flat.min(0) + flat.max(0)) / 2),
        (xyz[:, 2].min() + xyz[:, 2].max()) / 2,
    )
    if size[1] > size[0]:
        size = size[[1, 0, 2]]
        turn += np.pi / 2
    return middle, size, float(turn - np.pi if turn > np.pi / 2 else turn)


def _turned(angle: float) -> F64:
    """(2, 2), columns: axes at an angle from x and y."""
    cosine = np.cos(angle)
    sine = np.sin(angle)
    return np.array([[cosine, -sine], [sine, cosine]])
