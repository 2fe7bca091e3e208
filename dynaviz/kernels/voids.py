"""Void voxels of a block grid: observed, not hit, and far enough from unobserved ones.

Bit v of word w is voxel 64 w + v of a block.
"""

import numpy as np
from numba import njit, prange


@njit(cache=True, nogil=True)
def in_range(points, origins, low, high):
    """(N,) bool: points (N, 3) more than ``low`` and less than ``high`` metres from their origins, (N or 1, 3)."""
    inside = np.zeros(len(points), np.bool_)
    several = len(origins) > 1
    for p in range(len(points)):
        q = p if several else 0
        squared = 0.0
        for a in range(3):
            squared += (points[p, a] - origins[q, a]) ** 2
        inside[p] = low * low < squared < high * high  # False if not finite
    return inside


@njit(cache=True, nogil=True)
def distinct(voxels, chosen, scratch):
    """The chosen voxels without duplicates, in order; ``scratch`` (blocks, 8) int64 is zero before and after."""
    goals, n = np.empty(len(voxels) + 1, np.int64), 0
    for p in range(len(voxels)):
        if chosen[p]:
            block, word, place = voxels[p] >> 9, voxels[p] >> 6 & 7, voxels[p] & 63
            bits = scratch[block, word]
            scratch[block, word] = bits | np.int64(1) << place
            goals[n] = voxels[p]  # overwritten by the next one unless new: an unpredictable branch is slower
            n += 1 - (bits >> place & 1)
    for g in goals[:n]:
        scratch[g >> 9, g >> 6 & 7] = 0
    return goals[:n].copy()


@njit(cache=True, nogil=True)
def remember(blocks, hit, observed, void, seen_free, crossed):
    """Add a scan's bits, (B, 8) int64, to those of all scans: void voxels, and voxels that rays crossed."""
    for b in range(len(blocks)):
        for word in range(8):
            seen_free[blocks[b], word] |= void[b, word]
            crossed[blocks[b], word] |= observed[b, word] & ~hit[b, word]


@njit(cache=True, nogil=True, inline="always")
def _block(x, y, z, shape, top, children):
    """The number of a block plus one, 0 if absent; x, y, z: blocks from the grid's first."""
    jx, jy, jz = x >> 4, y >> 4, z >> 4
    if not (0 <= jx < shape[0] and 0 <= jy < shape[1] and 0 <= jz < shape[2]):
        return np.int32(0)
    row = top[(jx * shape[1] + jy) * shape[2] + jz]
    return children[row, (x & 15) << 8 | (y & 15) << 4 | (z & 15)]  # row 0 is empty


@njit(cache=True, nogil=True, parallel=True)
def sides(touched, rows, blocks, base, shape, top, children):
    """(n, 6) int32: rows of the six adjacent blocks of each touched block, -x, +x, -y, ... +z; n if absent."""
    adjacent = np.full((len(touched), 6), np.int32(len(touched)))
    for n in prange(len(touched)):
        for side in range(6):
            step = 1 if side & 1 else -1
            x = np.int64(blocks[touched[n], 0]) - (base[0] << 4) + (step if side >> 1 == 0 else 0)
            y = np.int64(blocks[touched[n], 1]) - (base[1] << 4) + (step if side >> 1 == 1 else 0)
            z = np.int64(blocks[touched[n], 2]) - (base[2] << 4) + (step if side >> 1 == 2 else 0)
            block = _block(x, y, z, shape, top, children)
            if block and rows[block - 1]:
                adjacent[n, side] = rows[block - 1] - 1
    return adjacent


@njit(cache=True, nogil=True, parallel=True)
def erode(observed, adjacent, times):
    """Erode voxels (n + 1, 8) uint64, the last row empty, by cubes of edge 2 times + 1 voxels, one axis after another.

    ``adjacent`` (n, 6) are the rows of adjacent blocks, as from ``sides``.
    """
    n = len(adjacent)
    here, there = observed.copy(), np.zeros_like(observed)
    low, high = np.uint64(0x0101010101010101), np.uint64(0x8080808080808080)
    one, seven, eight, most = np.uint64(1), np.uint64(7), np.uint64(8), np.uint64(56)
    for _ in range(times):
        for r in prange(n):
            for w in range(8):  # z: bits of a byte
                word, below, above = here[r, w], here[adjacent[r, 4], w], here[adjacent[r, 5], w]
                lower = (word << one) & ~low | (below >> seven) & low
                upper = (word >> one) & ~high | (above << seven) & high
                there[r, w] = word & lower & upper
        for r in prange(n):
            for w in range(8):  # y: bytes of a word
                word, below, above = there[r, w], there[adjacent[r, 2], w], there[adjacent[r, 3], w]
                here[r, w] = word & (word << eight | below >> most) & (word >> eight | above << most)
        for r in prange(n):
            for w in range(8):  # x: words of a block
                below = here[r, w - 1] if w > 0 else here[adjacent[r, 0], 7]
                above = here[r, w + 1] if w < 7 else here[adjacent[r, 1], 0]
                there[r, w] = here[r, w] & below & above
        here, there = there, here
    return here
