"""The points around some places, as sums from which planes through them are fitted."""

import math

import numpy as np
from numba import njit

_SIDE = (
    128  # columns along a side of the table of places, which wraps around: a scan may lie anywhere
)


@njit(cache=True, nogil=True)
def moments(points, asked, inner, reach):
    """(K, 10) float64: of the points in cubes around places but not in smaller cubes, from the
    middle of the cube.

    The number of points, the sums of their offsets x, y and z, and of the products xx, xy, xz, yy,
    yz and zz.

    Args:
        points: (N, 3) float32, metres.
        asked: (K, 3) float32, metres, finite: middles of the cubes.
        inner, reach: half the edges of the cubes, metres; a point on the border is inside.
            ``inner`` is -1 for none.
    """
    found = np.zeros((len(asked), 10))
    mask = _SIDE - 1
    # wider by more than rounding
    inverse = 1.0 / reach
    wide = 1.001 * reach
    # of the places whose cubes reach into a column, a list
    first = np.full(_SIDE * _SIDE, np.int64(-1))
    following = np.empty(16 * len(asked), np.int64)
    place = np.empty(16 * len(asked), np.int64)
    used = np.int64(0)
    for k in range(len(asked)):
        x = np.float64(asked[k, 0])
        y = np.float64(asked[k, 1])
        for i in range(math.floor((x - wide) * inverse), math.floor((x + wide) * inverse) + 1):
            for j in range(math.floor((y - wide) * inverse), math.floor((y + wide) * inverse) + 1):
                column = (i & mask) * _SIDE + (j & mask)
                following[used] = first[column]
                place[used] = k
                first[column] = used
                used += 1
    for i in range(len(points)):
        x = np.float64(points[i, 0])
        y = np.float64(points[i, 1])
        z = np.float64(points[i, 2])
        if not math.isfinite(x + y + z):
            continue
        entry = first[(math.floor(x * inverse) & mask) * _SIDE + (math.floor(y * inverse) & mask)]
        while entry >= 0:
            k = place[entry]
            dx = x - asked[k, 0]
            dy = y - asked[k, 1]
            dz = z - asked[k, 2]
            away = max(abs(dx), abs(dy), abs(dz))
            if inner < away <= reach:
                sums = found[k]
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
            entry = following[entry]
    return found
