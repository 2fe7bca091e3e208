"""When the cells of a map were hit: first and last frame, and the number of frames."""

import math

import numpy as np
from numba import njit

from dynaviz.kernels.hash_table import slot_of
from dynaviz.kernels.keys import REACH, X_SHIFT, Y_SHIFT

# columns of a cell
FIRST = 0
LAST = 1
FRAMES = 2


@njit(cache=True, nogil=True)
def visit(points, begin, frame, size, keys, visits, used):
    """Count a frame for the cells of its points; stop where the table is half full.

    Args:
        points: (N, 3) float32, metres, world frame. Points that are not finite or too far away are
            skipped.
        begin: number of the first point to count.
        frame: position in the run.
        size: edge of a cell, metres.
        keys: (2^k,) int64: key of each cell, -1 if free. Modified.
        visits: (2^k, 3) int32: first frame, last frame and number of frames of each cell. Modified.
        used: number of cells in the table.

    Returns:
        The number of the first point that was not counted, and the number of cells in the table.
    """
    inverse = 1.0 / size
    last = np.int64(-1)
    s = np.int64(0)
    for i in range(begin, len(points)):
        a = points[i, 0] * inverse
        b = points[i, 1] * inverse
        c = points[i, 2] * inverse
        if not (abs(a) < REACH - 1 and abs(b) < REACH - 1 and abs(c) < REACH - 1):
            continue
        x = np.int64(math.floor(a))
        y = np.int64(math.floor(b))
        z = np.int64(math.floor(c))
        key = (x + REACH) << X_SHIFT | (y + REACH) << Y_SHIFT | (z + REACH)
        if key == last:  # consecutive points often share a cell
            continue
        s = slot_of(keys, key)
        last = key
        if keys[s] < 0:
            if 2 * used >= len(keys):
                return i, used
            keys[s] = key
            used = used + 1
            visits[s, FIRST] = frame
            visits[s, LAST] = -1
            visits[s, FRAMES] = 0
        if visits[s, LAST] != frame:
            visits[s, LAST] = frame
            visits[s, FRAMES] += 1
    return len(points), used


@njit(cache=True, nogil=True)
def grow(keys, visits, size):
    """The same cells in tables of ``size`` rows, a power of two."""
    more = np.full(size, np.int64(-1))
    kept = np.empty((size, 3), np.int32)
    for i in range(len(keys)):
        if keys[i] >= 0:
            s = slot_of(more, keys[i])
            more[s] = keys[i]
            for column in range(3):
                kept[s, column] = visits[i, column]
    return more, kept
