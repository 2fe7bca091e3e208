"""Exact nearest-neighbour distances with a bounding-box tree over points in Morton order.

A k-d tree answers each query on its own. Here queries are sorted as well, so each one starts from
its predecessor's neighbour and almost every branch is pruned at once (tree: Lauterbach et al., Fast
BVH construction on GPUs, 2009).

All arithmetic is float32 in a fixed order, as in the public benchmark's export (PCL): the square
root of dx² + dy² + dz² is compared with the limit as a float32. A point exactly at the limit is
within it.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, Bool, Intp


class Nearest:
    """A tree of reference points for repeated nearest-neighbour queries.

    Args:
        reference: (M, 3) float32, metres; finite. May be empty.
    """

    def __init__(self, reference: F32) -> None:
        sample = reference[:: max(len(reference) // 8192, 1)]
        if len(sample) == 0:
            sample = np.zeros((1, 3), np.float32)
        # Percentiles, so that a few far points do not make the curve's cells coarse.
        self._low, self._high = np.percentile(sample, (0.1, 99.9), axis=0)
        self._points, _ = _in_morton_order(reference, self._low, self._high)
        self._tree = kernels.as_readonly(kernels.nearest.boxes(self._points), np.float32)

    def __len__(self) -> int:
        return len(self._points)

    def distance(self, query: F32, limit: float = np.inf) -> F32:
        """Distance from each point to the nearest reference point.

        Args:
            query: (N, 3) float32, metres; finite, in the frame of the reference.
            limit: metres; farther neighbours are ignored.

        Returns:
            (N,) float32, metres; inf if no reference point is within the limit.
        """
        last = _last_square(limit)
        squared = self._search(query, last, np.float32(0))
        return np.where(squared <= last, np.sqrt(squared), np.float32(np.inf))

    def within(self, query: F32, limit: float) -> Bool:
        """(N,) bool: whether ``distance(query, limit)`` is finite. Faster.

        Any point within the limit will do.
        """
        last = _last_square(limit)
        near: Bool = self._search(query, last, last) <= last
        return near

    def _search(self, query: F32, last: np.float32, enough: np.float32) -> F32:
        """(N,) float32: squared distances up to ``last``, inf beyond."""
        squared = np.full(len(query), np.inf, np.float32)
        if len(query) and len(self):
            ordered, order = _in_morton_order(query, self._low, self._high)
            with np.errstate(over="ignore"):
                reach = np.nextafter(last, np.float32(np.inf))
            search = partial(kernels.nearest.search, self._points, self._tree, reach, enough)
            squared[order] = np.concatenate(
                kernels.each(search, np.array_split(ordered, kernels.threads_in_use()))
            )
        return squared


def _last_square(limit: float) -> np.float32:
    """The largest float32 whose square root is still within the limit."""
    with np.errstate(over="ignore"):
        r = np.float32(limit)
        near = [r * r]
        for _ in range(3):  # rounding changes the square by less
            near = [
                np.nextafter(near[0], np.float32(0)),
                *near,
                np.nextafter(near[-1], np.float32(np.inf)),
            ]
    return max(square for square in near if np.sqrt(square) <= r)


def nearest_distance(query: F32, reference: F32, limit: float = np.inf) -> F32:
    """Distance from each point to the nearest reference point, for a single query.

    See ``Nearest.distance``.
    """
    if len(query) == 0 or len(reference) == 0:
        return np.full(len(query), np.inf, np.float32)
    return Nearest(reference).distance(query, limit)


def _in_morton_order(points: F32, low: F64, high: F64) -> tuple[F32, Intp]:
    """Points sorted along a space-filling curve through the box, and the original row of each."""
    index_bits = max(len(points).bit_length(), 1)
    axis_bits = min((64 - index_bits) // 3, 16)
    inverse = (1 << axis_bits) / max(float((high - low).max()), 1e-6)
    points = kernels.as_readonly(points, np.float32)
    order = kernels.nearest.morton_order(points, low, inverse, axis_bits, index_bits)
    return kernels.as_readonly(np.take(points, order, 0), np.float32), order
