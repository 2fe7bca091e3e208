"""Clusters of points: in adjacent voxels, in adjacent cells of one scan, and nearby clusters
merged.

A voxel is a number, block * 512 + index in the block; ``neighbours`` (B, 27) are the numbers of the
blocks around each block. A cluster is identified by the first point that it grew from, so results
do not depend on the numbers of voxels.
"""

import math

import numpy as np
from numba import njit

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


@njit(cache=True, nogil=True, inline="always")
def _slot(slots, key):
    """The slot of a key in a table whose size is a power of two, or the free slot for it."""
    mask = len(slots) - 1
    # The highest bits of the product depend on all of the key, x included.
    s = np.int64(np.uint64(key) * np.uint64(0x9E3779B97F4A7C15) >> np.uint64(40)) & mask
    while slots[s] >= 0 and slots[s] != key:
        s = (s + 1) & mask
    return s


@njit(cache=True, nogil=True)
def _root(parent, i):
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True, nogil=True)
def _unite(parent, i, j):
    """Join two sets; the smaller root represents both."""
    i = _root(parent, i)
    j = _root(parent, j)
    parent[max(i, j)] = min(i, j)


@njit(cache=True, nogil=True)
def _adjacent(voxel, side, neighbours):
    """The adjacent voxel at one of six sides; -1 if it has no block."""
    axis = side >> 1
    ahead = side & 1
    shift = 6 - 3 * axis
    block = voxel >> 9
    place = voxel & 511
    along = place >> shift & 7
    if along == (7 if ahead else 0):
        step = 9 if axis == 0 else (3 if axis == 1 else 1)
        block = np.int64(neighbours[block, 13 + (step if ahead else -step)])
        return block << 9 | place ^ 7 << shift if block >= 0 else np.int64(-1)
    return voxel + (1 << shift if ahead else -(1 << shift))


@njit(cache=True, nogil=True)
def _table(entries):
    size = 16
    while size < 2 * entries:
        size *= 2
    return np.full(size, np.int64(-1)), np.empty(size, np.int64)


@njit(cache=True, nogil=True)
def _larger(slots, values):
    """The same entries in a table of twice the size."""
    more, kept = _table(len(slots))
    for i in range(len(slots)):
        if slots[i] >= 0:
            s = _slot(more, slots[i])
            more[s] = slots[i]
            kept[s] = values[i]
    return more, kept


@njit(cache=True, nogil=True)
def grow(voxels, seeds, neighbours):
    """Cluster points by voxels that share a face.

    Voxels with a seed keep growing. Voxels with other points join the earliest cluster at their
    faces, but do not grow. The number of a cluster is the position of its first seed among the
    seeds' voxels.

    Args:
        voxels: (N,) int64, voxel of each point, -1 for none.
        seeds: (N,) bool.
        neighbours: (B, 27) int32.

    Returns:
        (N,) int32: cluster of each point, -1 for none.
    """
    n = seeds.sum()
    slots, ranks = _table(n)
    own = np.empty(n, np.int64)
    parent = np.arange(n)
    count = 0
    for i in range(len(voxels)):
        if seeds[i]:
            s = _slot(slots, voxels[i])
            if slots[s] < 0:
                slots[s] = voxels[i]
                ranks[s] = count
                own[count] = voxels[i]
                count += 1
    for k in range(count):
        for side in range(6):
            other = _adjacent(own[k], side, neighbours)
            if other >= 0:
                s = _slot(slots, other)
                if slots[s] >= 0:
                    _unite(parent, k, ranks[s])
    taken, roots = _table(7 * count)
    for k in range(count):
        for side in range(-1, 6):  # the voxel itself first
            voxel = own[k] if side < 0 else _adjacent(own[k], side, neighbours)
            if voxel >= 0:
                s = _slot(taken, voxel)
                root = _root(parent, k)
                if side < 0 or taken[s] < 0:
                    taken[s] = voxel
                    roots[s] = root
                elif slots[_slot(slots, voxel)] < 0:
                    roots[s] = min(roots[s], root)
    clusters = np.full(len(voxels), np.int32(-1))
    for i in range(len(voxels)):
        if voxels[i] >= 0:
            s = _slot(taken, voxels[i])
            if taken[s] >= 0:
                clusters[i] = roots[s]
    return clusters


@njit(cache=True, nogil=True)
def merge(points, clusters, distance):
    """Merge clusters (N,) that have points (N, 3) closer than ``distance`` metres.

    The earliest number remains.
    """
    n = len(points)
    merged = clusters.copy()
    parent = np.arange(clusters.max() + 1 if n else 0)
    per_metre = 1.0 / distance
    slots, heads = _table(n)
    # alike: a cell's points are in one cluster
    after = np.empty(n, np.int64)
    alike = np.ones(len(slots), np.bool_)
    for i in range(n):
        x = np.int64(math.floor(points[i, 0] * per_metre)) + REACH
        y = np.int64(math.floor(points[i, 1] * per_metre)) + REACH
        z = np.int64(math.floor(points[i, 2] * per_metre)) + REACH
        for j in range(27):  # compare with the points before this one
            key = (x + j // 9 - 1) << X_SHIFT | (y + j // 3 % 3 - 1) << Y_SHIFT | (z + j % 3 - 1)
            s = _slot(slots, key)
            if slots[s] < 0:
                continue
            k = heads[s]
            if alike[s] and _root(parent, clusters[k]) == _root(parent, clusters[i]):
                continue
            while k >= 0:
                if _root(parent, clusters[k]) != _root(parent, clusters[i]):
                    dx = points[k, 0] - points[i, 0]
                    dy = points[k, 1] - points[i, 1]
                    dz = points[k, 2] - points[i, 2]
                    if dx * dx + dy * dy + dz * dz < distance * distance:
                        _unite(parent, clusters[k], clusters[i])
                k = after[k]
        s = _slot(slots, x << X_SHIFT | y << Y_SHIFT | z)
        if slots[s] < 0:
            slots[s] = x << X_SHIFT | y << Y_SHIFT | z
            after[i] = -1
        else:
            after[i] = heads[s]
            alike[s] &= clusters[heads[s]] == clusters[i]
        heads[s] = i
    for i in range(n):
        merged[i] = _root(parent, clusters[i])
    return merged


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
    (slots, numbers) = _table(FIRST)
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
            s = _slot(slots, key)
            if slots[s] < 0:
                if 2 * count >= len(slots):
                    slots, numbers = _larger(slots, numbers)
                    s = _slot(slots, key)
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
            _unite(parent, c, wider[c])
    for run in range(len(RUNS)):
        at = 0
        for c in range(count):
            while at < count and keys[at] < keys[c] + RUNS[run, 0]:
                at += 1
            other = at
            while other < count and keys[other] <= keys[c] + RUNS[run, 1]:
                _unite(parent, order[c], order[other])
                other += 1
    names = np.full(count, np.int32(-1))
    objects = 0
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
