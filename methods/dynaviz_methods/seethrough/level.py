"""The errors of poses that the grounds of several scans show."""

from __future__ import annotations

import math

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F64, I64, Bool
from dynaviz.spatial.scan_ground import (
    EDGE,
    EXACT,
    FULL,
    NEAR,
    REACH,
    ROUNDS,
    Cells,
    ScanGround,
    weights,
)

OTHER = EDGE  # metres: ground that differs by more, after levelling, is that of another floor
# metres: poses whose ground agrees within the errors of both, up to ``NEAR``, stay as they are
OFF = 2 * EXACT
# square metres: weight of a pose's own incline; that of a cell of ground grows with its squared
# distance
INCLINE = 1e5
WRAP = 8 * REACH  # cells along x and y after which the ground of earlier scans is forgotten


class Level:
    """Finds out how much the pose of a scan lifts and tilts its ground, compared with that of the
    scans before it.

    The error is a plane c + a dx + b dy above the world's horizontal, (3,) float64: metres, and
    metres per metre, with dx and dy from the sensor. Subtracting it from z keeps rays straight.
    Poses whose ground agrees stay as they are.

    Args:
        limit: metres: beyond it, levelling starts again from the pose itself.
    """

    def __init__(self, limit: float) -> None:
        self._limit = limit
        self._weight = np.zeros((WRAP, WRAP))
        self._height = np.zeros((WRAP, WRAP))
        self._keys = np.full((WRAP, WRAP, 2), np.iinfo(np.int64).min)
        self._last = np.zeros(2), np.zeros(3)

    def error(self, surface: ScanGround, position: F64) -> F64:
        """(3,) float64: the error of the pose of the next scan, whose sensor is at ``position``."""
        cells = surface.cells(position)
        found = self._fitted(cells, position)
        if abs(found[0]) > self._limit:
            self._weight[:] = 0.0
            found = np.zeros(3)
        self._add(cells, found)
        self._last = position[:2].copy(), found
        return found

    def _fitted(self, cells: Cells, position: F64) -> F64:
        place, error = self._last
        dx, dy = position[:2] - place
        start = np.array([error[0] + error[1] * dx + error[2] * dy, error[1], error[2]])
        at, dx, dy, z, number = cells
        known, before = self._known(at)
        known &= np.abs(z - start[0] - start[1] * dx - start[2] * dy - before) < OTHER
        if not known.any():
            return np.array([start[0], 0.0, 0.0])
        weight = np.minimum(number[known], 2 * FULL).astype(np.float64)
        fit = dx[known], dy[known], (z - before)[known], weight, start, INCLINE, EXACT, ROUNDS
        found: F64 = kernels.scan_ground.plane(*fit)
        return found if abs(found[0]) + NEAR * math.hypot(found[1], found[2]) > OFF else np.zeros(3)

    def _known(self, at: tuple[I64, I64]) -> tuple[Bool, F64]:
        """Whether earlier scans saw the ground of cells, (K,) each along x and y.

        And its height, metres.
        """
        x = at[0] % WRAP
        y = at[1] % WRAP
        known = (
            (self._weight[x, y] > 0)
            & (self._keys[x, y, 0] == at[0])
            & (self._keys[x, y, 1] == at[1])
        )
        return known, self._height[x, y]

    def _add(self, cells: Cells, error: F64) -> None:
        """Add the levelled ground of a scan: means in which near ground counts most."""
        at, dx, dy, z, number = cells
        z = z - error[0] - error[1] * dx - error[2] * dy
        known, before = self._known(at)
        x = at[0] % WRAP
        y = at[1] % WRAP
        same = known & (np.abs(z - before) < OTHER)
        old = np.where(same, self._weight[x, y], 0.0)
        own = weights(dx, dy, number)
        self._height[x, y] = (old * np.where(same, before, 0.0) + own * z) / (old + own)
        self._weight[x, y] = old + own
        self._keys[x, y, 0], self._keys[x, y, 1] = at
