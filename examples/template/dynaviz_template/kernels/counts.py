"""Count the scans that have a point in each voxel."""

import numpy as np
from numba import njit

from dynaviz.kernels.hash_table import empty, slot_of


@njit(cache=True, nogil=True)
def add(keys, table, scans, used):
    """Add 1 to the count of each voxel.

    Args:
        keys: (K,) int64, packed voxels, each once.
        table: (2^k,) int64: the voxels so far, as in ``dynaviz.kernels.hash_table``.
        scans: (2^k,) int64: the number of scans of each of them.
        used: the number of voxels.

    Returns:
        table, scans, used: the same, in larger arrays if these were half full.
    """
    if 2 * (used + len(keys)) > len(table):
        larger = empty(2 * (used + len(keys)))
        moved = np.zeros(len(larger), np.int64)
        for row in range(len(table)):
            if table[row] >= 0:
                slot = slot_of(larger, table[row])
                larger[slot] = table[row]
                moved[slot] = scans[row]
        table = larger
        scans = moved
    for key in keys:
        slot = slot_of(table, key)
        if table[slot] < 0:
            table[slot] = key
            used += 1
        scans[slot] += 1
    return table, scans, used


@njit(cache=True, nogil=True)
def look_up(keys, table, scans):
    """(K,) int64: the number of scans of each voxel, 0 for unknown ones."""
    found = np.zeros(len(keys), np.int64)
    for k in range(len(keys)):
        slot = slot_of(table, keys[k])
        if table[slot] >= 0:
            found[k] = scans[slot]
    return found
