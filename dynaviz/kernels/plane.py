"""RANSAC plane fit."""

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def from_samples(points, samples, distance, least_up, confidence):
    """The near-horizontal plane through three sampled points that has the most inliers.

    Stops early once a better plane is less likely than 1 - confidence.

    Args:
        points: (N, 3) float32, metres.
        samples: (K, 3) int64, rows of the points of each sample.
        distance: inlier distance, metres.
        least_up: minimum absolute z component of the unit normal.
        confidence: probability of having found the best plane.

    Returns:
        (4,) float64: normal and offset, metres; and the number of inliers, 0 if no sample gives a plane.
    """
    best, most, needed = np.zeros(4), 0, float(len(samples))
    for k in range(len(samples)):
        if k >= needed:
            break
        a, b, c = samples[k, 0], samples[k, 1], samples[k, 2]
        ax, ay, az = float(points[a, 0]), float(points[a, 1]), float(points[a, 2])
        ux, uy, uz = points[b, 0] - ax, points[b, 1] - ay, points[b, 2] - az
        vx, vy, vz = points[c, 0] - ax, points[c, 1] - ay, points[c, 2] - az
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        if not abs(nz) >= least_up * length or length == 0.0:
            continue
        nx, ny, nz = nx / length, ny / length, nz / length
        offset = nx * ax + ny * ay + nz * az
        near = 0
        for i in range(len(points)):
            near += abs(nx * points[i, 0] + ny * points[i, 1] + nz * points[i, 2] - offset) < distance
        if near > most:
            most = near
            best[0], best[1], best[2], best[3] = nx, ny, nz, offset
            share = near / len(points)
            needed = math.log(1.0 - confidence) / math.log1p(-min(share**3, 1.0 - 1e-15))
    return best, most
