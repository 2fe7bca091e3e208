"""Clusters of points: in adjacent voxels, and nearby clusters merged.

A voxel is a number, block * 512 + index in the block; ``neighbours`` (B, 27) are the numbers of the
blocks around each block. A cluster is identified by the first point that it grew from, so results
do not depend on the numbers of voxels.
"""

import math

import numpy as np
from numba import njit

from dynaviz.kernels.disjoint_sets import root_of, unite
from dynaviz.kernels.hash_table import empty, slot_of
from dynaviz.kernels.keys import REACH, X_SHIFT, Y_SHIFT


@njit(cache=True, nogil=True)
def _adjacent(voxel, side, neighbours):
    """The adjacent voxel at one of six sides; -1 if it has no block."""
    axis = side >> 1
    ahead = side & 1
    shift = 6 - 3 * axis
    block = voxel >> 9
    place = voxel & 511
    along = place >> shift & 7
    if along == (7 if ahead else 0):
        step = 9 if axis == 0 else (3 if axis == 1 else 1)
        block = np.int64(neighbours[block, 13 + (step if ahead else -step)])
        return block << 9 | place ^ 7 << shift if block >= 0 else np.int64(-1)
    return voxel + (1 << shift if ahead else -(1 << shift))


@njit(cache=True, nogil=True)
def grow(voxels, seeds, neighbours):
    """Cluster points by voxels that share a face.

    Voxels with a seed keep growing. Voxels with other points join the earliest cluster at their
    faces, but do not grow. The number of a cluster is the position of its first seed among the
    seeds' voxels.

    Args:
        voxels: (N,) int64, voxel of each point, -1 for none.
        seeds: (N,) bool.
        neighbours: (B, 27) int32.

    Returns:
        (N,) int32: cluster of each point, -1 for none.
    """
    n = seeds.sum()
    slots = empty(n)
    ranks = np.empty(len(slots), np.int64)
    own = np.empty(n, np.int64)
    parent = np.arange(n)
    count = 0
    for i in range(len(voxels)):
        if seeds[i]:
            s = slot_of(slots, voxels[i])
            if slots[s] < 0:
                slots[s] = voxels[i]
                ranks[s] = count
                own[count] = voxels[i]
                count += 1
    for k in range(count):
        for side in range(6):
            other = _adjacent(own[k], side, neighbours)
            if other >= 0:
                s = slot_of(slots, other)
                if slots[s] >= 0:
                    unite(parent, k, ranks[s])
    taken = empty(7 * count)
    roots = np.empty(len(taken), np.int64)
    for k in range(count):
        for side in range(-1, 6):  # the voxel itself first
            voxel = own[k] if side < 0 else _adjacent(own[k], side, neighbours)
            if voxel >= 0:
                s = slot_of(taken, voxel)
                root = root_of(parent, k)
                if side < 0 or taken[s] < 0:
                    taken[s] = voxel
                    roots[s] = root
                elif slots[slot_of(slots, voxel)] < 0:
                    roots[s] = min(roots[s], root)
    clusters = np.full(len(voxels), np.int32(-1))
    for i in range(len(voxels)):
        if voxels[i] >= 0:
            s = slot_of(taken, voxels[i])
            if taken[s] >= 0:
                clusters[i] = roots[s]
    return clusters


@njit(cache=True, nogil=True)
def merge(points, clusters, distance):
    """Merge clusters (N,) that have points (N, 3) closer than ``distance`` metres.

    The earliest number remains.
    """
    n = len(points)
    merged = clusters.copy()
    parent = np.arange(clusters.max() + 1 if n else 0)
    per_metre = 1.0 / distance
    slots = empty(n)
    heads = np.empty(len(slots), np.int64)
    # alike: a cell's points are in one cluster
    after = np.empty(n, np.int64)
    alike = np.ones(len(slots), np.bool_)
    for i in range(n):
        x = np.int64(math.floor(points[i, 0] * per_metre)) + REACH
        y = np.int64(math.floor(points[i, 1] * per_metre)) + REACH
        z = np.int64(math.floor(points[i, 2] * per_metre)) + REACH
        for j in range(27):  # compare with the points before this one
            key = (x + j // 9 - 1) << X_SHIFT | (y + j // 3 % 3 - 1) << Y_SHIFT | (z + j % 3 - 1)
            s = slot_of(slots, key)
            if slots[s] < 0:
                continue
            k = heads[s]
            if alike[s] and root_of(parent, clusters[k]) == root_of(parent, clusters[i]):
                continue
            while k >= 0:
                if root_of(parent, clusters[k]) != root_of(parent, clusters[i]):
                    dx = points[k, 0] - points[i, 0]
                    dy = points[k, 1] - points[i, 1]
                    dz = points[k, 2] - points[i, 2]
                    if dx * dx + dy * dy + dz * dz < distance * distance:
                        unite(parent, clusters[k], clusters[i])
                k = after[k]
        s = slot_of(slots, x << X_SHIFT | y << Y_SHIFT | z)
        if slots[s] < 0:
            slots[s] = x << X_SHIFT | y << Y_SHIFT | z
            after[i] = -1
        else:
            after[i] = heads[s]
            alike[s] &= clusters[heads[s]] == clusters[i]
        heads[s] = i
    for i in range(n):
        merged[i] = root_of(parent, clusters[i])
    return merged
