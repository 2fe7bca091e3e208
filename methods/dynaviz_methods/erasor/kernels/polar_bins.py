"""Polar bins around the sensor, rings times sectors, and the heights that points span in them."""

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def locate(points, spans, gone, centre, max_range, rings, sectors, low, high):
    """Find the points within range of the sensor, and their bins.

    Args:
        points: (N, 3) float32, metres, world frame.
        spans: (S, 2) int64: rows to search, as [first, end).
        gone: (N,) bool: rows to skip.
        centre: (3,) float64, metres, world frame: the sensor in x and y, and height 0 in z.
        max_range: radius in x and y, metres, exclusive.
        rings, sectors: number of bins along a radius and around the sensor.
        low, high: height band above height 0, metres, exclusive.

    Returns:
        rows: (K,) int32: rows of the points, in order.
        bins: (K,) int32: ring * sectors + sector; -1 outside the height band.
    """
    room = 0
    for s in range(len(spans)):
        room += spans[s, 1] - spans[s, 0]
    rows = np.empty(room, np.int32)
    bins = np.empty(room, np.int32)
    rings_per_metre = rings / max_range
    sectors_per_radian = sectors / (2 * math.pi)
    found = 0
    for s in range(len(spans)):
        for i in range(spans[s, 0], spans[s, 1]):
            x = points[i, 0] - centre[0]
            y = points[i, 1] - centre[1]
            z = points[i, 2] - centre[2]
            squared = x * x + y * y
            if gone[i] or not squared < max_range * max_range:
                continue
            rows[found] = i
            bins[found] = -1
            if low < z < high:
                ring = min(int(math.sqrt(squared) * rings_per_metre), rings - 1)
                azimuth = math.atan2(y, x)
                if azimuth < 0:
                    azimuth += 2 * math.pi
                sector = min(int(azimuth * sectors_per_radian), sectors - 1)
                bins[found] = ring * sectors + sector
            found += 1
    return rows[:found], bins[:found]


@njit(cache=True, nogil=True)
def heights(points, rows, bins, n):
    """(n,) float64, metres: highest minus lowest point of each bin, NaN if empty; and (n,) int64.

    Number of points.

    Points (N, 3) float32, metres; rows and bins (K,) as from ``locate``.
    """
    low = np.full(n, np.inf)
    high = np.full(n, -np.inf)
    counts = np.zeros(n, np.int64)
    for k in range(len(rows)):
        b = bins[k]
        if b >= 0:
            z = points[rows[k], 2]
            low[b] = min(low[b], z)
            high[b] = max(high[b], z)
            counts[b] += 1
    return np.where(counts > 0, high - low, np.nan), counts
