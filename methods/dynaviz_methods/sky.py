"""Rays into the sky: directions in which a scan has no return, to the depth that the pixels around them suggest."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F32, F64, U8, Bool
from dynaviz.scan import Scan
from dynaviz.sensors import Sensor

NEAREST = 0.2  # metres: closer points do not enter the image, as published
SHORTER = 0.2  # metres by which rays end before the depth of their pixel, as published
COARSE = 1.0  # degrees: minimum height of a pixel if only the sensor decides; smaller holes are drop-outs
FARTHEST, INPAINT = 80.0, 3  # metres, and pixels, of such an image


@dataclass(frozen=True)
class DepthImage:
    """The layout of a depth image over 360 degrees with square pixels, and how its holes are filled.

    Attributes:
        rows: number of rows.
        top, bottom: elevation of the first and the last row, radians.
        farthest: depth of the largest value, 255, metres.
        inpaint: radius from which holes are filled, pixels.
        erosion: pixels by which holes shrink and near depths grow.
    """

    rows: int
    top: float
    bottom: float
    farthest: float
    inpaint: int
    erosion: int

    @property
    def pixel(self) -> float:
        """Height of a pixel, radians."""
        return (self.top - self.bottom) / (self.rows - 1)

    @property
    def columns(self) -> int:
        """Number of columns."""
        return math.ceil(2 * math.pi / self.pixel)

    def of(self, scan: Scan) -> tuple[U8, U8]:
        """Project a scan.

        Returns:
            depth: (rows, columns) uint8, least depth of the pixel's points in units of farthest / 255; 255 without.
            hole: (rows, columns) uint8, 255 for pixels without points, else 0.
        """
        x, y, z = _local(scan)
        ranges = np.sqrt(x * x + y * y + z * z)
        upper, width = self.top + self.pixel / 2, 2 * math.pi / self.columns
        row = np.floor((upper - np.arctan2(z, np.hypot(x, y))) / self.pixel).astype(np.int64)
        column = np.floor((math.pi - np.arctan2(y, x)) / width).astype(np.int64)
        inside = (row >= 0) & (row < self.rows) & (column >= 0) & (column < self.columns) & (ranges >= NEAREST)
        pixel = row[inside] * self.columns + column[inside]
        depth = np.full(self.rows * self.columns, 255, np.uint8)
        hole = depth.copy()
        np.minimum.at(depth, pixel, np.minimum(255, ranges[inside] / (self.farthest / 255)).astype(np.uint8))
        hole[pixel] = 0
        return depth.reshape(self.rows, -1), hole.reshape(self.rows, -1)

    def sky(self, depth: U8, hole: U8) -> tuple[F64, Bool]:
        """Fill the holes of a depth image, and select those that reach its upper border but not the lower one.

        Returns:
            filled: (rows, columns) float64, metres.
            chosen: (rows, columns) bool, pixels of the sky.
        """
        import cv2

        margin, square = self.erosion + self.inpaint, np.ones((2 * self.erosion + 1,) * 2, np.uint8)
        depth, hole = (np.concatenate([a[:, a.shape[1] - margin :], a, a[:, :margin]], 1) for a in (depth, hole))
        filled = cv2.inpaint(cv2.erode(depth, square), hole, self.inpaint, cv2.INPAINT_TELEA)
        _, parts, stats, _ = cv2.connectedComponentsWithStats(cv2.erode(hole, square), connectivity=4)
        first, last = stats[:, cv2.CC_STAT_TOP], stats[:, cv2.CC_STAT_TOP] + stats[:, cv2.CC_STAT_HEIGHT]
        chosen = (first == 0) & (last < self.rows)
        chosen[0] = False  # pixels with points
        middle, unit = slice(margin, margin + self.columns), self.farthest / 255
        steps = np.maximum(filled[:, middle].astype(np.int64) - math.ceil(SHORTER / unit), 0)
        return steps * unit, chosen[parts[:, middle]]

    def targets(self, scan: Scan, filled: F64, chosen: Bool) -> F64:
        """(K, 3) float64, metres, world frame: ends of the rays into the chosen pixels."""
        row, column = np.nonzero(chosen)
        azimuth = math.pi - (column + 0.5) * (2 * math.pi / self.columns)
        elevation, depth = self.top - row * self.pixel, filled[row, column]
        level = depth * np.cos(elevation)
        local = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), depth * np.sin(elevation)], 1)
        ends: F64 = local @ scan.T_world_sensor[:3, :3].T + scan.position
        return ends


def rows_of(sensor: Sensor, low: float, high: float) -> int:
    """Rows of a depth image: one per ring, or without rings as many as make a square pixel of each point; 0 if unknown.

    Args:
        sensor: the sensor.
        low, high: elevation of the lowest and the highest row, degrees.
    """
    if sensor.rings or not sensor.points_per_sweep or not low < high:
        return sensor.rings or 0
    return round(math.sqrt((high - low) * sensor.points_per_sweep / 360))


def sensor_image(sensor: Sensor) -> DepthImage | None:
    """The depth image that follows from a sensor alone; None if its rows or its vertical field of view are unknown."""
    low, high = sensor.elevation or (0.0, 0.0)
    rows = min(rows_of(sensor, low, high), round((high - low) / COARSE) + 1)
    return DepthImage(rows, math.radians(high), math.radians(low), FARTHEST, INPAINT, 0) if rows >= 2 else None


def _local(scan: Scan) -> tuple[F32, F32, F32]:
    """Coordinates of the finite points of a scan, each (N,) float32, metres, sensor frame.

    Column by column: numpy and BLAS are ten times slower along rows of three.
    """
    columns = scan.points.T
    finite = np.isfinite(columns[0]) & np.isfinite(columns[1]) & np.isfinite(columns[2])
    x, y, z = (column[finite] - offset for column, offset in zip(columns, scan.position, strict=True))
    R = scan.T_world_sensor[:3, :3]
    a, b, c = ((x * R[0, axis] + y * R[1, axis] + z * R[2, axis]).astype(np.float32) for axis in range(3))
    return a, b, c
