"""One point per voxel, and how often its points were labelled static and dynamic."""

import math

import numpy as np
from numba import njit

MOST = np.uint16(65535)


@njit(cache=True, nogil=True)
def add(points, voxels, dynamic, per_metre, static_count, dynamic_count, within):
    """Count the labels of points; the first static one stands for its voxel.

    Args:
        points: (N, 3) float32, metres, world frame.
        voxels: (N,) int64, -1 for none.
        dynamic: (N,) bool.
        per_metre: voxels per metre.
        static_count, dynamic_count: (B, 512) uint16. Modified.
        within: (B, 512, 3) uint8: where in its voxel the point lies, in 256ths of its edge.
            Modified.
    """
    for i in range(len(voxels)):
        if voxels[i] < 0:
            continue
        block = voxels[i] >> 9
        v = voxels[i] & 511
        if dynamic[i]:
            if dynamic_count[block, v] < MOST:
                dynamic_count[block, v] += 1
            continue
        if static_count[block, v] == 0:
            for axis in range(3):
                place = points[i, axis] * per_metre
                within[block, v, axis] = min(255, int((place - math.floor(place)) * 256))
        if static_count[block, v] < MOST:
            static_count[block, v] += 1


@njit(cache=True, nogil=True)
def points(exists, blocks, size, static_count, dynamic_count, within):
    """(M, 3) float32, metres.

    The points of voxels, of edge ``size``, labelled static more often than dynamic.
    """
    count = 0
    for block in range(len(exists)):
        if exists[block]:
            for v in range(512):
                count += static_count[block, v] > dynamic_count[block, v]
    found = np.empty((count, 3), np.float32)
    count = 0
    for block in range(len(exists)):
        if exists[block]:
            for v in range(512):
                if static_count[block, v] > dynamic_count[block, v]:
                    for axis in range(3):
                        key = blocks[block, axis] << 3 | v >> (6 - 3 * axis) & 7
                        found[count, axis] = (key + (within[block, v, axis] + 0.5) / 256) * size
                    count += 1
    return found
