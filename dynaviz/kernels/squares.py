"""Square cells of one scan, seen from above: which contain certain points or are next to them, and their level."""

import math

import numpy as np
from numba import njit

from dynaviz.kernels.keys import REACH


@njit(cache=True, nogil=True)
def _squares(points, chosen, cell):
    """The cells (N, 2) of chosen points, seen from above; and their lowest and highest indices, (2,) each."""
    cells, low, high = np.empty((len(chosen), 2), np.int64), np.array([REACH, REACH]), np.array([-REACH, -REACH])
    for i in range(len(chosen)):
        if chosen[i]:
            for axis in range(2):
                c = np.int64(math.floor(points[i, axis] / cell))
                cells[i, axis] = c
                low[axis], high[axis] = min(low[axis], c), max(high[axis], c)
    return cells, low, high


@njit(cache=True, nogil=True)
def in_or_next_to(points, chosen, among, cell):
    """(N,) bool: points in a cell, seen from above, that contains a chosen point or is adjacent to such a cell.

    Args:
        points: (N, 3) float32, metres.
        chosen: (N,) bool; chosen points must be finite.
        among: (N,) bool: the points in question, which must be finite; False for all others.
        cell: edge of a cell, metres.
    """
    found = np.zeros(len(points), np.bool_)
    cells, low, high = _squares(points, chosen, cell)
    if high[0] < low[0]:
        return found
    picture = np.zeros((high[0] - low[0] + 3, high[1] - low[1] + 3), np.bool_)
    for i in range(len(points)):
        if chosen[i]:
            for x in range(cells[i, 0] - low[0], cells[i, 0] - low[0] + 3):
                for y in range(cells[i, 1] - low[1], cells[i, 1] - low[1] + 3):
                    picture[x, y] = True
    for i in range(len(points)):
        if among[i]:
            x = np.int64(math.floor(points[i, 0] / cell)) - low[0] + 1
            y = np.int64(math.floor(points[i, 1] / cell)) - low[1] + 1
            if 0 <= x < picture.shape[0] and 0 <= y < picture.shape[1]:
                found[i] = picture[x, y]
    return found


@njit(cache=True, nogil=True)
def local_level(points, chosen, wanted, height, cell):
    """(N,) float32, metres: mean height of the chosen points in each wanted point's square cell, seen from above.

    0 in cells without chosen points, and for points that are not wanted.

    Args:
        points: (N, 3) float32, metres.
        chosen, wanted: (N,) bool; these points must be finite.
        height: (N,) float32, metres.
        cell: edge of a cell, metres.
    """
    level = np.zeros(len(points), np.float32)
    cells, low, high = _squares(points, wanted, cell)
    if high[0] < low[0]:
        return level
    number = np.zeros((high[0] - low[0] + 1, high[1] - low[1] + 1), np.int64)
    total = np.zeros(number.shape, np.int64)
    for i in range(len(points)):
        if chosen[i]:
            x = np.int64(math.floor(points[i, 0] / cell)) - low[0]
            y = np.int64(math.floor(points[i, 1] / cell)) - low[1]
            if 0 <= x < number.shape[0] and 0 <= y < number.shape[1]:
                number[x, y] += 1
                total[x, y] += np.int64(np.round(np.float64(height[i]) * 1e6))  # integers: any order
    for i in range(len(points)):
        if wanted[i]:
            x, y = cells[i, 0] - low[0], cells[i, 1] - low[1]
            if number[x, y] > 0:
                level[i] = total[x, y] / (1e6 * number[x, y])
    return level
