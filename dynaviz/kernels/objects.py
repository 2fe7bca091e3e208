"""Objects of one scan: points in adjacent cells."""

import math

import numpy as np
from numba import njit, prange

from dynaviz.kernels.keys import REACH, X_SHIFT, Y_SHIFT

# Each array expression in a parallel kernel wakes threads, which may take 0.1 ms: write it in a function of its own.
PARTS = 4  # into which points are divided, for threads
FEW = 8192  # points: up to so many are one part
FIRST_SLOTS = 1024  # of a hash table that grows
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
def _rows(chosen):
    """Rows (K,) int32 of the chosen points; without branches, which would be unpredictable."""
    rows, n = np.empty(len(chosen), np.int32), 0
    for i in range(len(chosen)):
        rows[n] = i
        n += chosen[i]
    return rows[:n]


@njit(cache=True, nogil=True)
def _divided(chosen):
    """The rows (K,) of chosen points, (N,) bool, and the ends of the parts into which they are divided for threads."""
    rows = _rows(chosen)
    parts = PARTS if len(rows) > FEW else 1
    ends = np.empty(parts + 1, np.int64)
    for part in range(parts + 1):
        ends[part] = part * len(rows) // parts
    return rows, ends


@njit(cache=True, nogil=True, error_model="numpy")
def _fill(points, rows, size, tall, first, slots, mine, cells, count):
    """Find the cells of points from the one in rows[first] on, until half of the slots are taken.

    Returns the place in ``rows`` of the next point, and the number of cells.
    """
    for place in range(first, len(rows)):
        i = rows[place]
        x = np.int64(math.floor(points[i, 0] / size)) + REACH
        y = np.int64(math.floor(points[i, 1] / size)) + REACH
        z = np.int64(math.floor(points[i, 2] / tall)) + REACH
        key = x << X_SHIFT | y << Y_SHIFT | z
        s = _slot(slots, cells, key)
        if slots[s] < 0:
            if 2 * count >= len(slots):
                return np.int64(place), count
            slots[s], cells[count] = count, key
            count += 1
        mine[i] = slots[s]
    return np.int64(len(rows)), count


@njit(cache=True, nogil=True)
def _part(points, rows, size, tall, mine, cells):
    """Number the cells of the points in some rows, in ``mine`` and ``cells``; returns how many these are."""
    slots, place, count = np.full(FIRST_SLOTS, np.int32(-1)), np.int64(0), np.int64(0)
    while True:
        place, count = _fill(points, rows, size, tall, place, slots, mine, cells, count)
        if place == len(rows):
            return count
        slots = _larger(slots, cells, count)


@njit(cache=True, nogil=True)
def _merged(rows, ends, found, counts, mine):
    """Number the cells that all parts found in the order of parts; returns what ``cells_of`` does."""
    total, size = counts.sum(), FIRST_SLOTS
    while size < 2 * total:
        size *= 2
    slots, cells, count = np.full(size, np.int32(-1)), np.empty(total, np.int64), np.int64(0)
    for part, most in enumerate(counts):
        numbers = np.empty(most, np.int32)
        for c in range(most):
            s = _slot(slots, cells, found[part, c])
            if slots[s] < 0:
                slots[s], cells[count] = count, found[part, c]
                count += 1
            numbers[c] = slots[s]
        for i in rows[ends[part] : ends[part + 1]]:
            mine[i] = numbers[mine[i]]
    return mine, cells[:count], slots


@njit(cache=True, nogil=True)
def _parts(chosen):
    """Rows (K,) of the chosen points, the parts of these rows, and memory for the cells of each part and of points."""
    rows, ends = _divided(chosen)
    parts = len(ends) - 1
    found, mine = np.empty((parts, len(rows) // parts + 1), np.int64), np.full(len(chosen), np.int32(-1))
    return rows, ends, np.zeros(parts, np.int64), found, mine


@njit(cache=True, nogil=True, parallel=True)
def cells_of(points, chosen, size, tall):
    """The cells that contain chosen points: (N,) int32, the cell of each point, -1 for others; and (C,) their keys.

    Cells are numbered in the order of first points. Then their hash table: their numbers by slot, -1 in free slots.
    Tables grow with the number of cells, far below that of points, so that they stay in the processor's cache.
    """
    rows, ends, counts, found, mine = _parts(chosen)
    if len(counts) == 1:
        counts[0] = _part(points, rows, size, tall, mine, found[0])
    else:
        for part in prange(len(counts)):
            counts[part] = _part(points, rows[ends[part] : ends[part + 1]], size, tall, mine, found[part])
    return _merged(rows, ends, found, counts, mine)


@njit(cache=True, nogil=True)
def connect(mine, order, keys):
    """Join points to objects: connected components of cells that share a face, an edge or a corner.

    Args:
        mine: (N,) int32: the cell of each point, as from ``cells_of``. Modified: the number of its object, in the order
            of first points; -1 for points without a cell.
        order: (C,) int64: the cells in the order of their keys.
        keys: (C,) int64, ascending: these keys.

    Returns:
        The number of objects.
    """
    count, parent = len(keys), np.arange(len(keys))
    for run in range(len(RUNS)):
        at = 0
        for c in range(count):
            while at < count and keys[at] < keys[c] + RUNS[run, 0]:
                at += 1
            other = at
            while other < count and keys[other] <= keys[c] + RUNS[run, 1]:
                a, b = _root(parent, order[c]), _root(parent, order[other])
                parent[max(a, b)] = min(a, b)
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
