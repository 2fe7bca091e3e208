"""The errors of poses that the grounds of several scans show."""

from __future__ import annotations

import math

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F64, I64, U8, Bool
from dynaviz.spatial.scan_ground import EDGE, EXACT, FULL, NEAR, REACH, ScanGround

OTHER = EDGE  # metres: ground that differs by more, after levelling, is that of another floor
OFF = 2 * EXACT  # metres: poses whose ground agrees within the errors of both, up to ``NEAR``, stay as they are
WRAP = 8 * REACH  # cells along x and y after which the ground of earlier scans is forgotten
ROUNDS = 5  # iterations of a fit
Cells = tuple[tuple[I64, I64], F64, F64, F64, U8]  # as from ``_cells``


class Level:
    """Finds out how much the pose of a scan lifts and tilts its ground, compared with that of the scans before it.

    The error is a plane c + a dx + b dy above the world's horizontal, (3,) float64: metres, and metres per metre, with
    dx and dy from the sensor. Subtracting it from z keeps rays straight. Poses whose ground agrees stay as they are.

    Args:
        limit: metres: beyond it, levelling starts again from the pose itself.
    """

    def __init__(self, limit: float) -> None:
        self._limit = limit
        self._weight, self._height = np.zeros((WRAP, WRAP)), np.zeros((WRAP, WRAP))
        self._keys = np.full((WRAP, WRAP, 2), np.iinfo(np.int64).min)
        self._last = np.zeros(2), np.zeros(3)

    def error(self, surface: ScanGround, position: F64) -> F64:
        """(3,) float64: the error of the pose of the next scan, whose sensor is at ``position``."""
        cells = _cells(surface, position)
        found = self._fitted(cells, position)
        if abs(found[0]) > self._limit:
            self._weight[:], found = 0.0, np.zeros(3)
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
        fit = dx[known], dy[known], (z - before)[known], weight, start, EXACT, ROUNDS
        found: F64 = kernels.scan_ground.plane(*fit)
        return found if abs(found[0]) + NEAR * math.hypot(found[1], found[2]) > OFF else np.zeros(3)

    def _known(self, at: tuple[I64, I64]) -> tuple[Bool, F64]:
        """Whether earlier scans saw the ground of cells, (K,) each along x and y; and its height, metres."""
        x, y = at[0] % WRAP, at[1] % WRAP
        known = (self._weight[x, y] > 0) & (self._keys[x, y, 0] == at[0]) & (self._keys[x, y, 1] == at[1])
        return known, self._height[x, y]

    def _add(self, cells: Cells, error: F64) -> None:
        """Add the levelled ground of a scan: means in which near ground counts most."""
        at, dx, dy, z, number = cells
        z = z - error[0] - error[1] * dx - error[2] * dy
        known, before = self._known(at)
        x, y = at[0] % WRAP, at[1] % WRAP
        same = known & (np.abs(z - before) < OTHER)
        old = np.where(same, self._weight[x, y], 0.0)
        own = number / (1.0 + (dx * dx + dy * dy) / 100.0)
        self._height[x, y] = (old * np.where(same, before, 0.0) + own * z) / (old + own)
        self._weight[x, y] = old + own
        self._keys[x, y, 0], self._keys[x, y, 1] = at


def _cells(surface: ScanGround, position: F64) -> Cells:
    """The seen cells (K,) up to ``NEAR`` away: their keys, dx and dy from the sensor, height, number of points."""
    middle, far = len(surface.number) // 2, math.ceil(NEAR / EDGE) + 1
    low = max(middle - far, 0)
    rows = tuple(low + each for each in np.nonzero(surface.number[low : middle + far, low : middle + far]))
    at = rows[0] + surface.first[0], rows[1] + surface.first[1]
    dx, dy = ((key + 0.5) * EDGE - centre for key, centre in zip(at, position[:2], strict=True))
    near = dx * dx + dy * dy < NEAR * NEAR
    z, number = surface.height[rows] / 1000 + surface.z, surface.number[rows]
    return (at[0][near], at[1][near]), dx[near], dy[near], z[near], number[near]
