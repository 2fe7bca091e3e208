"""The field of view of KITTI's camera 2, the only region in which objects are annotated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F64, Bool
from dynaviz.spatial import geometry


@dataclass(frozen=True)
class Camera:
    """A camera calibrated to the lidar.

    Attributes:
        T_camera_sensor: (4, 4) float64, metres; camera frame: x right, y down, z forward.
        projection: (3, 4) float64, from the camera frame to pixels.
        size: (width, height) of the image, pixels.
    """

    T_camera_sensor: F64
    projection: F64
    size: tuple[float, float] = (1242, 375)

    def project(self, points: F64) -> tuple[Bool, F64, F64]:
        """Project (N, 3) points in the camera frame: mask of points in the image, columns and rows in pixels."""
        projected = geometry.apply(self.projection, points)
        with np.errstate(divide="ignore", invalid="ignore"):
            column, row = projected[:, 0] / projected[:, 2], projected[:, 1] / projected[:, 2]
        width, height = self.size
        in_image: Bool = (points[:, 2] > 0.5) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        return in_image, column, row
