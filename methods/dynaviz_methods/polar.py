"""Bins around a sensor, and the heights that points span in them: the region-wise pseudo occupancy of ERASOR."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I32, I64, Bool
from dynaviz.probe import PolarGrid


@dataclass(frozen=True)
class PolarBins:
    """Rings of equal width times sectors of equal angle, within a band of heights.

    Attributes:
        max_range: metres in x and y; a point there or beyond is in no bin.
        rings: from the sensor outwards.
        sectors: counter-clockwise from the world's x axis.
        low, high: metres above the foot of the sensor; a point in a bin is strictly between.
    """

    max_range: float
    rings: int
    sectors: int
    low: float
    high: float

    def locate(self, points: F32, foot: F64, spans: I64 | None = None, gone: Bool | None = None) -> tuple[I32, I32]:
        """Points within range, and their bins.

        Args:
            points: (N, 3) float32, metres, world frame; finite.
            foot: (3,) float64, metres, world frame: the ground below the sensor.
            spans: (S, 2) int64: rows to look at, from the first to before the second; all by default.
            gone: (N,) bool: rows to pass over; none by default.

        Returns:
            rows: (K,) int32.
            bins: (K,) int32: ring * sectors + sector; -1 outside the band of heights.
        """
        spans = np.array([[0, len(points)]]) if spans is None else spans
        gone = np.zeros(len(points), np.bool_) if gone is None else gone
        rows, bins = kernels.polar.locate(
            *(kernels.as_readonly(points, np.float32), kernels.as_readonly(spans, np.int64)),
            *(kernels.as_readonly(gone, np.bool_), kernels.as_readonly(foot, np.float64)),
            *(self.max_range, self.rings, self.sectors, self.low, self.high),
        )
        return rows, bins

    def heights(self, points: F32, rows: I32, bins: I32) -> tuple[F64, I64]:
        """The difference between the highest and the lowest of the points that ``locate`` found in each bin.

        Returns:
            heights: (rings * sectors,) float64, metres; NaN without points.
            counts: (rings * sectors,) int64: points.
        """
        n = self.rings * self.sectors
        heights, counts = kernels.polar.heights(kernels.as_readonly(points, np.float32), rows, bins, n)
        return heights, counts

    def grid(self, values: NDArray[np.floating]) -> PolarGrid:
        """A value per bin as a picture."""
        return PolarGrid(values.reshape(self.rings, self.sectors).astype(np.float32), self.max_range)
