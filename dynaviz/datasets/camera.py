"""What KITTI's camera 2 sees: nobody drew boxes elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F64, Bool
from dynaviz.spatial import geometry


@dataclass(frozen=True)
class Camera:
    """A camera beside the sensor.

    Attributes:
        T_camera_sensor: (4, 4) float64, metres; camera frame: x right, y down, z forward.
        projection: (3, 4) float64, of its frame into its image, pixels.
        size: (width, height) of its image, pixels.
    """

    T_camera_sensor: F64
    projection: F64
    size: tuple[float, float] = (1242, 375)

    def sees(self, points: F64) -> tuple[Bool, F64, F64]:
        """Whether (N, 3) points in the camera frame lie in the image, and the columns and rows where, in pixels."""
        image = geometry.apply(self.projection, points)
        with np.errstate(divide="ignore", invalid="ignore"):
            column, row = image[:, 0] / image[:, 2], image[:, 1] / image[:, 2]
        width, height = self.size
        seen: Bool = (points[:, 2] > 0.5) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        return seen, column, row
