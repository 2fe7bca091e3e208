"""The static map of live use: one point per voxel around the sensor."""

from __future__ import annotations

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, Bool
from dynaviz.blocks.blocks import VOXELS, BlockGrid
from dynaviz.blocks.window import Window
from dynaviz.contracts.scan import Scan


class StaticMap(BlockGrid):
    """For each voxel the first static point, and how often points in it were labelled static and dynamic.

    Args:
        window: goes with the sensor.
        voxel: edge of a voxel, metres.
    """

    def __init__(self, window: Window, voxel: float) -> None:
        super().__init__(window, voxel)
        n = len(self)
        self._static, self._dynamic = (self.per_block(np.zeros((n, VOXELS), np.uint16)) for _ in range(2))
        self._within = self.per_block(np.zeros((n, VOXELS, 3), np.uint8))  # place of the point, 256ths of a voxel

    def add(self, scan: Scan, dynamic: Bool) -> None:
        """Add the points of a scan, with their labels (N,)."""
        points, voxels = kernels.as_readonly(scan.points, np.float32), self.locate(scan.points)
        state = self._static, self._dynamic, self._within
        kernels.static_map.add(points, voxels, np.ascontiguousarray(dynamic), self._per_metre, *state)

    def points(self) -> F32:
        """(M, 3) float32, metres, world frame: the points of voxels labelled static more often than dynamic."""
        state = self._static, self._dynamic, self._within
        points: F32 = kernels.static_map.points(self.existing(), self._blocks, self.resolution, *state)
        return points
