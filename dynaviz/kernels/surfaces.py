"""The points around some places, as sums from which planes through them are fitted."""

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def moments(points, asked, reaches):
    """(K, R, 10) float64: of the points in cubes around places, from the middle of the cube.

    The number of points, the sums of their offsets x, y and z, and of the products xx, xy, xz, yy, yz and zz.

    Args:
        points: (N, 3) float32, metres.
        asked: (K, 3) float32, metres: middles of the cubes, sorted by x.
        reaches: (R,) float64, metres: half the edges of the cubes, ascending.
    """
    found, far = np.zeros((len(asked), len(reaches), 10)), reaches[-1]
    for i in range(len(points)):
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        if not math.isfinite(x + y + z):
            continue
        k, end = 0, len(asked)
        while k < end:
            middle = (k + end) // 2
            if asked[middle, 0] < x - far:
                k = middle + 1
            else:
                end = middle
        while k < len(asked) and asked[k, 0] <= x + far:
            dx, dy, dz = x - asked[k, 0], y - asked[k, 1], z - asked[k, 2]
            away = max(abs(dx), abs(dy), abs(dz))
            if away <= far:
                r = 0
                while away > reaches[r]:
                    r += 1
                sums = found[k, r]
                sums[0] += 1
                sums[1] += dx
                sums[2] += dy
                sums[3] += dz
                sums[4] += dx * dx
                sums[5] += dx * dy
                sums[6] += dx * dz
                sums[7] += dy * dy
                sums[8] += dy * dz
                sums[9] += dz * dz
            k += 1
    for r in range(1, len(reaches)):
        for k in range(len(asked)):
            for column in range(10):
                found[k, r, column] += found[k, r - 1, column]
    return found
