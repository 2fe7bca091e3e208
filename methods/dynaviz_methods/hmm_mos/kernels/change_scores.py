"""Scores of occupied voxels by the changes around them, their median, and growth by one voxel.

A voxel is block * 512 + index in the block. Bits are (B, 8) uint64: bit v of word w is voxel 64 w +
v of a block. A neighbourhood is a cube of at most 17 voxels. ``neighbours`` (B, 27) are the numbers
of the blocks around each block, itself at 13, x slowest; -1 if absent.
"""

import numpy as np
from numba import njit, prange

CHUNK = 256  # voxels that a lane processes in turn
ONE = np.uint64(1)
BYTE = np.uint64(255)


@njit(cache=True, nogil=True, inline="always")
def _holds(bits, voxel):
    return voxel >= 0 and bits[voxel >> 9, voxel >> 6 & 7] >> np.uint64(voxel & 63) & ONE


@njit(cache=True, nogil=True, inline="always")
def _moved(voxel, dx, dy, dz, neighbours):
    """The voxel at an offset of at most one block; -1 if the grid has no block there."""
    block = voxel >> 9
    place = voxel & 511
    x = (place >> 6) + dx
    y = (place >> 3 & 7) + dy
    z = (place & 7) + dz
    side = ((x >> 3) + 1) * 9 + ((y >> 3) + 1) * 3 + (z >> 3) + 1
    if side != 13:
        block = np.int64(neighbours[block, side])
        if block < 0:
            return np.int64(-1)
    return block << 9 | (x & 7) << 6 | (y & 7) << 3 | (z & 7)


@njit(cache=True, nogil=True)
def _columns(block, half, neighbours, known, turned, hit, of_known, of_turned):
    """Bits along z of a block and the blocks around it, from z = -8 to 15.

    Whether any has turned occupied.
    """
    any_turned = False
    for x in range(-half, 8 + half):
        for y in range(-half, 8 + half):
            first = ((x >> 3) + 1) * 9 + ((y >> 3) + 1) * 3
            shift = np.uint64((y & 7) << 3)
            column = np.uint64(0)
            changed = np.uint64(0)
            for k in range(3):
                b = neighbours[block, first + k]
                if b >= 0:
                    column |= (known[b, x & 7] >> shift & BYTE) << np.uint64(8 * k)
                    changed |= ((turned[b, x & 7] & hit[b, x & 7]) >> shift & BYTE) << np.uint64(
                        8 * k
                    )
            of_known[x + half, y + half] = column
            of_turned[x + half, y + half] = changed
            any_turned |= changed != 0
    return any_turned


@njit(cache=True, nogil=True, parallel=True)
def scores(voxels, firsts, sizes, neighbours, known, turned, hit, score, surely, lanes):
    """Count the voxels around each occupied voxel that just turned occupied, minus those of unknown
    state.

    Args:
        voxels: (N,) int64, occupied voxels, grouped by block.
        firsts: (K + 1,) int64, position of the first voxel of each block in ``voxels``, and N.
        sizes: (2^n,) uint8, number of bits set in each number of n bits, where n is the edge of the
            neighbourhood.
        known, turned, hit: (B, 8) uint64, bits of the voxels with a known state, of those that
            turned occupied, and of those with points.
        score: (N,) int32. Set to the difference, at least 0.
        surely: (N,) int32. Set to the number of voxels of known state.
        lanes: number of threads.
    """
    edge = 1
    while 1 << edge < len(sizes):
        edge += 1
    half = edge // 2
    most = np.uint64(len(sizes) - 1)
    for lane in prange(lanes):
        of_known = np.empty((8 + 2 * half, 8 + 2 * half), np.uint64)
        of_turned = np.empty((8 + 2 * half, 8 + 2 * half), np.uint64)
        for k in range(lane, len(firsts) - 1, lanes):
            block = voxels[firsts[k]] >> 9
            changes = _columns(block, half, neighbours, known, turned, hit, of_known, of_turned)
            for i in range(firsts[k], firsts[k + 1]):
                x0 = voxels[i] >> 6 & 7
                y0 = voxels[i] >> 3 & 7
                shift = np.uint64(8 + (voxels[i] & 7) - half)
                sure = 0
                changed = 0
                for x in range(x0, x0 + edge):
                    for y in range(y0, y0 + edge):
                        sure += sizes[of_known[x, y] >> shift & most]
                        if changes:
                            changed += sizes[of_turned[x, y] >> shift & most]
                score[i] = max(changed + sure - edge * edge * edge, 0)
                surely[i] = sure


@njit(cache=True, nogil=True)
def _sort(values, n):
    """Sort the first n values; np.sort takes seconds to compile."""
    for i in range(1, n):
        value = values[i]
        j = i
        while j > 0 and values[j - 1] > value:
            values[j] = values[j - 1]
            j -= 1
        values[j] = value


@njit(cache=True, nogil=True, parallel=True)
def medians(voxels, neighbours, hit, value, lanes):
    """(N,) int32: median of the values of the occupied voxels among the 27 around each voxel,
    rounded down.

    Args:
        voxels: (N,) int64, occupied voxels.
        hit: (B, 8) uint64, their bits.
        value: (B, 512) int32, values of occupied voxels, at least 0.
        lanes: number of threads.
    """
    found = np.zeros(len(voxels), np.int32)
    for lane in prange(lanes):
        around = np.empty(27, np.int32)
        for first in range(lane * CHUNK, len(voxels), lanes * CHUNK):
            for i in range(first, min(first + CHUNK, len(voxels))):
                n = 0
                zeros = 0
                for k in range(27):
                    other = _moved(voxels[i], k // 9 - 1, k // 3 % 3 - 1, k % 3 - 1, neighbours)
                    if _holds(hit, other):
                        around[n] = value[other >> 9, other & 511]
                        zeros += around[n] == 0
                        n += 1
                if 2 * zeros <= n:
                    _sort(around, n)
                    found[i] = (around[(n - 1) // 2] + around[n // 2]) // 2
    return found


@njit(cache=True, nogil=True)
def beside(voxels, neighbours, hit):
    """Occupied voxels among the 26 around each of some voxels (N,), with duplicates and with these
    voxels.
    """
    found = np.empty(27 * len(voxels), np.int64)
    n = 0
    for voxel in voxels:
        for k in range(27):
            other = _moved(voxel, k // 9 - 1, k // 3 % 3 - 1, k % 3 - 1, neighbours)
            if _holds(hit, other):
                found[n] = other
                n += 1
    return found[:n].copy()
