"""Which rays of a scan end in boxes, and which pass through them."""

import math

import numpy as np
from numba import njit

MOST = 64  # groups of boxes: one bit of a uint64 each
TINY = 1e-300  # instead of a step of zero, whose inverse would not be a number
# bins along each edge of a cube around the sensor, in which rays look up the groups in their
# direction
SIDE = 32
# radians: no direction in a bin is farther from that of its middle
SPREAD = math.asin(math.sqrt(2.0) / SIDE)


@njit(cache=True, nogil=True)
def _in_direction(origin, low, high):
    """(6 SIDE^2,) uint64: the boxes, as bits, that a ray from the origin may meet if its direction
    is in each bin.
    """
    bins = np.zeros(6 * SIDE * SIDE, np.uint64)
    every = np.uint64(0)
    apart = np.empty((len(low), 3))
    reach = np.empty(len(low))
    along = np.empty(3)
    for b in range(len(low)):
        # of the ball around the box
        distance = 0.0
        radius = 0.0
        for axis in range(3):
            apart[b, axis] = (low[b, axis] + high[b, axis]) / 2 - origin[axis]
            distance += apart[b, axis] ** 2
            radius += ((high[b, axis] - low[b, axis]) / 2) ** 2
        if distance <= radius * 1.01:
            every |= np.uint64(1) << np.uint64(b)
        distance = max(math.sqrt(distance), TINY)
        for axis in range(3):
            apart[b, axis] /= distance
        reach[b] = (
            math.cos(min(math.asin(min(math.sqrt(radius) / distance, 1.0)) + SPREAD, math.pi))
            - 1e-6
        )
    for face in range(6):
        along[face % 3] = 1.0 if face < 3 else -1.0
        for row in range(SIDE):
            along[(face + 1) % 3] = (2 * row + 1) / SIDE - 1.0
            for column in range(SIDE):
                along[(face + 2) % 3] = (2 * column + 1) / SIDE - 1.0
                length = math.sqrt(along[0] ** 2 + along[1] ** 2 + along[2] ** 2)
                found = every
                for b in range(len(low)):
                    cosine = (
                        along[0] * apart[b, 0] + along[1] * apart[b, 1] + along[2] * apart[b, 2]
                    )
                    if cosine >= reach[b] * length:
                        found |= np.uint64(1) << np.uint64(b)
                bins[(face * SIDE + row) * SIDE + column] = found
    return bins


@njit(cache=True, nogil=True, inline="always")
def _bin(x, y, z):
    """The bin of a direction, which is not zero."""
    a = abs(x)
    b = abs(y)
    c = abs(z)
    if a >= b and a >= c:
        face = 0
        main = x
        first = y
        second = z
    elif b >= c:
        face = 1
        main = y
        first = z
        second = x
    else:
        face = 2
        main = z
        first = x
        second = y
    scale = 0.5 * SIDE / abs(main)
    row = min(int(first * scale + 0.5 * SIDE), SIDE - 1)
    column = min(int(second * scale + 0.5 * SIDE), SIDE - 1)
    return ((face if main > 0 else face + 3) * SIDE + row) * SIDE + column


@njit(cache=True, nogil=True, inline="always")
def _shares(ox, oy, oz, ix, iy, iz, low, high):
    """Where a ray enters and leaves a box, as shares of its length.

    Never between 0 and 1 if it misses the box.
    """
    first = (low[0] - ox) * ix
    second = (high[0] - ox) * ix
    enter = min(first, second)
    leave = max(first, second)
    first = (low[1] - oy) * iy
    second = (high[1] - oy) * iy
    enter = max(enter, min(first, second))
    leave = min(leave, max(first, second))
    first = (low[2] - oz) * iz
    second = (high[2] - oz) * iz
    return max(enter, min(first, second)), min(leave, max(first, second))


@njit(cache=True, nogil=True)
def _bounds(starts, low, high):
    """Corners (G, 3) of the box around each group of boxes; boxes with NaN do not count."""
    around_low = np.full((len(starts) - 1, 3), np.inf)
    around_high = np.full((len(starts) - 1, 3), -np.inf)
    for group in range(len(starts) - 1):
        for b in range(starts[group], starts[group + 1]):
            for axis in range(3):
                if low[b, axis] < around_low[group, axis]:
                    around_low[group, axis] = low[b, axis]
                if high[b, axis] > around_high[group, axis]:
                    around_high[group, axis] = high[b, axis]
    return around_low, around_high


@njit(cache=True, nogil=True)
def _doubled(array):
    """A copy with room for as many elements again."""
    larger = np.empty(2 * len(array), array.dtype)
    for i in range(len(array)):
        larger[i] = array[i]
    return larger


@njit(cache=True, nogil=True, error_model="numpy")
def touched(points, origins, starts, low, high):
    """The boxes that the rays of a scan touch, by a slab test of the boxes whose group they touch.

    Args:
        points: (N, 3) float32, metres, world frame: ends of the rays; a ray with a non-finite end
            touches nothing.
        origins: (1, 3) or (N, 3) float64, metres, world frame.
        starts: (G + 1,) int64: group g has the boxes from ``starts[g]`` to ``starts[g + 1]``; at
            most ``MOST`` groups.
        low, high: (B, 3) float64, metres, world frame: corners of the boxes.

    Returns:
        rays, boxes: (K,) int64, pairs in the order of rays.
        ends: (K,) bool: whether the box contains the end of the ray; otherwise the ray enters and
            leaves it before.
    """
    one = len(origins) == 1
    groups = len(starts) - 1
    count = 0
    rays = np.empty(1024, np.int64)
    boxes = np.empty(1024, np.int64)
    ends = np.empty(1024, np.bool_)
    around_low, around_high = _bounds(starts, low, high)
    bins = _in_direction(origins[0], around_low, around_high) if one else np.empty(0, np.uint64)
    all_groups = ~np.uint64(0) >> np.uint64(MOST - groups)
    for i in range(len(points)):
        o = origins[0 if one else i]
        ox = o[0]
        oy = o[1]
        oz = o[2]
        sx = points[i, 0] - ox
        sy = points[i, 1] - oy
        sz = points[i, 2] - oz
        if not abs(sx) + abs(sy) + abs(sz) < np.inf:
            continue
        near = bins[_bin(sx, sy, sz)] if one and (sx or sy or sz) else all_groups
        if not near:
            continue
        ix = 1.0 / (sx if sx else TINY)
        iy = 1.0 / (sy if sy else TINY)
        iz = 1.0 / (sz if sz else TINY)
        for group in range(groups):
            if not near >> np.uint64(group) & np.uint64(1):
                continue
            enter, leave = _shares(ox, oy, oz, ix, iy, iz, around_low[group], around_high[group])
            if enter > leave or leave < 0.0 or enter > 1.0:
                continue
            for b in range(starts[group], starts[group + 1]):
                enter, leave = _shares(ox, oy, oz, ix, iy, iz, low[b], high[b])
                if enter > leave or leave < 0.0 or enter > 1.0 or not (leave >= 1.0 or enter > 0.0):
                    continue
                if count == len(rays):
                    rays = _doubled(rays)
                    boxes = _doubled(boxes)
                    ends = _doubled(ends)
                rays[count] = i
                boxes[count] = b
                ends[count] = leave >= 1.0
                count += 1
    return rays[:count], boxes[:count], ends[:count]
