"""Which points of a scan lie next to points of another kind, by cells or by columns."""

import math

import numpy as np
from numba import njit

from dynaviz.arrays import F32, F64, I64, Bool
from dynaviz.kernels.hash_table import first_slot, slot_of
from dynaviz.kernels.keys import REACH, X_SHIFT, Y_SHIFT

_SIDE = 1024  # columns along a side; the picture wraps around, so a scan may lie anywhere
_REACHED = 512  # the same, of the columns near points


@njit(cache=True, nogil=True, inline="always")
def _key(x: float, y: float, z: float) -> np.int64:
    """The packed cell of a point given in cells, -1 if it is not finite or out of range."""
    if not (abs(x) < REACH - 2 and abs(y) < REACH - 2 and abs(z) < REACH - 2):
        return np.int64(-1)
    i = np.int64(math.floor(x))
    j = np.int64(math.floor(y))
    k = np.int64(math.floor(z))
    return (i + REACH) << X_SHIFT | (j + REACH) << Y_SHIFT | (k + REACH)


@njit(cache=True, nogil=True)
def _any_around(table: I64, key: np.int64) -> bool:
    """Whether a cell or one of the 26 cells around it is in the table."""
    mask = len(table) - 1
    for dx in range(-1, 2):
        for dy in range(-1, 2):
            for dz in range(-1, 2):
                near = key + (np.int64(dx) << X_SHIFT) + (np.int64(dy) << Y_SHIFT) + np.int64(dz)
                s = first_slot(near, mask)
                while table[s] >= 0:
                    if table[s] == near:
                        return True
                    s = (s + 1) & mask
    return False


@njit(cache=True, nogil=True)
def cells(points: F32, chosen: Bool, others: Bool, size: float) -> Bool:
    """(N,) bool: chosen points with other points in their cell, or in one of the 26 cells around
    it.

    Args:
        points: (N, 3) float32, metres; those that are not finite or out of range touch nothing.
        chosen, others: (N,) bool.
        size: edge of a cell, metres.
    """
    found = np.zeros(len(points), np.bool_)
    inverse = 1.0 / size
    length = 16
    while length < 2 * others.sum():
        length *= 2
    table = np.full(length, np.int64(-1))
    last = np.int64(-1)
    for i in range(len(points)):
        if others[i]:
            key = _key(points[i, 0] * inverse, points[i, 1] * inverse, points[i, 2] * inverse)
            if key >= 0 and key != last:  # consecutive points often share a cell
                last = key
                table[slot_of(table, key)] = key
    last = np.int64(-1)
    answer = False
    for i in range(len(points)):
        if chosen[i]:
            key = _key(points[i, 0] * inverse, points[i, 1] * inverse, points[i, 2] * inverse)
            if key >= 0 and key != last:
                last = key
                answer = _any_around(table, key)
            found[i] = key >= 0 and answer
    return found


@njit(cache=True, nogil=True)
def columns(points: F32, chosen: Bool, others: Bool, size: float) -> Bool:
    """(N,) bool: chosen points with other points in their column, or in one of the 8 columns around
    it.

    Args:
        points: (N, 3) float32, metres; those that are not finite touch nothing.
        chosen, others: (N,) bool.
        size: edge of a column, metres.
    """
    found = np.zeros(len(points), np.bool_)
    inverse = 1.0 / size
    near = np.zeros((_SIDE, _SIDE), np.bool_)
    last_x = np.int64(-1)
    last_y = np.int64(-1)
    for i in range(len(points)):
        if others[i] and math.isfinite(points[i, 0] + points[i, 1]):
            x = np.int64(math.floor(points[i, 0] * inverse))
            y = np.int64(math.floor(points[i, 1] * inverse))
            if x != last_x or y != last_y:
                last_x = x
                last_y = y
                for dx in range(-1, 2):
                    for dy in range(-1, 2):
                        near[(x + dx) & (_SIDE - 1), (y + dy) & (_SIDE - 1)] = True
    for i in range(len(points)):
        if chosen[i] and math.isfinite(points[i, 0] + points[i, 1]):
            x = np.int64(math.floor(points[i, 0] * inverse))
            y = np.int64(math.floor(points[i, 1] * inverse))
            found[i] = near[x & (_SIDE - 1), y & (_SIDE - 1)]
    return found


@njit(cache=True, nogil=True)
def reached(points: F32, reach: int) -> Bool:
    """(SIDE, SIDE) bool: the columns of 1 m within ``reach`` columns of points (N, 3), finite,
    metres; wraps around.
    """
    near = np.zeros((_REACHED, _REACHED), np.bool_)
    last_x = np.int64(0)
    last_y = np.int64(0)
    for i in range(len(points)):
        x = np.int64(math.floor(points[i, 0]))
        y = np.int64(math.floor(points[i, 1]))
        if i == 0 or x != last_x or y != last_y:
            last_x = x
            last_y = y
            for dx in range(-reach, reach + 1):
                for dy in range(-reach, reach + 1):
                    near[(x + dx) & (_REACHED - 1), (y + dy) & (_REACHED - 1)] = True
    return near


@njit(cache=True, nogil=True)
def inside(columns: F32, low: F64, high: F64, near: Bool) -> I64:
    """Rows of the points in a box and in columns near others, in order.

    Args:
        columns: (3, N) float32, metres, finite.
        low, high: (3,) float64, metres: low <= p < high on each axis.
        near: (S, S) bool, as ``reached`` returns it; one True for all columns.
    """
    rows = np.empty(columns.shape[1], np.int64)
    count = 0
    last = len(near) - 1
    for i in range(columns.shape[1]):
        x = columns[0, i]
        y = columns[1, i]
        z = columns[2, i]
        if low[0] <= x < high[0] and low[1] <= y < high[1] and low[2] <= z < high[2]:
            rows[count] = i
            count += near[np.int64(math.floor(x)) & last, np.int64(math.floor(y)) & last]
    return rows[:count]
