"""Objects of one scan: points in adjacent cells."""

import math

import numpy as np
from numba import njit

from dynaviz.kernels.keys import REACH, X_SHIFT, Y_SHIFT

FIRST_SLOTS = 1024  # of a hash table that grows
WIDEST = 3  # cells of objects are up to 2^WIDEST voxels wide
ABOVE = 1 << 14  # layers by which those twice as wide lie above all others: no two widths are adjacent
# Half of the 26 neighbours of a cell, the others being covered from their side: one above it, and three in each of four
# columns. Per column, the steps from the cell's key to the lowest and the highest of theirs.
COLUMNS = np.array([0, 1 << Y_SHIFT, (1 << X_SHIFT) - (1 << Y_SHIFT), 1 << X_SHIFT, (1 << X_SHIFT) + (1 << Y_SHIFT)])
RUNS = np.stack([COLUMNS + np.array([1, -1, -1, -1, -1]), COLUMNS + 1], 1)


@njit(cache=True, nogil=True, inline="always")
def _slot(slots, cells, key):
    """The slot of a key in a hash table of numbers of cells, or the free slot for it; its size is a power of two."""
    mask = len(slots) - 1
    # The highest bits of the product depend on all of the key, x included.
    s = np.int64(np.uint64(key) * np.uint64(0x9E3779B97F4A7C15) >> np.uint64(44)) & mask
    while slots[s] >= 0 and cells[slots[s]] != key:
        s = (s + 1) & mask
    return s


@njit(cache=True, nogil=True)
def _larger(slots, cells, count):
    """A table of twice the size for the first ``count`` cells."""
    larger = np.full(2 * len(slots), np.int32(-1))
    for c in range(count):
        larger[_slot(larger, cells, cells[c])] = c
    return larger


@njit(cache=True, nogil=True)
def _root(parent, i):
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True, nogil=True)
def _join(parent, a, b):
    a, b = _root(parent, a), _root(parent, b)
    parent[max(a, b)] = min(a, b)


@njit(cache=True, nogil=True, error_model="numpy")
def cells_of(points, chosen, sensor, voxel, angle):
    """The cells that contain chosen points: 8 voxels high, and 1, 2, 4 or 8 voxels wide, as an angle allows.

    The farther points are from the sensor, the farther apart are those of one surface, and the wider are the cells. A
    point less than a wider cell from where these begin is in one of them, too, so that no object ends there. Cells are
    numbered in the order of first points. Their hash table grows with their number, far below that of points, so that
    it stays in the processor's cache.

    Args:
        points: (N, 3) float32, metres, world frame, within 32768 voxels from its origin; chosen: (N,) bool.
        sensor: (2,) float64, metres, world frame: the sensor's x and y.
        voxel: edge of a voxel, metres.
        angle: of the widest cell, seen from the sensor, radians.

    Returns:
        mine: (N,) int32: the cell of each point, -1 for others.
        keys: (C,) int64, of cells.
        wider: (C,) int32: the wider cell that contains points of a cell, too; -1 for none.
    """
    slots, cells, count = np.full(FIRST_SLOTS, np.int32(-1)), np.empty(2 * len(points), np.int64), 0
    mine, wider = np.full(len(points), np.int32(-1)), np.full(2 * len(points), np.int32(-1))
    edges = voxel * 2.0 ** np.arange(1, WIDEST + 1)
    far, soon = (edges / angle) ** 2, np.maximum(edges / angle - edges, 0.0) ** 2  # squared distances of wider cells
    for i in range(len(points)):
        if not chosen[i]:
            continue
        x = np.int64(math.floor(points[i, 0] / voxel)) + REACH
        y = np.int64(math.floor(points[i, 1] / voxel)) + REACH
        z = (np.int64(math.floor(points[i, 2] / voxel)) + REACH) >> 3
        away = (points[i, 0] - sensor[0]) ** 2 + (points[i, 1] - sensor[1]) ** 2
        size = 0
        while size < WIDEST and far[size] <= away:
            size += 1
        of = np.int32(-1)
        for step in range(2):  # the cell, and the wider one
            if step and (size == WIDEST or soon[size] > away or wider[of] >= 0):
                break
            at = size + step
            key = (x >> at) << X_SHIFT | (y >> at) << Y_SHIFT | z + at * ABOVE
            s = _slot(slots, cells, key)
            if slots[s] < 0:
                if 2 * count >= len(slots):
                    slots = _larger(slots, cells, count)
                    s = _slot(slots, cells, key)
                slots[s], cells[count] = count, key
                count += 1
            if step:
                wider[of] = slots[s]
            else:
                of = mine[i] = slots[s]
    return mine, cells[:count].copy(), wider[:count].copy()


@njit(cache=True, nogil=True)
def connect(mine, order, keys, wider):
    """Join points to objects: connected components of cells that share a face, an edge, a corner or a point.

    Args:
        mine: (N,) int32: the cell of each point, as from ``cells_of``. Modified: the number of its object, in the order
            of first points; -1 for points without a cell.
        order: (C,) int64: the cells in the order of their keys.
        keys: (C,) int64, ascending: these keys.
        wider: (C,) int32, as from ``cells_of``.

    Returns:
        The number of objects.
    """
    count, parent = len(keys), np.arange(len(keys))
    for c in range(count):
        if wider[c] >= 0:
            _join(parent, c, wider[c])
    for run in range(len(RUNS)):
        at = 0
        for c in range(count):
            while at < count and keys[at] < keys[c] + RUNS[run, 0]:
                at += 1
            other = at
            while other < count and keys[other] <= keys[c] + RUNS[run, 1]:
                _join(parent, order[c], order[other])
                other += 1
    names, objects = np.full(count, np.int32(-1)), 0
    for c in range(count):
        root = _root(parent, c)
        if names[root] < 0:
            names[root] = objects
            objects += 1
        names[c] = names[root]
    for i in range(len(mine)):
        if mine[i] >= 0:
            mine[i] = names[mine[i]]
    return objects


@njit(cache=True, nogil=True)
def look_up(codes, table):
    """(N,) bool: the entries of a table, bool, at codes (N,) uint8."""
    found = np.empty(len(codes), np.bool_)
    for i in range(len(codes)):
        found[i] = table[codes[i]]
    return found
