"""A cloud downsampled to one centroid per voxel, in the order in which the voxels first occur."""

import math

import numpy as np
from numba import njit

from dynaviz.kernels.hash_table import first_slot
from dynaviz.kernels.keys import BITS, REACH


@njit(cache=True, nogil=True)
def number(points, size):
    """Number the voxels of a cloud.

    Indices are computed from float32 products, as in PCL's VoxelGrid, so that points on a border
    fall into the same voxel as there.

    Args:
        points: (N, 3) float32, metres.
        size: edge of a voxel, metres.

    Returns:
        (N,) int32: number of each point's voxel; -1 for points that are not finite or beyond reach.
        The number of voxels.
    """
    numbers = np.empty(len(points), np.int32)
    slots = np.full(1 << 12, np.int32(-1))
    keys = np.empty(1 << 11, np.int64)
    mask = len(slots) - 1
    inverse = np.float32(1.0 / size)
    voxels = 0
    for i in range(len(points)):
        key = np.int64(0)
        for axis in range(3):
            k = math.floor(points[i, axis] * inverse)
            if not (-REACH <= k < REACH):  # also where not finite
                key = np.int64(-1)
                break
            key = (key << BITS) | (np.int64(k) + REACH)
        if key < 0:
            numbers[i] = -1
            continue
        s = first_slot(key, mask)
        while slots[s] >= 0 and keys[slots[s]] != key:
            s = (s + 1) & mask
        if slots[s] < 0:
            slots[s] = voxels
            keys[voxels] = key
            voxels += 1
        numbers[i] = slots[s]
        if voxels == len(keys):  # half full: move the voxels to a table of twice the size
            more = np.empty(2 * voxels, np.int64)
            for v in range(voxels):
                more[v] = keys[v]
            keys = more
            slots = np.full(4 * voxels, np.int32(-1))
            mask = len(slots) - 1
            for v in range(voxels):
                s = first_slot(keys[v], mask)
                while slots[s] >= 0:
                    s = (s + 1) & mask
                slots[s] = v
    return numbers, voxels


@njit(cache=True, nogil=True)
def means(points, numbers, voxels):
    """(V, 3) float32, metres: centroid of the points (N, 3) of each voxel, numbered (N,).

    -1 is ignored.
    """
    sums = np.zeros((voxels, 3), np.float64)
    counts = np.zeros(voxels, np.int64)
    for i in range(len(points)):
        v = numbers[i]
        if v >= 0:
            counts[v] += 1
            for axis in range(3):
                sums[v, axis] += points[i, axis]
    centroids = np.empty((voxels, 3), np.float32)
    for v in range(voxels):
        for axis in range(3):
            centroids[v, axis] = sums[v, axis] / counts[v]
    return centroids
