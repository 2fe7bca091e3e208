"""Which rays of a scan end in boxes, and which pass through them."""

import numpy as np
from numba import njit

MOST = 32  # boxes: one bit of a uint32 each


@njit(cache=True, nogil=True, inline="always")
def _crosses(o, p, low, high):
    """Whether the segment from o to p passes through a box that contains neither end (slab test)."""
    enter, leave = 0.0, 1.0
    for axis in range(3):
        step = np.float64(p[axis]) - o[axis]
        if step == 0.0:
            if o[axis] < low[axis] or o[axis] > high[axis]:
                return False
            continue
        first, second = (low[axis] - o[axis]) / step, (high[axis] - o[axis]) / step
        enter, leave = max(enter, min(first, second)), min(leave, max(first, second))
        if enter >= leave:
            return False
    return enter > 0.0 and leave < 1.0


@njit(cache=True, nogil=True)
def touched(points, origins, low, high):
    """The boxes that each ray of a scan touches, as bits: bit b stands for box b.

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
        p, o = points[i], origins[0 if one else i]
        if not np.isfinite(p).all():
            continue
        for b in range(len(low)):
            bit = np.uint32(1) << np.uint32(b)
            inside = True
            for axis in range(3):
                inside &= low[b, axis] <= p[axis] <= high[b, axis]
            if inside:
                hit[i] |= bit
            elif _crosses(o, p, low[b], high[b]):
                crossed[i] |= bit
    return hit, crossed
