"""Square cells of one scan, seen from above: which contain certain points or are next to them."""

import math

import numpy as np
from numba import njit

from dynaviz.kernels.keys import REACH


@njit(cache=True, nogil=True, inline="always")
def _cell(point, cell, first):
    """The cell of a point along x and y, counted from the cell ``first``."""
    return np.int64(math.floor(point[0] / cell)) - first[0], np.int64(
        math.floor(point[1] / cell)
    ) - first[1]


@njit(cache=True, nogil=True)
def in_or_next_to(points, chosen, among, cell):
    """(N,) bool: points in a cell, seen from above, that contains a chosen point or is adjacent to
    such a cell.

    Args:
        points: (N, 3) float32, metres.
        chosen: (N,) bool; chosen points must be finite.
        among: (N,) bool: the points in question, which must be finite; False for all others.
        cell: edge of a cell, metres.
    """
    low = np.array([REACH, REACH])
    high = np.array([-REACH, -REACH])
    for i in range(len(points)):
        if chosen[i]:
            for axis in range(2):
                c = np.int64(math.floor(points[i, axis] / cell))
                low[axis] = min(low[axis], c)
                high[axis] = max(high[axis], c)
    found = np.zeros(len(points), np.bool_)
    if high[0] < low[0]:
        return found
    picture = np.zeros((high[0] - low[0] + 3, high[1] - low[1] + 3), np.bool_)
    first = low - 1
    for i in range(len(points)):
        if chosen[i]:
            x, y = _cell(points[i], cell, first)
            for u in range(x - 1, x + 2):
                for v in range(y - 1, y + 2):
                    picture[u, v] = True
    for i in range(len(points)):
        if among[i]:
            x, y = _cell(points[i], cell, first)
            if 0 <= x < picture.shape[0] and 0 <= y < picture.shape[1]:
                found[i] = picture[x, y]
    return found
