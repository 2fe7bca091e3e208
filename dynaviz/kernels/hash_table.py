"""A hash table of keys: (2^k,) int64, -1 where a slot is free; keys are 0 or more.

Keep at least half of the slots free. What belongs to a key is in other arrays, at its slot.
"""

import numpy as np
from numba import njit

GOLDEN = np.uint64(0x9E3779B97F4A7C15)


@njit(cache=True, nogil=True, inline="always")
def first_slot(key, mask):
    """The slot from which to search for a key; ``mask`` is the length of the table less 1.

    The key is mixed twice: after one product, no bit depends on the axes in higher bits.
    """
    h = np.uint64(key) * GOLDEN
    h = (h ^ (h >> np.uint64(32))) * GOLDEN
    return np.int64(h >> np.uint64(32)) & mask


@njit(cache=True, nogil=True, inline="always")
def slot_of(keys, key):
    """The slot of a key, or the free slot where it would be inserted."""
    mask = len(keys) - 1
    s = first_slot(key, mask)
    while keys[s] >= 0 and keys[s] != key:
        s = (s + 1) & mask
    return s


@njit(cache=True, nogil=True)
def empty(entries):
    """A table with room for so many keys."""
    size = 16
    while size < 2 * entries:
        size *= 2
    return np.full(size, np.int64(-1))
