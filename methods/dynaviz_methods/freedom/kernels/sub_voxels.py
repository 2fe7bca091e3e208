"""A map of sub-voxels, 64 to a voxel.

Each holds the scan that filled it, and how surely it is dynamic.

A voxel is block * 512 + index in the block. ``rows`` (B * 512,) int32 gives each voxel its row in
the map, -1 if empty. ``scans`` (R, 64) int32 is the scan that filled a sub-voxel, -1 if empty;
``levels`` (R, 64) uint8 its level, 0 static, with RAISED added if it was raised after the scan.
"""

import math

import numpy as np
from numba import njit

LEVEL = 3
RAISED = 4


@njit(cache=True, nogil=True, inline="always")
def _beside(voxel, k, neighbours):
    block = voxel >> 9
    place = voxel & 511
    x = (place >> 6) + k // 9 - 1
    y = (place >> 3 & 7) + k // 3 % 3 - 1
    z = (place & 7) + k % 3 - 1
    side = ((x >> 3) + 1) * 9 + ((y >> 3) + 1) * 3 + (z >> 3) + 1
    if side != 13:
        block = np.int64(neighbours[block, side])
        if block < 0:
            return np.int64(-1)
    return block << 9 | (x & 7) << 6 | (y & 7) << 3 | (z & 7)


@njit(cache=True, nogil=True)
def places(points, per_metre):
    """(N,) uint8: index of each point's sub-voxel in its voxel; per_metre: sub-voxels per metre."""
    found = np.zeros(len(points), np.uint8)
    for i in range(len(points)):
        k = np.int64(0)
        for axis in range(3):
            f = points[i, axis] * per_metre
            if abs(f) < 1e9:
                k = k << 2 | (np.int64(math.floor(f)) & 3)
        found[i] = k
    return found


@njit(cache=True, nogil=True)
def insert(voxels, places, number, level, rows, owners, used, scans, levels):
    """Insert the points of a scan, in their order; return the number of rows in use.

    Args:
        voxels: (N,) int64, negative for points to skip; places: (N,) uint8.
        number: number of the scan; level: (B * 512,) uint8, level of each voxel of the scan.
        owners: (R,) int64, voxel of each row. Modified, as rows, scans and levels.
    """
    for i in range(len(voxels)):
        if voxels[i] < 0:
            continue
        r = rows[voxels[i]]
        if r < 0:
            r = np.int32(used)
            rows[voxels[i]] = r
            owners[r] = voxels[i]
            used += 1
        s = places[i]
        mine = level[voxels[i]]
        if scans[r, s] < 0 or (scans[r, s] != number and levels[r, s] & LEVEL > mine):
            scans[r, s] = number
            levels[r, s] = mine
    return used


@njit(cache=True, nogil=True, inline="always")
def _has(scans, row, number):
    for s in range(64):  # noqa: SIM110  # numba compiles a loop faster than any()
        if scans[row, s] == number:
            return True
    return False


@njit(cache=True, nogil=True, inline="always")
def _raise(scans, levels, row, number, level):
    for s in range(64):
        if scans[row, s] == number and levels[row, s] & LEVEL < level:
            levels[row, s] = level | RAISED


@njit(cache=True, nogil=True)
def pairs(voxels, rows, scans):
    """(M, 2) int64: each scan in each of some voxels (N,), and the voxel."""
    found = np.empty((64 * len(voxels), 2), np.int64)
    n = 0
    for voxel in voxels:
        r = rows[voxel]
        if r >= 0:
            for s in range(64):
                first = scans[r, s] >= 0
                for t in range(s):
                    first &= scans[r, t] != scans[r, s]
                if first:
                    found[n, 0] = scans[r, s]
                    found[n, 1] = voxel
                    n += 1
    return found[:n].copy()


@njit(cache=True, nogil=True)
def take_back(seeds, steps, neighbours, rows, scans, levels, marks, stamp):
    """Raise the levels of what earlier scans saw in voxels that have turned free, and grow it
    within each scan.

    Args:
        seeds: (M, 2) int64, scan and voxel, sorted by scan.
        steps: number of steps of growth; the first gives level 2, others level 1.
        marks: (R,) int64, scratch memory; stamp: larger than all numbers in it.

    Returns:
        The next stamp.
    """
    start = 0
    while start < len(seeds):
        number = seeds[start, 0]
        end = start
        front = np.empty(27, np.int64)
        n = 0
        while end < len(seeds) and seeds[end, 0] == number:
            end += 1
        front = seeds[start:end, 1].copy()
        stamp += 1
        for voxel in front:
            marks[rows[voxel]] = stamp
            _raise(scans, levels, rows[voxel], number, 3)
        for step in range(steps):
            after = np.empty(26 * len(front) + 1, np.int64)
            n = 0
            for voxel in front:
                for k in range(27):
                    other = _beside(voxel, k, neighbours)
                    if other < 0 or rows[other] < 0 or marks[rows[other]] == stamp:
                        continue
                    if _has(scans, rows[other], number):
                        marks[rows[other]] = stamp
                        _raise(scans, levels, rows[other], number, 2 if step == 0 else 1)
                        after[n] = other
                        n += 1
            front = after[:n].copy()
        start = end
    return stamp


@njit(cache=True, nogil=True)
def look_up(voxels, places, rows, levels):
    """(N,) uint8: level of the sub-voxel of each point, with RAISED; 0 for none."""
    found = np.zeros(len(voxels), np.uint8)
    for i in range(len(voxels)):
        if voxels[i] >= 0 and rows[voxels[i]] >= 0:
            found[i] = levels[rows[voxels[i]], places[i]]
    return found
