"""A downsampled map, sorted by tile so that a scan reads only the tiles within its reach."""

from __future__ import annotations

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I32, I64

SHARED = kernels.load("dynaviz_methods.shared.kernels")

TILE = 8.0  # metres
FARTHEST = 2.0**30  # tiles from the world's origin; everything beyond is in the outermost tiles


def thinned(points: F32, size: float) -> tuple[F32, I32]:
    """Downsample a cloud to one centroid per voxel.

    Args:
        points: (N, 3) float32, metres.
        size: edge of a voxel, metres; 0 keeps every point.

    Returns:
        centroids: (V, 3) float32, metres: centroid of the points in each voxel.
        voxels: (N,) int32: row of the centroid of each point; -1 for points that are not finite, or
            more than a million voxels from the world's origin.
    """
    points = kernels.as_readonly(points, np.float32)
    if size > 0:
        voxels, n = SHARED.centroids.number(points, size)
        return SHARED.centroids.means(points, kernels.as_readonly(voxels, np.int32), n), voxels
    finite = np.isfinite(points).all(1)
    return points[finite], np.where(finite, np.cumsum(finite) - 1, -1).astype(np.int32)


def laid_out(points: F32, voxels: I32) -> tuple[Tiles, F32, I32]:
    """Sort a downsampled map by square tiles in x and y.

    Args:
        points: (V, 3) float32, metres, world frame; finite.
        voxels: (N,) int32: the map point of each raw point; -1 for none.

    Returns:
        tiles: the rows of each tile.
        points: (V, 3) float32, metres, world frame, tile by tile.
        rows: (N,) int32: the row of each raw point's map point after sorting; -1 for none.
    """
    of_point = np.clip(np.floor(points[:, :2] / np.float32(TILE)), -FARTHEST, FARTHEST).astype(
        np.int64
    )
    keys = (of_point[:, 0] << 32) + of_point[:, 1]
    order = np.argsort(keys, kind="stable")
    rank = np.full(len(points) + 1, np.int32(-1))  # the last entry is for -1
    rank[order] = np.arange(len(points), dtype=np.int32)
    points = points[order]
    return (
        Tiles(points, np.flatnonzero(np.diff(keys[order], prepend=np.iinfo(np.int64).min))),
        points,
        rank[voxels],
    )


class Tiles:
    """The rows of a map in each tile.

    Args:
        points: (V, 3) float32, metres, world frame; tile by tile.
        starts: (T,) int64: the first row of each tile.
    """

    def __init__(self, points: F32, starts: I64) -> None:
        self._ends = np.zeros(1, np.int64)  # the first row of each tile, and the one after the last
        self._low = self._high = np.empty((0, 2), np.float32)
        self._extend(points, starts)

    def spans(self, centre: F64, reach: float) -> I64:
        """(S, 2) int64: rows [first, end) of the tiles within a horizontal distance ``reach`` of a
        centre, metres.
        """
        distance = np.maximum(np.maximum(self._low - centre[:2], centre[:2] - self._high), 0)
        near = np.concatenate([[False], (distance**2).sum(1) < reach**2, [False]])
        borders = np.flatnonzero(near[1:] != near[:-1])  # consecutive tiles form one span
        return self._ends[borders].reshape(-1, 2)

    def append(self, points: F32) -> None:
        """Register points after the last row as one tile, regardless of their extent.

        Meant for few points.
        """
        self._extend(points, np.zeros(min(len(points), 1), np.int64))

    def _extend(self, points: F32, starts: I64) -> None:
        """Register points after the last row; their tiles begin at ``starts``."""
        if not len(points):
            return
        self._ends = np.concatenate(
            [self._ends, self._ends[-1] + np.append(starts[1:], len(points))]
        )
        self._low = np.concatenate([self._low, np.minimum.reduceat(points[:, :2], starts)])
        self._high = np.concatenate([self._high, np.maximum.reduceat(points[:, :2], starts)])
