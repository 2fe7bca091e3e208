"""The height of a sensor above the ground that one of its scans shows."""

from __future__ import annotations

import math

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F64
from dynaviz.spatial.scan_ground import EDGE, EXACT, LAYER, REACH, ROUNDS, ScanGround, weights

HIGHEST = 7.0  # metres: higher sensors do not show it
FEWEST = 50  # cells below the sensor
FLAT = 0.5  # share of these that show ground, if the third axis is up


def sensor_height(local: F64) -> tuple[float, float]:
    """The distance of a sensor from the plane of the ground around it.

    Args:
        local: (N, 3) float64, metres: points from the sensor, the third axis up.

    Returns:
        The distance, metres, in which near ground counts most, and the share of the cells with
        points below the sensor that show ground; zeros if there are fewer than ``FEWEST`` such
        cells.
    """
    return ground_plane(local)[:2]


def ground_plane(local: F64) -> tuple[float, float, F64]:
    """Distance and share as ``sensor_height``, and the normal of the ground, (3,), upwards."""
    reach = REACH // 2
    sensor = np.zeros(3)
    below = (
        (local[:, 2] < -LAYER)
        & (local[:, 2] > -HIGHEST)
        & (np.abs(local[:, :2]) < reach * EDGE).all(1)
    )
    points = local[below].astype(np.float32)
    seen = len(np.unique(np.floor(points[:, :2] / EDGE), axis=0))
    if seen < FEWEST:
        return 0.0, 0.0, np.array([0.0, 0.0, 1.0])
    _, x, y, z, number = ScanGround.of(points, sensor, reach).cells(sensor)
    start = np.array([np.median(z) if len(z) else 0.0, 0.0, 0.0])
    c, a, b = kernels.scan_ground.plane(x, y, z, weights(x, y, number), start, 1e-6, EXACT, ROUNDS)
    length = math.sqrt(1.0 + a * a + b * b)
    return float(-c / length), len(z) / seen, np.array([-a, -b, 1.0]) / length
