"""Height above the local ground, from a single scan."""

import math

import numpy as np
from numba import njit

_SIDE = 512  # cells along a side; the grid wraps around, so a scan may lie anywhere
_KEEP = 5  # number of lowest points stored per cell


@njit(cache=True, nogil=True)
def above_ground(points, size):
    """(N,) float32, metres: height of each point (N, 3) above the ground of its cell, of edge ``size`` metres.

    The ground of a cell is the fifth lowest point of the 3 x 3 cells around it, or the lower quartile if these contain
    fewer than 20 points, so a few points below the ground do not matter.
    """
    counts = np.zeros((_SIDE, _SIDE), np.int32)
    lows = np.empty((_SIDE, _SIDE, _KEEP), np.float32)
    grounds = np.full((_SIDE, _SIDE), np.float32(np.nan))
    inverse = 1.0 / size
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if not math.isfinite(x + y + z):
            continue
        a, b = math.floor(x * inverse) & (_SIDE - 1), math.floor(y * inverse) & (_SIDE - 1)
        k = min(counts[a, b], _KEEP)
        counts[a, b] += 1
        if k == _KEEP:
            if z >= lows[a, b, _KEEP - 1]:
                continue
            k = _KEEP - 1
        while k > 0 and lows[a, b, k - 1] > z:
            lows[a, b, k] = lows[a, b, k - 1]
            k -= 1
        lows[a, b, k] = z
    heights = np.full(len(points), np.float32(np.nan))
    pool = np.empty(_KEEP + 1, np.float32)  # the lowest points of nine cells, and room for one more
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if not math.isfinite(x + y + z):
            continue
        a, b = math.floor(x * inverse) & (_SIDE - 1), math.floor(y * inverse) & (_SIDE - 1)
        if math.isnan(grounds[a, b]):
            n = 0
            total = 0
            for da in range(-1, 2):
                for db in range(-1, 2):
                    c, d = (a + da) & (_SIDE - 1), (b + db) & (_SIDE - 1)
                    total += counts[c, d]
                    for k in range(min(counts[c, d], _KEEP)):
                        low, at = lows[c, d, k], n
                        while at > 0 and pool[at - 1] > low:
                            pool[at] = pool[at - 1]
                            at -= 1
                        pool[at] = low
                        n = min(n + 1, _KEEP)
            grounds[a, b] = pool[min(total // 4, _KEEP - 1)]
        heights[i] = z - grounds[a, b]
    return heights
