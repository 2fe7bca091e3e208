"""The ground of each scan, from this scan alone, and the errors of poses that the grounds of several scans show."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I16, I64, U8, Bool
from dynaviz.contracts.scan import Scan

EDGE = 0.8  # metres: edge of a cell
REACH = 64  # cells to each side of the sensor; points beyond are measured from the ground at the border
NEAR = 30.0  # metres around the sensor: ground up to here decides what level is under it, and how a scan is levelled
LAYER = 0.15  # metres: height of the lowest layer of a cell, its ground
PIT = 2 * LAYER  # metres: what is lower by more, a layer in between, than most cells around is a reflection
SLOPE = 0.1  # metres per metre: maximum incline of the ground of a scan, and its maximum slope beyond that incline
STEEP = 2 * SLOPE  # both of them: steepest ground, as seen from the sensor; steeper are objects and reflections
EXACT = 0.05  # metres: error of the ground; what is higher stands out of it
FULL = 5  # points: cells with fewer count less

OTHER = EDGE  # metres: ground that differs by more, after levelling, is that of another floor
OFF = 2 * EXACT  # metres: poses whose ground agrees within the errors of both, up to ``NEAR``, stay as they are
WRAP = 8 * REACH  # cells along x and y after which the ground of earlier scans is forgotten
ROUNDS = 5  # iterations of a fit
Cells = tuple[tuple[I64, I64], F64, F64, F64, U8]  # as from ``_cells``


@dataclass(frozen=True, eq=False)
class ScanGround:
    """The ground that one scan shows.

    Attributes:
        height: (X, X) int16, millimetres above the sensor, of square cells of ``EDGE``; 32767 if no ground is known.
        number: (X, X) uint8: points of the scan on the ground, at most 255.
        first: (2,) int64: the first cell, counted from the world's origin.
        z: metres, world frame: height of the sensor.
    """

    height: I16
    number: U8
    first: I64
    z: float

    @classmethod
    def of(cls, scan: Scan) -> ScanGround:
        """The ground around the sensor, grown from the level below it: the lowest layers that slopes can reach."""
        points, position = kernels.as_readonly(scan.points, np.float32), kernels.as_readonly(scan.position, np.float64)
        k, z = kernels.scan_ground, float(scan.position[2])
        cells, wide, first = k.cells_of(points, position, REACH, EDGE)
        with np.errstate(invalid="ignore"):
            heights = points[:, 2] - np.float32(z)
        lowest, number = k.lowest_layers(heights, cells, wide, EDGE, LAYER, STEEP, PIT, math.ceil(NEAR / EDGE))
        for _ in range(2):  # reflections next to each other look like ground, until those below the others are gone
            lowest[k.pits(lowest, PIT)] = np.inf
        surface = k.surface_of(lowest, STEEP * EDGE, SLOPE * EDGE)
        number = np.where((lowest < np.inf) & (lowest <= surface + EXACT), np.minimum(number, 255), 0).astype(np.uint8)
        weight = np.minimum(number, FULL) / FULL
        height = np.clip(np.rint(1000 * _filled(surface, weight)), -k.UNKNOWN, k.UNKNOWN).astype(np.int16)
        return cls(height, number, first, z)

    def heights(self, points: F32) -> F32:
        """(N,) float32, metres: height of points (N, 3), world frame, above the ground; infinite if unknown."""
        where = self.z, self.first, self.height, EDGE
        found: F32 = kernels.scan_ground.above(kernels.as_readonly(points, np.float32), *where)
        return found


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


def _filled(z: F64, weight: F64) -> F64:
    """Add to cells (X, X) of less than full weight the mean of ever larger squares around them: pull and push.

    X is a power of two.
    """
    import cv2

    if len(z) == 1 or not weight.any():
        return z
    half = (len(z) // 2,) * 2
    total = 4 * cv2.resize(weight, half, interpolation=cv2.INTER_AREA)
    summed = 4 * cv2.resize(weight * z, half, interpolation=cv2.INTER_AREA)
    coarse = _filled(summed / np.where(total > 0, total, 1.0), np.minimum(total, 1.0))
    around = cv2.resize(coarse, z.shape, interpolation=cv2.INTER_LINEAR)
    found: F64 = weight * z + (1 - weight) * around
    return found


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
