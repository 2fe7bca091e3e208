"""Which rays of a scan end in boxes, and which pass through them."""

import numpy as np
from numba import njit

MOST = 32  # boxes: one bit of a uint32 each
TINY = 1e-300  # instead of a step of zero, whose inverse would not be a number


@njit(cache=True, nogil=True, error_model="numpy")
def touched(points, origins, low, high):
    """The boxes that each ray of a scan touches, as bits: bit b stands for box b. Slab test.

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
    for i in range(n):
        o = origins[0 if one else i]
        ox, oy, oz = o[0], o[1], o[2]
        sx, sy, sz = points[i, 0] - ox, points[i, 1] - oy, points[i, 2] - oz
        if not abs(sx) + abs(sy) + abs(sz) < np.inf:
            continue
        ix, iy, iz = 1.0 / (sx if sx else TINY), 1.0 / (sy if sy else TINY), 1.0 / (sz if sz else TINY)
        for b in range(len(low)):
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
