"""Packed voxel keys and a hash set of them."""

import math

import numpy as np
from numba import njit

from dynaviz.arrays import F32, I64, Bool
from dynaviz.kernels.hash_table import slot_of
from dynaviz.kernels.keys import BITS, REACH

Keys = I64


@njit(cache=True, nogil=True)
def pack(points: F32, size: float) -> tuple[Keys, bool]:
    """(N,) int64: packed keys of points (N, 3), metres, with voxels of edge ``size`` metres.

    And whether all fit.
    """
    keys = np.empty(len(points), np.int64)
    inverse = 1.0 / size
    for i in range(len(points)):
        key = np.int64(0)
        for axis in range(3):
            k = math.floor(points[i, axis] * inverse)
            if not (-REACH <= k < REACH):  # also false for NaN
                return keys, False
            key = (key << BITS) | (np.int64(k) + REACH)
        keys[i] = key
    return keys, True


@njit(cache=True, nogil=True)
def insert(slots: Keys, keys: Keys) -> Bool:
    """Insert keys (N,) into a table whose size is a power of two (-1: free).

    Return (N,) bool, True for new keys.
    """
    new = np.zeros(len(keys), np.bool_)
    for i in range(len(keys)):
        s = slot_of(slots, keys[i])
        if slots[s] < 0:
            slots[s] = keys[i]
            new[i] = True
    return new


@njit(cache=True, nogil=True)
def rehash(slots: Keys, size: int) -> Keys:
    """The same set in a table of another size, a power of two."""
    bigger = np.full(size, np.int64(-1))
    for i in range(len(slots)):
        if slots[i] >= 0:
            bigger[slot_of(bigger, slots[i])] = slots[i]
    return bigger
