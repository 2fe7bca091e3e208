"""Rays into the sky: directions in which a scan has no return, to the depth that the pixels around
them suggest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz import kernels
from dynaviz.arrays import F64, U8, Bool
from dynaviz.contracts.probe import ImageSpan
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz_methods.shared.range_images import whole

SHARED = kernels.load("dynaviz_methods.shared.kernels")

NEAREST = 0.2  # metres: closer points do not enter the image, as published
SHORTER = 0.2  # metres by which rays end before the depth of their pixel, as published
COARSE = 1.0  # degrees: height of a pixel if only the sensor decides; smaller holes are drop-outs


@dataclass(frozen=True)
class DepthImage:
    """The layout of a depth image over 360 degrees with square pixels, and how its holes are
    filled.

    Attributes:
        rows: number of rows.
        top, bottom: elevation of the first and the last row, radians.
        farthest: depth of the largest value, 255, metres.
        inpaint: radius from which holes are filled, pixels; 0 for the depth of the nearest pixel
            with a point.
        erosion: pixels by which holes shrink and near depths grow.
        around: no hole is deeper than the points in so many pixels around it.
    """

    rows: int
    top: float
    bottom: float
    farthest: float
    inpaint: int
    erosion: int
    around: int = 0

    @property
    def pixel(self) -> float:
        """Height of a pixel, radians."""
        return (self.top - self.bottom) / (self.rows - 1)

    @property
    def columns(self) -> int:
        """Number of columns."""
        return math.ceil(2 * math.pi / self.pixel)

    @property
    def span(self) -> ImageSpan:
        """The directions that the image shows."""
        half = self.pixel / 2
        return ImageSpan(math.pi, -math.pi, self.top + half, self.bottom - half)

    @property
    def _view(self) -> F64:
        """The layout of ``kernels/range_image.py``, (1, 7), with one row more, into which that
        counts points below.
        """
        per_row = 1 / self.pixel
        per_column = self.columns / (2 * math.pi)
        view = (
            self.rows + 1,
            self.columns,
            self.top * per_row,
            per_row,
            self.columns / 2 - 0.5,
            -per_column,
            0,
        )
        return kernels.as_readonly([view], np.float64)

    def of(self, scan: Scan) -> tuple[U8, U8]:
        """Project a scan.

        Returns:
            depth: (rows, columns) uint8, least depth of the pixel's points in units of farthest /
                255; 255 without.
            hole: (rows, columns) uint8, 255 for pixels without points, else 0.
        """
        xyz = kernels.as_readonly(scan.points.T, np.float32)
        centre = kernels.as_readonly(scan.position, np.float64)
        axes = kernels.as_readonly(scan.T_world_sensor[:3, :3].T, np.float64)
        camera = (centre, axes, self._view, False)
        lanes = kernels.threads_in_use()
        nearest, _ = SHARED.range_image.nearest(
            xyz, *whole(len(scan)), *camera, lanes, np.float32(NEAREST)
        )
        ranges = nearest[: self.rows * self.columns].reshape(self.rows, -1)
        depth = np.minimum(255, ranges / (self.farthest / 255)).astype(np.uint8)
        return depth, np.where(ranges < np.inf, np.uint8(0), np.uint8(255))

    def sky(self, depth: U8, hole: U8) -> tuple[F64, Bool]:
        """Fill the holes of a depth image, and select those that reach its upper border but not the
        lower one.

        Returns:
            filled: (rows, columns) float64, metres.
            chosen: (rows, columns) bool, pixels of the sky.
        """
        import cv2

        margin = self.erosion + self.inpaint + self.around if self.inpaint else self.columns // 2
        depth, hole = (
            np.concatenate([a[:, a.shape[1] - margin :], a, a[:, :margin]], 1)
            for a in (depth, hole)
        )
        near = cv2.erode(depth, _square(self.erosion))
        filled = (
            cv2.inpaint(near, hole, self.inpaint, cv2.INPAINT_TELEA)
            if self.inpaint
            else _nearest(near, hole)
        )
        filled = np.minimum(filled, cv2.erode(near, _square(self.around)))
        _, parts, stats, _ = cv2.connectedComponentsWithStats(
            cv2.erode(hole, _square(self.erosion)), connectivity=4
        )
        first = stats[:, cv2.CC_STAT_TOP]
        last = stats[:, cv2.CC_STAT_TOP] + stats[:, cv2.CC_STAT_HEIGHT]
        chosen = (first == 0) & (last < self.rows)
        chosen[0] = False  # pixels with points
        middle = slice(margin, margin + self.columns)
        unit = self.farthest / 255
        steps = filled[:, middle].astype(np.int64) - math.ceil(SHORTER / unit)
        return np.maximum(steps, 0) * unit, chosen[parts[:, middle]]

    def targets(self, scan: Scan, filled: F64, chosen: Bool) -> F64:
        """(K, 3) float64, metres, world frame: ends of the rays into the chosen pixels."""
        row, column = np.nonzero(chosen)
        azimuth = math.pi - (column + 0.5) * (2 * math.pi / self.columns)
        elevation = self.top - row * self.pixel
        depth = filled[row, column]
        level = depth * np.cos(elevation)
        local = np.stack(
            [level * np.cos(azimuth), level * np.sin(azimuth), depth * np.sin(elevation)], 1
        )
        ends: F64 = local @ scan.T_world_sensor[:3, :3].T + scan.position
        return ends


def rows_of(sensor: Sensor, low: float, high: float) -> int:
    """Rows of a depth image.

    One per ring, or without rings as many as make a square pixel of each point; 0 if unknown.

    Args:
        sensor: the sensor.
        low, high: elevation of the lowest and the highest row, degrees.
    """
    if sensor.rings or not sensor.points_per_sweep or not low < high:
        return sensor.rings or 0
    return round(math.sqrt((high - low) * sensor.points_per_sweep / 360))


def sensor_image(sensor: Sensor, farthest: float) -> DepthImage | None:
    """The depth image that follows from a sensor alone.

    None if its rows or its vertical field of view are unknown.

    Rays into the sky are at most ``farthest`` metres long.

    The rows between sparse rings are holes. Those that are connected to the sky show that nothing
    is in front of the surface that the rings above and below them hit; so no hole is deeper than
    the points up to one ring away.
    """
    low, high = sensor.elevation or (0.0, 0.0)
    rows = round((high - low) / COARSE) + 1
    if not sensor.rings:
        rows = min(rows, rows_of(sensor, low, high))
    if rows < 2:
        return None
    around = math.ceil((rows - 1) / max((sensor.rings or rows) - 1, 1))
    return DepthImage(rows, math.radians(high), math.radians(low), farthest, 0, 0, around)


def _nearest(depth: NDArray[Any], hole: U8) -> U8:
    """Fill the holes of a depth image, (R, C) each, with the depth of the nearest pixel with a
    point; 255 without.
    """
    import cv2

    _, which = cv2.distanceTransformWithLabels(hole, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    depths = np.full(which.max() + 1, 255, np.uint8)
    known = hole == 0
    depths[which[known]] = depth[known]
    filled: U8 = depths[which]
    return filled


def _square(pixels: int) -> U8:
    """(K, K) uint8 of ones: the pixels around one, up to so many away."""
    return np.ones((2 * pixels + 1,) * 2, np.uint8)
