"""Exact distances to the nearest of many points, by a tree of boxes over points in Morton order.

A kd-tree answers one query at a time; here queries are sorted too, so that each starts from its predecessor's
neighbour, and almost every branch is cut at once (the tree: Lauterbach et al., Fast BVH construction on GPUs, 2009).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynaviz import kernels
from dynaviz.scan import F32, F64


def nearest_distance(query: F32, reference: F32, limit: float = np.inf) -> F32:
    """Distance from each point to the nearest reference point.

    Args:
        query: (N, 3) float32, metres; finite.
        reference: (M, 3) float32, metres; finite, in the same frame.
        limit: metres; what lies beyond need not be found.

    Returns:
        (N,) float32, metres, in float32 arithmetic; inf where no reference point is within the limit.
    """
    distance = np.full(len(query), np.inf, np.float32)
    if len(query) == 0 or len(reference) == 0:
        return distance
    sample = reference[:: max(len(reference) // 8192, 1)]
    low, high = np.percentile(sample, (0.1, 99.9), axis=0)  # a few far points must not make the curve's cells coarse
    points, _ = _in_morton_order(reference, low, high)
    ordered, order = _in_morton_order(query, low, high)
    tree = kernels.nearest.boxes(points)
    reach = np.float32(limit) ** 2 * np.float32(1.00001)  # a little farther, so that the limit itself is found
    squared = kernels.nearest.search(points, kernels.frozen(tree, np.float32), ordered, reach)
    found = np.sqrt(squared)
    distance[order] = np.where(found <= np.float32(limit), found, np.float32(np.inf))
    return distance


def _in_morton_order(points: F32, low: F64, high: F64) -> tuple[F32, NDArray[np.intp]]:
    """Points along a space-filling curve through the box, and where each of them was."""
    index_bits = max(len(points).bit_length(), 1)
    axis_bits = min((64 - index_bits) // 3, 16)
    inverse = (1 << axis_bits) / max(float((high - low).max()), 1e-6)
    keys = kernels.nearest.morton(kernels.frozen(points, np.float32), low, inverse, axis_bits, index_bits)
    keys.sort()
    order = (keys & np.uint64((1 << index_bits) - 1)).astype(np.intp)
    return kernels.frozen(np.take(points, order, 0), np.float32), order
