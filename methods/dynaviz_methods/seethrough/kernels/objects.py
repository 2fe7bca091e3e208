"""Objects: the points of a scan in connected cells, which are wider where points are rarer."""

import math

import numpy as np
from numba import njit

from dynaviz.kernels.disjoint_sets import root_of, unite
from dynaviz.kernels.hash_table import empty, slot_of
from dynaviz.kernels.keys import REACH, X_SHIFT, Y_SHIFT

FIRST = 512  # cells for which their hash table has room, before it grows
WIDEST = 3  # cells of objects are up to 2^WIDEST voxels wide
# layers by which those twice as wide lie above all others: no two widths are adjacent
ABOVE = 1 << 14
# Half of the 26 neighbours of a cell, the others being covered from their side: one above it, and
# three in each of four columns. Per column, the steps from the cell's key to the lowest and the
# highest of theirs.
COLUMNS = np.array(
    [
        0,
        1 << Y_SHIFT,
        (1 << X_SHIFT) - (1 << Y_SHIFT),
        1 << X_SHIFT,
        (1 << X_SHIFT) + (1 << Y_SHIFT),
    ]
)
RUNS = np.stack([COLUMNS + np.array([1, -1, -1, -1, -1]), COLUMNS + 1], 1)


@njit(cache=True, nogil=True)
def _larger(slots, values):
    """The same entries in a table of twice the size."""
    more = empty(len(slots))
    kept = np.empty(len(more), np.int64)
    for i in range(len(slots)):
        if slots[i] >= 0:
            s = slot_of(more, slots[i])
            more[s] = slots[i]
            kept[s] = values[i]
    return more, kept


@njit(cache=True, nogil=True, error_model="numpy")
def cells_of(points, chosen, sensor, voxel, angle):
    """The cells that contain chosen points.

    8 voxels high, and 1, 2, 4 or 8 voxels wide, as an angle allows.

    The farther points are from the sensor, the farther apart are those of one surface, and the
    wider are the cells. A point less than a wider cell from where these begin is in one of them,
    too, so that no object ends there. Cells are numbered in the order of first points. Their hash
    table grows with their number, far below that of points, so that it stays in the processor's
    cache.

    Args:
        points: (N, 3) float32, metres, world frame, within 32768 voxels from its origin; chosen:
            (N,) bool.
        sensor: (2,) float64, metres, world frame: the sensor's x and y.
        voxel: edge of a voxel, metres.
        angle: of the widest cell, seen from the sensor, radians.

    Returns:
        mine: (N,) int32: the cell of each point, -1 for others.
        keys: (C,) int64, of cells.
        wider: (C,) int32: the wider cell that contains points of a cell, too; -1 for none.
    """
    slots = empty(FIRST)
    numbers = np.empty(len(slots), np.int64)
    cells = np.empty(2 * len(points), np.int64)
    count = 0
    mine = np.full(len(points), np.int32(-1))
    wider = np.full(2 * len(points), np.int32(-1))
    edges = voxel * 2.0 ** np.arange(1, WIDEST + 1)
    # squared distances of wider cells
    far = (edges / angle) ** 2
    soon = np.maximum(edges / angle - edges, 0.0) ** 2
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
            s = slot_of(slots, key)
            if slots[s] < 0:
                if 2 * count >= len(slots):
                    slots, numbers = _larger(slots, numbers)
                    s = slot_of(slots, key)
                slots[s] = key
                numbers[s] = count
                cells[count] = key
                count += 1
            if step:
                wider[of] = numbers[s]
            else:
                of = mine[i] = numbers[s]
    return mine, cells[:count].copy(), wider[:count].copy()


@njit(cache=True, nogil=True)
def connect(mine, order, keys, wider):
    """Join points to objects.

    Connected components of cells that share a face, an edge, a corner or a point.

    Args:
        mine: (N,) int32: the cell of each point, as from ``cells_of``. Modified: the number of its
            object, in the order of first points; -1 for points without a cell.
        order: (C,) int64: the cells in the order of their keys.
        keys: (C,) int64, ascending: these keys.
        wider: (C,) int32, as from ``cells_of``.

    Returns:
        The number of objects.
    """
    count = len(keys)
    parent = np.arange(len(keys))
    for c in range(count):
        if wider[c] >= 0:
            unite(parent, c, wider[c])
    for run in range(len(RUNS)):
        at = 0
        for c in range(count):
            while at < count and keys[at] < keys[c] + RUNS[run, 0]:
                at += 1
            other = at
            while other < count and keys[other] <= keys[c] + RUNS[run, 1]:
                unite(parent, order[c], order[other])
                other += 1
    names = np.full(count, np.int32(-1))
    objects = 0
    for c in range(count):
        root = root_of(parent, c)
        if names[root] < 0:
            names[root] = objects
            objects += 1
        names[c] = names[root]
    for i in range(len(mine)):
        if mine[i] >= 0:
            mine[i] = names[mine[i]]
    return objects
