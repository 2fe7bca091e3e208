"""The points of a frame by class, and one of them per voxel, for recordings.

Single passes over the points.
"""

import math

import numpy as np
from numba import njit

from dynaviz.kernels.hash_table import slot_of
from dynaviz.kernels.keys import BITS, REACH

GOLDEN = np.uint64(0x9E3779B97F4A7C15)


@njit(cache=True, nogil=True)
def by_class(classes, points, middle, limit, count):
    """The rows of each class, without points that are not finite or too far away.

    Args:
        classes: (N,) uint8, below ``count``.
        points: (N, 3) float32, metres.
        middle: (3,) float32, metres.
        limit: metres from the middle along each axis; points at this distance are left out.
        count: number of classes.

    Returns:
        rows: (K,) int64, those of the first class first, ascending in each class.
        bounds: (count + 1,) int64: class c has ``rows[bounds[c] : bounds[c + 1]]``.
    """
    bounds = np.zeros(count + 1, np.int64)
    kinds = np.empty(len(points), np.uint8)
    for i in range(len(points)):
        near = True
        for axis in range(3):
            near &= abs(points[i, axis] - middle[axis]) < limit  # false if not finite
        kinds[i] = classes[i] if near else count
        if near:
            bounds[classes[i] + 1] += 1
    for c in range(count):
        bounds[c + 1] += bounds[c]
    rows = np.empty(bounds[count], np.int64)
    ends = bounds.copy()
    for i in range(len(points)):
        c = kinds[i]
        if c < count:
            rows[ends[c]] = i
            ends[c] += 1
    return rows, bounds


@njit(cache=True, nogil=True)
def range_bands(points, origins, limits):
    """(N,) uint8: number of limits that the range of each point reaches.

    All of them if it is not finite.

    Args:
        points: (N, 3) float32, metres.
        origins: (1, 3) or (N, 3) float32, metres: where the rays start.
        limits: (L,) float32, square metres.
    """
    bands = np.zeros(len(points), np.uint8)
    step = np.int64(len(origins) > 1)
    for i in range(len(points)):
        x = points[i, 0] - origins[step * i, 0]
        y = points[i, 1] - origins[step * i, 1]
        z = points[i, 2] - origins[step * i, 2]
        squared = x * x + y * y + z * z  # in float32, as ``Scan.squared_ranges``
        for limit in limits:
            bands[i] += not squared < limit
    return bands


@njit(cache=True, nogil=True, inline="always")
def _key(points, row, middle, inverse):
    """The packed key of a point's voxel, counted from the middle."""
    key = np.int64(0)
    for axis in range(3):
        key = (
            key << BITS | np.int64(math.floor((points[row, axis] - middle[axis]) * inverse)) + REACH
        )
    return key


@njit(cache=True, nogil=True)
def in_new_voxels(slots, points, rows, middle, size):
    """Insert the voxels of points into a set, and find the first point of each new one.

    Args:
        slots: (2^k,) int64, the set, as in ``voxels.insert``: keys, -1 if free; at least half of it
            remains free.
        points: (N, 3) float32, metres.
        rows: (K,) int64, the points to insert; finite, and at most 2^20 voxels from the middle.
        middle: (3,) float32, metres: the corner of voxel (0, 0, 0).
        size: metres: edge of a voxel.

    Returns:
        int64, those of the rows that are the first in a new voxel, in their order.
    """
    kept = np.empty(len(rows), np.int64)
    count = 0
    last = np.int64(-1)
    inverse = 1.0 / size
    for row in rows:
        key = _key(points, row, middle, inverse)
        if key == last:  # neighbours in a scan mostly share a voxel
            continue
        last = key
        s = slot_of(slots, key)
        if slots[s] < 0:
            slots[s] = key
            kept[count] = row
            count += 1
    return kept[:count]


@njit(cache=True, nogil=True)
def downsampled(points, rows, middle, size):
    """One point per voxel.

    Args:
        points, rows, middle, size: as in ``in_new_voxels``.

    Returns:
        chosen: (M,) int64, those of the rows that are the first in their voxel, in their order.
        counts: (M,) int64, number of the rows in that voxel.
    """
    room = 16
    while room < 2 * len(rows):
        room *= 2
    slots = np.full(room, np.int64(-1))
    owners = np.empty(room, np.int32)
    chosen = np.empty(len(rows), np.int64)
    counts = np.empty(len(rows), np.int64)
    count = 0
    inverse = 1.0 / size
    last = np.int64(-1)
    owner = 0
    for row in rows:
        key = _key(points, row, middle, inverse)
        if key != last:
            last = key
            s = slot_of(slots, key)
            if slots[s] < 0:
                slots[s] = key
                owners[s] = count
                chosen[count] = row
                counts[count] = 0
                count += 1
            owner = owners[s]
        counts[owner] += 1
    return chosen[:count], counts[:count]
