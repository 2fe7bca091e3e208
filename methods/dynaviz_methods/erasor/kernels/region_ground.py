"""Region-wise ground plane fitting (R-GPF; Lim et al. 2021): one plane per bin."""

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def fit(points, starts, skip, lowest, seed_height, distance, iterations, upward):
    """Find the ground points of each bin.

    Args:
        points: (K, 3) float64, metres, relative to the ground below the sensor; sorted by bin.
        starts: (B + 1,) int64: first point of each bin, and the end.
        skip: number of lowest points of a bin to skip.
        lowest: number of points after them whose mean height is the lowest ground; it is 0 if no
            points are left.
        seed_height: points less than this above the lowest ground seed the fit, metres.
        distance: points below the plane, or less than this above it, are ground, metres.
        iterations: number of plane fits, each to the ground points of the previous one.
        upward: orient the normals upwards; otherwise they keep the side that the Jacobi rotations
            give.

    Returns:
        (K,) bool: ground points.
    """
    ground = np.zeros(len(points), np.bool_)
    lows = np.empty(skip + lowest)
    A = np.empty((3, 3))
    V = np.empty((3, 3))
    for b in range(len(starts) - 1):
        first = starts[b]
        last = starts[b + 1]
        n = 0  # the lowest heights, sorted
        for i in range(first, last):
            z = points[i, 2]
            if n == len(lows) and z >= lows[n - 1]:
                continue
            k = min(n, len(lows) - 1)
            n = k + 1
            while k > 0 and lows[k - 1] > z:
                lows[k] = lows[k - 1]
                k -= 1
            lows[k] = z
        seeds = lows[skip:n].mean() + seed_height if n > skip else seed_height
        for i in range(first, last):
            ground[i] = points[i, 2] < seeds
        for _ in range(iterations):
            cx = 0.0
            cy = 0.0
            cz = 0.0
            m = 0
            for i in range(first, last):
                if ground[i]:
                    cx = cx + points[i, 0]
                    cy = cy + points[i, 1]
                    cz = cz + points[i, 2]
                    m = m + 1
            if m == 0:
                break
            cx = cx / m
            cy = cy / m
            cz = cz / m
            A[:] = 0
            for i in range(first, last):
                if ground[i]:
                    x = points[i, 0] - cx
                    y = points[i, 1] - cy
                    z = points[i, 2] - cz
                    A[0, 0] += x * x
                    A[1, 1] += y * y
                    A[2, 2] += z * z
                    A[1, 0] += x * y
                    A[2, 0] += x * z
                    A[2, 1] += y * z
            _diagonalise(A, V)
            k = 0
            for axis in range(1, 3):
                if A[axis, axis] < A[k, k]:
                    k = axis
            turn = -1.0 if upward and V[2, k] < 0 else 1.0
            nx = turn * V[0, k]
            ny = turn * V[1, k]
            nz = turn * V[2, k]
            for i in range(first, last):
                x = points[i, 0] - cx
                y = points[i, 1] - cy
                z = points[i, 2] - cz
                ground[i] = nx * x + ny * y + nz * z < distance
    return ground


@njit(cache=True, nogil=True)
def _diagonalise(A, V):
    """Jacobi eigenvalue algorithm for a symmetric (3, 3) matrix A, of which the lower half is read.

    Afterwards A's diagonal contains the eigenvalues, and V's columns the eigenvectors. No rotation
    exceeds 45 degrees, so an eigenvector stays on the side of the axis that it started from.
    """
    V[:] = 0
    for axis in range(3):
        V[axis, axis] = 1
    A[0, 1] = A[1, 0]
    A[0, 2] = A[2, 0]
    A[1, 2] = A[2, 1]
    for _ in range(10):  # converges quadratically; 4 or 5 sweeps are enough
        for p in range(1, 3):
            for q in range(p):
                if abs(A[p, q]) <= 1e-12 * math.sqrt(abs(A[p, p] * A[q, q])):
                    continue
                tau = (A[q, q] - A[p, p]) / (2 * A[p, q])
                t = (1.0 if tau >= 0 else -1.0) / (abs(tau) + math.sqrt(1 + tau * tau))
                c = 1 / math.sqrt(1 + t * t)
                s = t * c
                for k in range(3):
                    A[k, p], A[k, q] = c * A[k, p] - s * A[k, q], s * A[k, p] + c * A[k, q]
                for k in range(3):
                    A[p, k], A[q, k] = c * A[p, k] - s * A[q, k], s * A[p, k] + c * A[q, k]
                for k in range(3):
                    V[k, p], V[k, q] = c * V[k, p] - s * V[k, q], s * V[k, p] + c * V[k, q]
