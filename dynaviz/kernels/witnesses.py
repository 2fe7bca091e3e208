"""Which rays of a scan end in boxes, and which pass through them."""

import math

import numpy as np
from numba import njit

MOST = 32  # boxes: one bit of a uint32 each
TINY = 1e-300  # instead of a step of zero, whose inverse would not be a number
SIDE = 32  # bins along each edge of a cube around the sensor, in which rays look up the boxes in their direction
SPREAD = math.asin(math.sqrt(2.0) / SIDE)  # radians: no direction in a bin is farther from that of its middle


@njit(cache=True, nogil=True)
def _in_direction(origin, low, high):
    """(6 SIDE^2,) uint32: the boxes, as bits, that a ray from the origin may meet if its direction is in each bin."""
    bins, every = np.zeros(6 * SIDE * SIDE, np.uint32), np.uint32(0)
    apart, reach, along = np.empty((len(low), 3)), np.empty(len(low)), np.empty(3)
    for b in range(len(low)):
        distance, radius = 0.0, 0.0  # of the ball around the box
        for axis in range(3):
            apart[b, axis] = (low[b, axis] + high[b, axis]) / 2 - origin[axis]
            distance += apart[b, axis] ** 2
            radius += ((high[b, axis] - low[b, axis]) / 2) ** 2
        if distance <= radius * 1.01:
            every |= np.uint32(1) << np.uint32(b)
        distance = max(math.sqrt(distance), TINY)
        apart[b] /= distance
        reach[b] = math.cos(min(math.asin(min(math.sqrt(radius) / distance, 1.0)) + SPREAD, math.pi)) - 1e-6
    for face in range(6):
        along[face % 3] = 1.0 if face < 3 else -1.0
        for row in range(SIDE):
            along[(face + 1) % 3] = (2 * row + 1) / SIDE - 1.0
            for column in range(SIDE):
                along[(face + 2) % 3] = (2 * column + 1) / SIDE - 1.0
                length, found = math.sqrt(along[0] ** 2 + along[1] ** 2 + along[2] ** 2), every
                for b in range(len(low)):
                    cosine = along[0] * apart[b, 0] + along[1] * apart[b, 1] + along[2] * apart[b, 2]
                    if cosine >= reach[b] * length:
                        found |= np.uint32(1) << np.uint32(b)
                bins[(face * SIDE + row) * SIDE + column] = found
    return bins


@njit(cache=True, nogil=True, inline="always")
def _bin(x, y, z):
    """The bin of a direction, which is not zero."""
    a, b, c = abs(x), abs(y), abs(z)
    if a >= b and a >= c:
        face, main, first, second = 0, x, y, z
    elif b >= c:
        face, main, first, second = 1, y, z, x
    else:
        face, main, first, second = 2, z, x, y
    scale = 0.5 * SIDE / abs(main)
    row = min(int(first * scale + 0.5 * SIDE), SIDE - 1)
    column = min(int(second * scale + 0.5 * SIDE), SIDE - 1)
    return ((face if main > 0 else face + 3) * SIDE + row) * SIDE + column


@njit(cache=True, nogil=True, error_model="numpy")
def touched(points, origins, low, high):
    """The boxes that each ray of a scan touches, as bits: bit b stands for box b.

    A slab test, for rays with a common origin only of the boxes in their direction.

    Args:
        points: (N, 3) float32, metres, world frame: ends of the rays; a ray with a non-finite end touches nothing.
        origins: (1, 3) or (N, 3) float64, metres, world frame.
        low, high: (B, 3) float64, metres, world frame: corners of the boxes, at most ``MOST``.

    Returns:
        hit: (N,) uint32, boxes that contain the end of the ray.
        crossed: (N,) uint32, boxes that the ray enters and leaves before its end.
    """
    n, one = len(points), len(origins) == 1
    hit, crossed = np.zeros(n, np.uint32), np.zeros(n, np.uint32)
    bins = _in_direction(origins[0], low, high) if one else np.empty(0, np.uint32)
    all_boxes = np.uint32((np.uint64(1) << np.uint64(len(low))) - np.uint64(1))
    for i in range(n):
        o = origins[0 if one else i]
        ox, oy, oz = o[0], o[1], o[2]
        sx, sy, sz = points[i, 0] - ox, points[i, 1] - oy, points[i, 2] - oz
        if not abs(sx) + abs(sy) + abs(sz) < np.inf:
            continue
        near = bins[_bin(sx, sy, sz)] if one and (sx or sy or sz) else all_boxes
        if not near:
            continue
        ix, iy, iz = 1.0 / (sx if sx else TINY), 1.0 / (sy if sy else TINY), 1.0 / (sz if sz else TINY)
        for b in range(len(low)):
            if not near >> np.uint32(b) & np.uint32(1):
                continue
            # As shares of the way from the origin to the end of the ray.
            first, second = (low[b, 0] - ox) * ix, (high[b, 0] - ox) * ix
            enter, leave = min(first, second), max(first, second)
            if leave < 0.0 or enter > 1.0:
                continue
            first, second = (low[b, 1] - oy) * iy, (high[b, 1] - oy) * iy
            enter, leave = max(enter, min(first, second)), min(leave, max(first, second))
            if enter > leave or leave < 0.0 or enter > 1.0:
                continue
            first, second = (low[b, 2] - oz) * iz, (high[b, 2] - oz) * iz
            enter, leave = max(enter, min(first, second)), min(leave, max(first, second))
            if enter > leave or leave < 0.0 or enter > 1.0:
                continue
            if leave >= 1.0:
                hit[i] |= np.uint32(1) << np.uint32(b)
            elif enter > 0.0:
                crossed[i] |= np.uint32(1) << np.uint32(b)
    return hit, crossed
