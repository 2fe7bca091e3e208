"""Points thinned to one per cell, with cells that grow with the distance from a centre."""

import numpy as np
from numba import njit

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
FREE = np.uint64(0)


@njit(cache=True, nogil=True)
def split(points, corner, edge, interest):
    """Sort points into those in cells of interest and others; points outside of the grid of cells are left out.

    Args:
        points: (N, 3) float32, metres.
        corner: (3,) float64, metres: low corner of the grid.
        edge: metres: edge of a cell.
        interest: (X, Y, Z) bool: cells of interest.

    Returns:
        near, others: int64 indices, ascending.
    """
    near, others = np.empty(len(points), np.int64), np.empty(len(points), np.int64)
    n, m = 0, 0
    at = np.empty(3, np.int64)
    for i in range(len(points)):
        inside = True
        for axis in range(3):
            place = (points[i, axis] - corner[axis]) / edge
            inside &= 0.0 <= place < interest.shape[axis]  # false if not finite
            at[axis] = np.int64(place) if inside else 0
        if inside and interest[at[0], at[1], at[2]]:
            near[n] = i
            n += 1
        elif inside:
            others[m] = i
            m += 1
    return near[:n], others[:m]


@njit(cache=True, nogil=True)
def thinned(points, rows, centre, size, near, table):
    """The first of these points in each cell of a grid that is fixed in the world.

    Args:
        points: (N, 3) float32, metres.
        rows: (K,) int64, indices of finite points.
        centre: (3,) float64, metres.
        size: metres: edge of a cell up to a distance of ``near`` from the centre; it doubles with the distance.
        near: metres.
        table: (2^k,) uint64 scratch memory, at least 2 K; overwritten.

    Returns:
        int64 indices, in the order of ``rows``.
    """
    table[:] = FREE
    mask = np.uint64(len(table) - 1)
    kept, count = np.empty(len(rows), np.int64), 0
    for row in rows:
        reach = 0.0
        for axis in range(3):
            reach = max(reach, abs(points[row, axis] - centre[axis]))
        level, edge = np.uint64(1), size
        while reach > near * 2.0:
            level += np.uint64(1)
            edge *= 2.0
            reach *= 0.5
        key = level * GOLDEN
        for axis in range(3):
            key = (key ^ np.uint64(np.int64(np.floor(points[row, axis] / edge)))) * GOLDEN
            key ^= key >> np.uint64(29)
        key |= np.uint64(1)  # never free; two cells in 2^63 share a key
        slot = key >> np.uint64(20) & mask
        while table[slot] != FREE and table[slot] != key:
            slot = slot + np.uint64(1) & mask
        if table[slot] == FREE:
            table[slot] = key
            kept[count] = row
            count += 1
    return kept[:count]
