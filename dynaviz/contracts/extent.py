"""The extent of a sequence: bounds, and coarse cells that contain points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F64, I32
from dynaviz.contracts.scan import Scan
from dynaviz.errors import DynavizError
from dynaviz.spatial.grid import KeySet, pack, unpack

CELL = 0.8  # metres: 8 voxels of 0.1 m, the block size of most grids
FAR = 100_000.0  # metres; within the key range of 0.1 m voxels


@dataclass(frozen=True, eq=False)
class Extent:
    """The extent of a sequence.

    Attributes:
        low, high: (3,) float64, metres, world frame: bounds of all finite points and ray origins.
        cells: (C, 3) int32: cubes of ``CELL`` metres that contain at least one point; cube k spans [k, k + 1) * CELL.
    """

    low: F64
    high: F64
    cells: I32

    @classmethod
    def of(cls, *scans: Scan) -> Extent:
        """The extent of some scans."""
        growing = GrowingExtent()
        for scan in scans:
            growing.add(scan)
        return growing.extent()

    def cropped(self, low: F64, high: F64) -> Extent:
        """The same bounds, with the cells that touch a rectangle in x and y only; corners (2,) metres, world frame."""
        touching = (self.cells[:, :2] * CELL <= high) & ((self.cells[:, :2] + 1) * CELL >= low)
        return Extent(self.low, self.high, self.cells[touching.all(1)])


class GrowingExtent:
    """The extent of the scans added so far."""

    def __init__(self) -> None:
        self._low, self._high = np.full(3, np.inf), np.full(3, -np.inf)
        self._cells = KeySet()

    def add(self, scan: Scan, rectangle: F64 | None = None) -> None:
        """Add a scan.

        Args:
            scan: the scan.
            rectangle: (2, 2) float64, metres: lower and upper corner in x and y; cells count within it only.

        Raises:
            DynavizError: if a point or ray origin is farther than ``FAR`` from the world's origin.
        """
        finite = scan.points if np.isfinite(scan.points).all() else scan.points[np.isfinite(scan.points).all(1)]
        for xyz in (finite, scan.origins):
            if len(xyz):
                columns = [xyz[:, axis] for axis in range(3)]  # much faster than reducing rows
                self._low = np.minimum(self._low, [column.min() for column in columns])
                self._high = np.maximum(self._high, [column.max() for column in columns])
        farthest = max(-self._low.min(), self._high.max())
        if farthest > FAR:
            raise DynavizError(
                f"frame {scan.index}: a point or sensor position is {farthest / 1000:.3g} km from the world's origin, "
                "where float32 is too coarse. Move the world's origin to the first pose, or remove such points."
            )
        if rectangle is not None:
            inside = np.ones(len(finite), np.bool_)
            for axis, (low, high) in enumerate(rectangle.T.tolist()):
                inside &= (finite[:, axis] >= low) & (finite[:, axis] <= high)
            finite = finite[inside]
        self._cells.add(pack(finite, CELL))

    def extent(self) -> Extent:
        """Bounds and cells of all scans added so far."""
        return Extent(self._low, self._high, unpack(self._cells.keys()))
