"""Polar bins around a sensor and the heights that points span in them.

The pseudo occupancy (R-POD) of ERASOR.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I32, I64, Bool
from dynaviz.contracts.probe import PolarGrid

KERNELS = kernels.load("dynaviz_methods.erasor.kernels")


@dataclass(frozen=True)
class PolarBins:
    """Rings of equal width and sectors of equal angle, within a height band.

    Attributes:
        max_range: radius in x and y, metres, exclusive; farther points are in no bin.
        rings: number of rings, from the sensor outwards.
        sectors: number of sectors, counter-clockwise from the world's x axis.
        low, high: height band above the ground below the sensor, metres, both ends exclusive.
    """

    max_range: float
    rings: int
    sectors: int
    low: float
    high: float

    def locate(
        self, points: F32, foot: F64, spans: I64 | None = None, gone: Bool | None = None
    ) -> tuple[I32, I32]:
        """Find the points within range and their bins.

        Args:
            points: (N, 3) float32, metres, world frame; finite.
            foot: (3,) float64, metres, world frame: the ground below the sensor.
            spans: (S, 2) int64: rows to search, as [first, end); all by default.
            gone: (N,) bool: rows to skip; none by default.

        Returns:
            rows: (K,) int32: rows of the points.
            bins: (K,) int32: ring * sectors + sector; -1 outside the height band.
        """
        spans = np.array([[0, len(points)]]) if spans is None else spans
        gone = np.zeros(len(points), np.bool_) if gone is None else gone
        rows, bins = KERNELS.polar_bins.locate(
            *(kernels.as_readonly(points, np.float32), kernels.as_readonly(spans, np.int64)),
            *(kernels.as_readonly(gone, np.bool_), kernels.as_readonly(foot, np.float64)),
            *(self.max_range, self.rings, self.sectors, self.low, self.high),
        )
        return rows, bins

    def heights(self, points: F32, rows: I32, bins: I32) -> tuple[F64, I64]:
        """The height that the points found by ``locate`` span in each bin.

        Returns:
            heights: (rings * sectors,) float64, metres: highest minus lowest point; NaN without
                points.
            counts: (rings * sectors,) int64: number of points.
        """
        n = self.rings * self.sectors
        heights, counts = KERNELS.polar_bins.heights(
            kernels.as_readonly(points, np.float32), rows, bins, n
        )
        return heights, counts

    def grid(self, values: NDArray[np.floating]) -> PolarGrid:
        """One value per bin, (rings * sectors,), as a state to show."""
        return PolarGrid(
            values.reshape(self.rings, self.sectors).astype(np.float32), self.max_range
        )
