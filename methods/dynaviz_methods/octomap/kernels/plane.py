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
        (4,) float64: normal and offset, metres; and the number of inliers, 0 if no sample gives a
        plane.
    """
    best = np.zeros(4)
    most = 0
    needed = float(len(samples))
    for k in range(len(samples)):
        if k >= needed:
            break
        a = samples[k, 0]
        b = samples[k, 1]
        c = samples[k, 2]
        ax = float(points[a, 0])
        ay = float(points[a, 1])
        az = float(points[a, 2])
        ux = points[b, 0] - ax
        uy = points[b, 1] - ay
        uz = points[b, 2] - az
        vx = points[c, 0] - ax
        vy = points[c, 1] - ay
        vz = points[c, 2] - az
        nx = uy * vz - uz * vy
        ny = uz * vx - ux * vz
        nz = ux * vy - uy * vx
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        if not abs(nz) >= least_up * length or length == 0.0:
            continue
        nx = nx / length
        ny = ny / length
        nz = nz / length
        offset = nx * ax + ny * ay + nz * az
        near = 0
        for i in range(len(points)):
            near += (
                abs(nx * points[i, 0] + ny * points[i, 1] + nz * points[i, 2] - offset) < distance
            )
        if near > most:
            most = near
            best[0] = nx
            best[1] = ny
            best[2] = nz
            best[3] = offset
            share = near / len(points)
            needed = math.log(1.0 - confidence) / math.log1p(-min(share**3, 1.0 - 1e-15))
    return best, most
