"""Void voxels of a block grid: observed, not hit, and far enough from unobserved ones.

Bit v of word w is voxel 64 w + v of a block.
"""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def in_range(points, origins, low, high):
    """(N,) bool: points (N, 3) more than ``low`` and less than ``high`` metres from their origins,
    (N or 1, 3).
    """
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
    """The chosen voxels without duplicates, in order.

    ``scratch`` (blocks, 8) int64 is zero before and after.
    """
    goals = np.empty(len(voxels) + 1, np.int64)
    n = 0
    for p in range(len(voxels)):
        if chosen[p]:
            block = voxels[p] >> 9
            word = voxels[p] >> 6 & 7
            place = voxels[p] & 63
            bits = scratch[block, word]
            scratch[block, word] = bits | np.int64(1) << place
            # overwritten by the next one unless new: an unpredictable branch is slower
            goals[n] = voxels[p]
            n += 1 - (bits >> place & 1)
    for g in goals[:n]:
        scratch[g >> 9, g >> 6 & 7] = 0
    return goals[:n].copy()


@njit(cache=True, nogil=True)
def remember(blocks, hit, observed, void, seen_free, crossed):
    """Add a scan's bits, (B, 8) int64, to those of all scans.

    Void voxels, and voxels that rays crossed.
    """
    for b in range(len(blocks)):
        for word in range(8):
            seen_free[blocks[b], word] |= void[b, word]
            crossed[blocks[b], word] |= observed[b, word] & ~hit[b, word]
