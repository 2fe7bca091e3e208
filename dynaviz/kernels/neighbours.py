"""Exact mean distances to the nearest neighbours, on a balanced k-d tree whose leaves are searched as a whole.

Node j of level l holds the points from j * M >> l up to (j + 1) * M >> l in the order of the tree.
"""

import math

import numpy as np
from numba import njit, prange

LEAF = 32  # points in a leaf, at most
SLACK = 1.000001  # on bounds: more than any rounding


@njit(cache=True, nogil=True, inline="always")
def _swap(xyz, order, a, b):
    for axis in range(3):
        xyz[axis, a], xyz[axis, b] = xyz[axis, b], xyz[axis, a]
    order[a], order[b] = order[b], order[a]


@njit(cache=True, nogil=True)
def _split(xyz, order, axis, first, last, middle):
    """Reorder first ... last so that none before the middle is greater, none after it smaller."""
    while first < last:
        pivot = xyz[axis, (first + last) >> 1]
        a, b = first, last
        while a <= b:
            while xyz[axis, a] < pivot:
                a += 1
            while xyz[axis, b] > pivot:
                b -= 1
            if a <= b:
                _swap(xyz, order, a, b)
                a += 1
                b -= 1
        if middle <= b:
            last = b
        elif middle >= a:
            first = a
        else:
            return


@njit(cache=True, nogil=True)
def tree(points):
    """Coordinates (3, M) and indices (M,) of finite points in the order of the tree, its depth, its nodes' boxes."""
    m, depth = len(points), 0
    while m >> depth > LEAF:
        depth += 1
    xyz, order = points.T.astype(np.float64), np.arange(m)
    boxes = np.empty((2 << depth, 6), np.float64)
    for level in range(depth + 1):
        for j in range(1 << level):
            first, last = (j * m) >> level, (((j + 1) * m) >> level) - 1
            widest, width = 0, -1.0
            for axis in range(3):
                low = high = xyz[axis, first]
                for i in range(first + 1, last + 1):
                    low, high = min(low, xyz[axis, i]), max(high, xyz[axis, i])
                boxes[(1 << level) + j, axis], boxes[(1 << level) + j, 3 + axis] = low, high
                if high - low > width:
                    widest, width = axis, high - low
            if level < depth:
                _split(xyz, order, widest, first, last, ((2 * j + 1) * m) >> (level + 1))
    return xyz, order, depth, boxes


@njit(cache=True, nogil=True)
def _smallest(values, n, k):
    """Move the k smallest of the first n values to the front."""
    first, last = 0, n - 1
    while first < last:
        pivot = values[(first + last) >> 1]
        a, b = first, last
        while a <= b:
            while values[a] < pivot:
                a += 1
            while values[b] > pivot:
                b -= 1
            if a <= b:
                values[a], values[b] = values[b], values[a]
                a += 1
                b -= 1
        if k - 1 <= b:
            last = b
        elif k - 1 >= a:
            first = a
        else:
            return


@njit(cache=True, nogil=True)
def _squares(xyz, first, last, i, out):
    """Squared distances of point i to the points first ... last - 1."""
    x, y, z = xyz[0, i], xyz[1, i], xyz[2, i]
    for c in range(first, last):
        dx, dy, dz = xyz[0, c] - x, xyz[1, c] - y, xyz[2, c] - z
        out[c - first] = dx * dx + dy * dy + dz * dz


@njit(cache=True, nogil=True)
def _gather(xyz, boxes, depth, leaf, reach, near, stack):
    """Copy the points of all leaves within reach of a leaf's box; returns their number."""
    m, n, top, own = xyz.shape[1], 0, 1, boxes[(1 << depth) + leaf]
    stack[0] = 1
    while top:
        top -= 1
        node = stack[top]
        square = 0.0
        for axis in range(3):
            gap = max(boxes[node, axis] - own[3 + axis], own[axis] - boxes[node, 3 + axis], 0.0)
            square += gap * gap
        if square > reach * reach:
            continue
        if node < 1 << depth:
            stack[top], stack[top + 1] = 2 * node, 2 * node + 1
            top += 2
            continue
        j = node - (1 << depth)
        for i in range((j * m) >> depth, ((j + 1) * m) >> depth):
            near[0, n], near[1, n], near[2, n] = xyz[0, i], xyz[1, i], xyz[2, i]
            n += 1
    return n


@njit(cache=True, nogil=True)
def _leaf_means(xyz, order, boxes, depth, leaf, k, near, squares, kept, stack, means):
    """Mean distances for the points of one leaf."""
    m, level = xyz.shape[1], depth
    first, last = (leaf * m) >> depth, ((leaf + 1) * m) >> depth
    # The k nearest of any part of the tree bound the distance of the k nearest of all.
    while level and m >> level <= 2 * k:
        level -= 1
    j = leaf >> (depth - level)
    lo, hi = (j * m) >> level, ((j + 1) * m) >> level
    _squares(xyz, lo, hi, first, squares)
    _smallest(squares, hi - lo, k + 1)
    bound = math.sqrt(squares[: k + 1].max())
    reach = 0.0
    for i in range(first, last):
        dx, dy, dz = xyz[0, i] - xyz[0, first], xyz[1, i] - xyz[1, first], xyz[2, i] - xyz[2, first]
        reach = max(reach, math.sqrt(dx * dx + dy * dy + dz * dz))
    n = _gather(xyz, boxes, depth, leaf, (bound + reach) * SLACK, near, stack)
    for i in range(first, last):
        if i > first:
            dx, dy, dz = xyz[0, i] - xyz[0, i - 1], xyz[1, i] - xyz[1, i - 1], xyz[2, i] - xyz[2, i - 1]
            bound += math.sqrt(dx * dx + dy * dy + dz * dz)
        x, y, z = xyz[0, i], xyz[1, i], xyz[2, i]
        for c in range(n):
            dx, dy, dz = near[0, c] - x, near[1, c] - y, near[2, c] - z
            squares[c] = dx * dx + dy * dy + dz * dz
        square, count = bound * bound * SLACK, 0
        for c in range(n):
            kept[count] = squares[c]
            count += squares[c] <= square
        _smallest(kept, count, k + 1)
        total, far = 0.0, 0.0
        for c in range(k + 1):  # the point itself is among them, at no distance
            total += math.sqrt(kept[c])
            far = max(far, kept[c])
        means[order[i]] = total / k
        bound = math.sqrt(far)


@njit(cache=True, nogil=True, parallel=True)
def mean_distances(xyz, order, depth, boxes, k, lanes):
    """Mean distance of each point to its k nearest others, 1 <= k < M; in the order the points were given.

    Each of the lanes has memory of its own; their number decides nothing else.
    """
    m = xyz.shape[1]
    means = np.empty(m, np.float64)
    for lane in prange(lanes):
        near, stack = np.empty((3, m), np.float64), np.empty(2 * depth + 2, np.int64)
        squares, kept = np.empty(m, np.float64), np.empty(m + 1, np.float64)
        for leaf in range(lane, 1 << depth, lanes):
            _leaf_means(xyz, order, boxes, depth, leaf, k, near, squares, kept, stack, means)
    return means
