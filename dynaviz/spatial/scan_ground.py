"""The ground of a scan, from this scan, and the height of the sensor in those before it.

Neither reflections, nor drift, nor other floors can change it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I16, I64, U8

EDGE = 0.8  # metres: edge of a cell
REACH = (
    64  # cells to each side of the sensor; points beyond are measured from the ground at the border
)
NEAR = 30.0  # metres around the sensor: ground up to here decides what level is under it
LAYER = 0.15  # metres: height of the lowest layer of a cell, its ground
# metres: what is lower by more, a layer in between, than most cells around is a reflection
PIT = 2 * LAYER
# metres per metre: maximum incline of the ground of a scan, and its maximum slope beyond that
# incline
SLOPE = 0.1
# both of them: steepest ground, as seen from the sensor; steeper are objects and reflections
STEEP = 2 * SLOPE
CLIFF = (
    1.0  # metres per metre: slope around what lies too low for it, such as a road below a bridge
)
EXACT = 0.05  # metres: error of the ground; what is higher stands out of it
FULL = 5  # points: cells with fewer count less
ROUNDS = 5  # iterations of a fit
Cells = tuple[tuple[I64, I64], F64, F64, F64, U8]  # as from ``ScanGround.cells``


@dataclass(frozen=True, eq=False)
class ScanGround:
    """The ground that one scan shows.

    Attributes:
        height: (X, X) int16, millimetres above the sensor, of square cells of ``EDGE``; 32767 if no
            ground is known.
        number: (X, X) uint8: points of the scan on the ground, at most 255.
        first: (2,) int64: the first cell, counted from the world's origin.
        z: metres, world frame: height of the sensor.
        sensor_height: metres: of the sensor above the ground under it; minus infinity if unknown.
    """

    height: I16
    number: U8
    first: I64
    z: float
    sensor_height: float

    @classmethod
    def of(
        cls, points: F32, position: F64, reach: int = REACH, height_before: float = -math.inf
    ) -> ScanGround:
        """The ground around the sensor, grown from the level below it.

        The lowest layers that slopes can reach. What lies below ground that is seen, on a ray
        that passes below it, is a reflection. What lies too low, but may be seen past the ground,
        lowers the surface only around it.

        Args:
            points: (N, 3) float32, metres, world frame, z up: of one scan.
            position: (3,) float64, metres, world frame: the sensor's.
            reach: cells to each side of it, a power of two.
            height_before: height of the sensor above the ground in earlier scans, metres; minus
                infinity if unknown. What lies lower is taken for ground only if hardly anything
                is there.
        """
        points = kernels.as_readonly(points, np.float32)
        position = kernels.as_readonly(position, np.float64)
        k = kernels.scan_ground
        z = float(position[2])
        cells, wide, first = k.cells_of(points, position, reach, EDGE)
        with np.errstate(invalid="ignore"):
            heights = points[:, 2] - np.float32(z)
        reach_of = kernels.ground_reach
        low = k.lowest(heights, cells, wide)
        under = reach_of.level(low, math.ceil(NEAR / EDGE), LAYER, -height_before)
        least = reach_of.lowest_possible(low, under, EDGE, STEEP, PIT)
        layers, number = k.lowest_layers(heights, cells, least, LAYER)
        for _ in range(
            2
        ):  # reflections next to each other look like ground, until those below the others are gone
            layers[k.pits(layers, PIT)] = np.inf
        slopes = EDGE, STEEP, SLOPE, PIT
        ground, gap, cut = reach_of.reached(layers, under, *slopes)
        if cut.any():  # ground above reflections in the same cell
            above = k.lowest_layers(heights, cells, np.where(cut, ground - PIT, np.inf), LAYER)
            again = cut & (above[0] <= ground + SLOPE * EDGE * (1 + gap) + LAYER / 2)
            layers[again] = above[0][again]
            number[again] = above[1][again]
            ground, gap, cut = reach_of.reached(layers, under, *slopes)
        layers[reach_of.reflections(layers, ground, gap, cut, PIT)] = np.inf
        deep = np.where(cut, layers, np.inf)
        layers[cut] = np.inf
        surface = k.lowered(k.surface_of(layers, STEEP * EDGE, SLOPE * EDGE), deep, CLIFF * EDGE)
        layers = np.minimum(layers, deep)
        number = np.where(
            (layers < np.inf) & (layers <= surface + EXACT), np.minimum(number, 255), 0
        ).astype(np.uint8)
        weight = np.minimum(number, FULL) / FULL
        height = np.clip(np.rint(1000 * _filled(surface, weight)), -k.UNKNOWN, k.UNKNOWN).astype(
            np.int16
        )
        return cls(height, number, first, z, -under)

    def heights(self, points: F32) -> F32:
        """(N,) float32, metres: height of points (N, 3), world frame, above the ground.

        Infinite if unknown.
        """
        where = self.z, self.first, self.height, EDGE
        found: F32 = kernels.scan_ground.above(kernels.as_readonly(points, np.float32), *where)
        return found

    def cells(self, position: F64) -> Cells:
        """The cells (K,) that show ground up to ``NEAR`` away.

        Keys, dx and dy from the sensor, height, points.
        """
        middle = len(self.number) // 2
        far = math.ceil(NEAR / EDGE) + 1
        low = max(middle - far, 0)
        rows = tuple(
            low + each for each in np.nonzero(self.number[low : middle + far, low : middle + far])
        )
        at = rows[0] + self.first[0], rows[1] + self.first[1]
        dx, dy = ((key + 0.5) * EDGE - centre for key, centre in zip(at, position[:2], strict=True))
        near = dx * dx + dy * dy < NEAR * NEAR
        z = self.height[rows] / 1000 + self.z
        number = self.number[rows]
        return (at[0][near], at[1][near]), dx[near], dy[near], z[near], number[near]


def weights(dx: F64, dy: F64, number: U8) -> F64:
    """(K,) float64: weights of cells, from their distance along x and y, metres, and points.

    Near ones count most.
    """
    found: F64 = number / (1.0 + (dx * dx + dy * dy) / 100.0)
    return found


def _filled(z: F64, weight: F64) -> F64:
    """Add to cells (X, X) of less than full weight the mean of ever larger squares around them.

    Pull and push.

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
