"""Region-wise ground plane fitting (R-GPF; Lim et al. 2021): one plane for the points of each bin."""

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def fit(points, starts, skip, lowest, seed_height, distance, iterations, upward):
    """Which points are ground of their bin.

    Args:
        points: (K, 3) float64, metres, from the foot of the sensor; those of a bin follow each other.
        starts: (B + 1,) int64: where each bin begins, and the end.
        skip, lowest: so many of a bin's lowest points are passed over; the mean height of so many after them counts.
        seed_height: metres; points lower than this above that mean begin as ground. It is 0 where no point is left.
        distance: metres; points below the plane, or less than this above it, are ground.
        iterations: planes fitted one after another, each to the ground of the one before.
        upward: turn each normal up; else it stays on the side of the axis that the rotations brought there.

    Returns:
        (K,) bool.
    """
    ground = np.zeros(len(points), np.bool_)
    lows = np.empty(skip + lowest)
    A = np.empty((3, 3))
    V = np.empty((3, 3))
    for b in range(len(starts) - 1):
        first, last = starts[b], starts[b + 1]
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
            cx, cy, cz, m = 0.0, 0.0, 0.0, 0
            for i in range(first, last):
                if ground[i]:
                    cx, cy, cz, m = cx + points[i, 0], cy + points[i, 1], cz + points[i, 2], m + 1
            if m == 0:
                break
            cx, cy, cz = cx / m, cy / m, cz / m
            A[:] = 0
            for i in range(first, last):
                if ground[i]:
                    x, y, z = points[i, 0] - cx, points[i, 1] - cy, points[i, 2] - cz
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
            nx, ny, nz = turn * V[0, k], turn * V[1, k], turn * V[2, k]
            for i in range(first, last):
                x, y, z = points[i, 0] - cx, points[i, 1] - cy, points[i, 2] - cz
                ground[i] = nx * x + ny * y + nz * z < distance
    return ground


@njit(cache=True, nogil=True)
def _diagonalise(A, V):
    """Jacobi's rotations of a symmetric (3, 3), of which the lower half is read: eigenvalues stay on A's diagonal.

    No rotation turns by more than 45 degrees, so an eigenvector keeps the side of the axis that it came from.
    """
    V[:] = 0
    for axis in range(3):
        V[axis, axis] = 1
    A[0, 1], A[0, 2], A[1, 2] = A[1, 0], A[2, 0], A[2, 1]
    for _ in range(10):  # it converges quadratically: 4 or 5 are enough
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
