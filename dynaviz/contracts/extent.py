"""The extent of a sequence: bounds, and coarse cells that contain points."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F64, I32, I64, U64
from dynaviz.contracts.scan import Scan
from dynaviz.errors import DynavizError
from dynaviz.spatial.grid import SHIFTS, KeySet, pack, pack_indices, unpack

CELL = 0.8  # metres: 8 voxels of 0.1 m, the block size of most grids
PARTS = 4  # along each axis of a cell
FAR = 100_000.0  # metres; within the key range of 0.1 m voxels
STRIDES = np.array([16, 4, 1], np.uint64)  # of the bits of parts, along x, y and z
# the first parts along x, y and z
FIRST = np.array([0xFFFF, 0x000F000F000F000F, 0x1111111111111111], np.uint64)


@dataclass(frozen=True, eq=False)
class Extent:
    """The extent of a sequence.

    Attributes:
        low, high: (3,) float64, metres, world frame: bounds of all finite points and ray origins.
        cells: (C, 3) int32: cubes of ``CELL`` metres that contain at least one point; cube k spans
            [k, k + 1) * CELL.
        parts: (C,) uint64: which of the 4^3 parts of each cell contain points: bit 16 x + 4 y + z;
            None if unknown.
    """

    low: F64
    high: F64
    cells: I32
    parts: U64 | None = None

    @classmethod
    def of(cls, *scans: Scan) -> Extent:
        """The extent of some scans."""
        growing = GrowingExtent()
        for scan in scans:
            growing.add(scan)
        return growing.extent()

    def cropped(self, low: F64, high: F64) -> Extent:
        """The same bounds, with the cells that touch a rectangle in x and y only.

        Corners (2,) metres, world frame.
        """
        touching = (self.cells[:, :2] * CELL <= high) & ((self.cells[:, :2] + 1) * CELL >= low)
        inside = touching.all(1)
        return Extent(
            self.low,
            self.high,
            self.cells[inside],
            None if self.parts is None else self.parts[inside],
        )

    def widened(self, around: float, axes: tuple[int, ...] = (0, 1, 2)) -> Extent:
        """The extent, enlarged along some axes to all parts of cells within ``around`` metres to
        both sides.
        """
        keys = pack_indices(self.cells)
        parts = ~np.zeros(len(keys), np.uint64) if self.parts is None else self.parts
        for axis in axes:
            left = math.ceil(around / (CELL / PARTS))
            while left > 0:
                keys, parts = _grown(keys, parts, axis, min(left, PARTS))
                left -= PARTS
        return Extent(self.low - around, self.high + around, unpack(keys), parts)


class GrowingExtent:
    """The extent of the scans added so far."""

    def __init__(self) -> None:
        self._low = np.full(3, np.inf)
        self._high = np.full(3, -np.inf)
        self._parts = KeySet()

    def add(self, scan: Scan, rectangle: F64 | None = None) -> None:
        """Add a scan.

        Args:
            scan: the scan.
            rectangle: (2, 2) float64, metres: lower and upper corner in x and y; cells count within
                it only.

        Raises:
            DynavizError: if a point or ray origin is farther than ``FAR`` from the world's origin.
        """
        finite = (
            scan.points
            if np.isfinite(scan.points).all()
            else scan.points[np.isfinite(scan.points).all(1)]
        )
        for xyz in (finite, scan.origins):
            if len(xyz):
                columns = [xyz[:, axis] for axis in range(3)]  # much faster than reducing rows
                self._low = np.minimum(self._low, [column.min() for column in columns])
                self._high = np.maximum(self._high, [column.max() for column in columns])
        farthest = max(-self._low.min(), self._high.max())
        if farthest > FAR:
            raise DynavizError(
                f"frame {scan.index}: a point or sensor position is {farthest / 1000:.3g} km from "
                "the world's origin, "
                "where float32 is too coarse. Move the world's origin to the first pose, or remove "
                "such points."
            )
        if rectangle is not None:
            inside = np.ones(len(finite), np.bool_)
            for axis, (low, high) in enumerate(rectangle.T.tolist()):
                inside &= (finite[:, axis] >= low) & (finite[:, axis] <= high)
            finite = finite[inside]
        self._parts.add(pack(finite, CELL / PARTS))

    def extent(self) -> Extent:
        """Bounds, cells and parts of cells of all scans added so far."""
        index = unpack(self._parts.keys())
        keys = pack_indices(index >> 2)
        bits = np.uint64(1) << (index & 3).astype(np.uint64) @ STRIDES
        keys, parts = _merged(keys, bits)
        return Extent(self._low, self._high, unpack(keys), parts)


def _grown(keys: I64, parts: U64, axis: int, times: int) -> tuple[I64, U64]:
    """Packed keys of cells, and their parts, up to ``PARTS`` times one part farther to both sides
    along an axis.
    """
    one = STRIDES[axis]
    three = 3 * STRIDES[axis]
    first = FIRST[axis]
    last = first << three
    above, below = np.zeros((2, len(keys)), np.uint64)  # parts in the adjacent cells
    for _ in range(times):
        above |= (above & ~last) << one | parts >> three & first
        below |= (below & ~first) >> one | (parts & first) << three
        parts = parts | (parts & ~last) << one | (parts & ~first) >> one
    step = np.int64(1) << SHIFTS[axis]
    up = above > 0
    down = below > 0
    return _merged(
        np.concatenate([keys, keys[up] + step, keys[down] - step]),
        np.concatenate([parts, above[up], below[down]]),
    )


def _merged(keys: I64, parts: U64) -> tuple[I64, U64]:
    """Sorted keys without duplicates, and the parts of each."""
    found, which = np.unique(keys, return_inverse=True)
    merged = np.zeros(len(found), np.uint64)
    np.bitwise_or.at(merged, which, parts)
    return found, merged
