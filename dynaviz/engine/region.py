"""Regions of interest in the coordinates of a map: a box or a polygon."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynaviz.arrays import F64, Bool
from dynaviz.errors import DataError, UsageError
from dynaviz.io.atomic import open_file

_HINT = (
    "Give X0,Y0,X1,Y1 or X0,Y0,Z0,X1,Y1,Z1 for a box, or a file with a corner of the polygon per "
    "line (X Y)"
)


def _corners(path: Path) -> F64:
    """(K, 2) float64: the numbers in a text file, separated by spaces or commas."""
    with open_file(path, _HINT) as file:
        text = file.read().decode("latin-1")
    lines = [re.split(r"[,\s]+", line.strip()) for line in text.splitlines() if line.strip()]
    try:
        corners = np.array([[float(word) for word in line] for line in lines])
        if corners.shape != (len(lines), 2) or not np.isfinite(corners).all():
            raise ValueError(corners.shape)
    except ValueError:
        raise DataError(path, "is not a list of corners", hint=_HINT) from None
    return corners


@dataclass(frozen=True, eq=False)
class Region:
    """A part of the world.

    Attributes:
        low, high: (3,) float64, metres: bounds.
        polygon: (K, 2) float64, metres: corners in the plane; None for a box.
    """

    low: F64
    high: F64
    polygon: F64 | None = None

    @classmethod
    def parse(cls, text: str) -> Region:
        """Read ``X0,Y0,X1,Y1`` (all heights), ``X0,Y0,Z0,X1,Y1,Z1``, or a file with a corner ``X
        Y`` per line.

        Raises:
            UsageError: for anything else.
            DataError: for a file that cannot be read.
        """
        if Path(text).is_file():
            return cls._of_corners(text, _corners(Path(text)))
        try:
            numbers = np.array([float(word) for word in re.split(r"[,\s]+", text.strip())])
        except ValueError:
            raise UsageError(f"--region {text}: neither numbers nor a file. {_HINT}") from None
        if len(numbers) not in (4, 6) or not np.isfinite(numbers).all():
            raise UsageError(f"--region {text}: has {len(numbers)} numbers. {_HINT}")
        corners = numbers.reshape(2, -1)
        low = np.full(3, -np.inf)
        high = np.full(3, np.inf)
        low[: corners.shape[1]] = corners.min(0)
        high[: corners.shape[1]] = corners.max(0)
        return cls(low, high)

    @classmethod
    def _of_corners(cls, path: str, corners: F64) -> Region:
        if len(corners) < 3:
            raise UsageError(f"--region {path}: a polygon needs at least 3 corners. {_HINT}")
        low = np.append(corners.min(0), -np.inf)
        high = np.append(corners.max(0), np.inf)
        return cls(low, high, corners)

    def contains(self, xyz: F64) -> Bool:
        """(N,) bool: which of (N, 3) points, metres, are inside."""
        inside: Bool = np.ones(len(xyz), np.bool_)
        for axis in range(3):
            inside &= (xyz[:, axis] >= self.low[axis]) & (xyz[:, axis] <= self.high[axis])
        if self.polygon is not None:
            inside &= in_polygon(xyz[:, 0], xyz[:, 1], self.polygon)
        return inside


def in_polygon(x: F64, y: F64, corners: F64) -> Bool:
    """(N,) bool: which points, (N,) metres each, are in a polygon of (K, 2) corners.

    A line from there along x crosses its edges an odd number of times.
    """
    inside: Bool = np.zeros(len(x), np.bool_)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, 1, axis=0), strict=True):
        if y0 != y1:
            inside ^= ((y0 > y) != (y1 > y)) & (x < x0 + (y - y0) * ((x1 - x0) / (y1 - y0)))
    return inside
