"""Points thinned to one per cell, with cells that grow with the distance from a centre."""

import math

import numpy as np
from numba import njit

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
FREE = np.uint64(0)


@njit(cache=True, nogil=True)
def mark(points, corner, edge, interest):
    """Mark the cells of points, and those around them, as of interest.

    Args:
        points: (N, 3) float32, metres; those outside of the grid of cells are ignored.
        corner: (3,) float64, metres: low corner of the grid.
        edge: metres: edge of a cell.
        interest: (X, Y, Z) bool, changed.
    """
    done = np.zeros(interest.shape, np.bool_)
    inverse = 1.0 / edge
    for i in range(len(points)):
        x = (points[i, 0] - corner[0]) * inverse
        y = (points[i, 1] - corner[1]) * inverse
        z = (points[i, 2] - corner[2]) * inverse
        if not (0.0 <= x < done.shape[0] and 0.0 <= y < done.shape[1] and 0.0 <= z < done.shape[2]):
            continue
        a = int(x)
        b = int(y)
        c = int(z)
        if done[a, b, c]:
            continue
        done[a, b, c] = True
        for u in range(max(a - 1, 0), min(a + 2, done.shape[0])):
            for v in range(max(b - 1, 0), min(b + 2, done.shape[1])):
                for w in range(max(c - 1, 0), min(c + 2, done.shape[2])):
                    interest[u, v, w] = True


@njit(cache=True, nogil=True)
def centres(keys, size):
    """(N, 3) float32, metres.

    The centres of voxels with keys (N, 3) int32 and this edge in metres.
    """
    points = np.empty((len(keys), 3), np.float32)
    for i in range(len(keys)):
        for axis in range(3):
            points[i, axis] = (keys[i, axis] + 0.5) * size
    return points


@njit(cache=True, nogil=True)
def split(points, corner, edge, interest):
    """Sort points into those in cells of interest and others.

    Points outside of the grid of cells are left out.

    Args:
        points: (N, 3) float32, metres.
        corner: (3,) float64, metres: low corner of the grid.
        edge: metres: edge of a cell.
        interest: (X, Y, Z) bool: cells of interest.

    Returns:
        near, others: int64 indices, ascending.
    """
    near = np.empty(len(points), np.int64)
    others = np.empty(len(points), np.int64)
    n = 0
    m = 0
    inverse = 1.0 / edge
    for i in range(len(points)):
        x = (points[i, 0] - corner[0]) * inverse
        y = (points[i, 1] - corner[1]) * inverse
        z = (points[i, 2] - corner[2]) * inverse
        if (
            0.0 <= x < interest.shape[0]
            and 0.0 <= y < interest.shape[1]
            and 0.0 <= z < interest.shape[2]
        ):
            if interest[np.int64(x), np.int64(y), np.int64(z)]:
                near[n] = i
                n += 1
            else:
                others[m] = i
                m += 1
    return near[:n], others[:m]


@njit(cache=True, nogil=True)
def thinned(points, rows, centre, size, near, most, share):
    """The first of these points in each cell of a grid that is fixed in the world.

    Args:
        points: (N, 3) float32, metres.
        rows: (K,) int64, indices of finite points.
        centre: (3,) float64, metres.
        size: metres: edge of a cell up to a distance of ``near`` from the centre; it doubles with
            the distance.
        near: metres.
        most: number of points to return; the search ends at the next one.
        share: of the rows to look at, evenly spread.

    Returns:
        kept: int64 indices, in the order of ``rows``.
        complete: whether the search reached the last row.
    """
    room = 64
    while room < 2 * min(most, len(rows)):
        room *= 2
    table = np.zeros(room, np.uint64)
    mask = np.uint64(room - 1)
    kept = np.empty(min(most, len(rows)), np.int64)
    count = 0
    last = FREE
    limit = np.uint64(share * 2.0**32)
    for row in rows:
        if (
            np.uint64(row) * GOLDEN >> np.uint64(32) & np.uint64(0xFFFFFFFF) >= limit
        ):  # multiples of the golden ratio
            continue
        reach = 0.0
        for axis in range(3):
            reach = max(reach, abs(points[row, axis] - centre[axis]))
        level = np.uint64(1)
        inverse = 1.0 / size
        while reach > near * 2.0:
            level += np.uint64(1)
            inverse *= 0.5
            reach *= 0.5
        key = level * GOLDEN
        for axis in range(3):
            key = (key ^ np.uint64(np.int64(math.floor(points[row, axis] * inverse)))) * GOLDEN
            key ^= key >> np.uint64(29)
        key |= np.uint64(1)  # never free; two cells in 2^63 share a key
        if key == last:  # neighbours mostly share a cell
            continue
        last = key
        slot = key >> np.uint64(20) & mask
        while table[slot] != FREE and table[slot] != key:
            slot = slot + np.uint64(1) & mask
        if table[slot] == FREE:
            if count == len(kept):
                return kept, False
            table[slot] = key
            kept[count] = row
            count += 1
    return kept[:count], True
