"""A thinned map, laid out tile by tile so that a scan touches only the tiles within its reach."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynaviz import kernels
from dynaviz.scan import F32, F64

TILE = 8.0  # metres


def thinned(points: F32, size: float) -> tuple[F32, NDArray[np.int32]]:
    """A cloud of one point per voxel.

    Args:
        points: (N, 3) float32, metres.
        size: edge of a voxel, metres; 0 keeps every point.

    Returns:
        centroids: (V, 3) float32, metres, of the points in each voxel.
        voxels: (N,) int32: the centroid that stands for each point; -1 where it is not finite, or more than a million
            voxels from the world's origin.
    """
    points = kernels.frozen(points, np.float32)
    if size > 0:
        voxels, n = kernels.centroids.number(points, size)
        return kernels.centroids.means(points, kernels.frozen(voxels, np.int32), n), voxels
    finite = np.isfinite(points).all(1)
    return points[finite], np.where(finite, np.cumsum(finite) - 1, -1).astype(np.int32)


class Tiles:
    """Points of a map in the order of square tiles over x and y.

    Args:
        points: (V, 3) float32, metres, world frame; finite.

    Attributes:
        points: (V, 3) float32: sorted by tile; what was appended comes at the end.
        gone: (V,) bool: points that the map has lost.
        rank: (V,) int32: where each point given went.
    """

    def __init__(self, points: F32) -> None:
        tiles = np.floor(points[:, :2] / np.float32(TILE)).astype(np.int64)
        keys = (tiles[:, 0] << 32) + tiles[:, 1]
        order = np.argsort(keys, kind="stable")
        self.rank = np.empty(len(points), np.int32)
        self.rank[order] = np.arange(len(points), dtype=np.int32)
        self.points, self.gone = points[:0], np.zeros(0, np.bool_)
        self._spans = np.empty((0, 2), np.int64)
        self._low = self._high = np.empty((0, 2), np.float32)
        self._extend(points[order], np.flatnonzero(np.diff(keys[order], prepend=np.iinfo(np.int64).min)))

    def spans(self, centre: F64, reach: float) -> NDArray[np.int64]:
        """(S, 2) int64: rows, from the first to before the second, of the tiles within reach of a place in x and y."""
        away = np.maximum(np.maximum(self._low - centre[:2], centre[:2] - self._high), 0)
        near: NDArray[np.int64] = self._spans[(away**2).sum(1) < reach**2]
        return near

    def append(self, points: F32) -> None:
        """Add points at the end as a tile of their own, however far they spread: for few points."""
        self._extend(points, np.zeros(min(len(points), 1), np.int64))

    def _extend(self, points: F32, starts: NDArray[np.int64]) -> None:
        """Add points, of which tiles begin at ``starts``."""
        if not len(points):
            return
        spans = np.stack([starts, np.append(starts[1:], len(points))], 1)
        self._spans = np.concatenate([self._spans, spans + len(self.points)])
        self._low = np.concatenate([self._low, np.minimum.reduceat(points[:, :2], starts)])
        self._high = np.concatenate([self._high, np.maximum.reduceat(points[:, :2], starts)])
        self.points = np.concatenate([self.points, points])
        self.gone = np.concatenate([self.gone, np.zeros(len(points), np.bool_)])
