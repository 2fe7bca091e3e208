"""A map in binary columns of height slices, as BeautyMap encodes it.

Wraps ``kernels/columns.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I32, I64, Bool

KERNELS = kernels.load("dynaviz_methods.beautymap.kernels")

REACH = 32768  # columns to each side of the world's origin
SLICES = 31
TILE = 64  # columns along the side of a tile
FINE = 0.1  # metres: smallest height of a fine bin
GROUND_PART = 0.85  # share of a split slice's points that are ground
GAP = 2  # empty slices or fine bins; everything above such a gap is an overhang
# The base of a column is bounded by those of the columns up to NEIGHBOURS before it in x and y, if
# LEAST of them have points: it may differ from their median by DEVIATIONS times their median
# absolute deviation.
NEIGHBOURS = 5
LEAST = 15
DEVIATIONS = 3.0

I8 = NDArray[np.int8]
T = TypeVar("T")
Placed = tuple[I32, I8]  # (N,) each: column and slice of points, -1 if none


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of a map.

    Attributes:
        points: (N, 3) float32, metres, world frame; read-only, C-contiguous.
        low, high: (2,) float64, metres: lowest and highest x and y of points in reach; infinite
            without points.
        squares: (K, 2) float64, metres: lower corners of squares, ``TILE`` columns wide, that
            contain all these points.
    """

    points: F32
    low: F64
    high: F64
    squares: F64

    @classmethod
    def of(cls, points: F32, side: float) -> Cloud:
        """A cloud for columns of this side, metres."""
        low, high = KERNELS.columns.bounds(points, REACH * side)
        tiles = _tiles(low, high, side)
        KERNELS.columns.enter(points, low, float(side), tiles)
        return cls(points, low, high, low + np.argwhere(tiles == 0) * side * TILE)


class ColumnMap:
    """The points of clouds in columns.

    Args:
        clouds: the points; at least one cloud, which may be empty.
        side: of a column, metres.
        height: of a slice, metres.
        keep: store columns and slices of all points, 5 bytes each, instead of computing them again.

    Attributes:
        base: (n,) float64, metres: height of the base of each column; NaN without points.
        raised: (n,) bool: columns whose lowest point is below the base.
        bits: (n,) int32: occupied slices.
        rows: (n + 1,) int64: how many slices the columns before a column have.
        lowest: metres: the lowest point; infinite without points.
        corner: (2,) float64, metres: where columns are counted from.
    """

    def __init__(
        self, clouds: Sequence[Cloud], side: float, height: float, keep: bool = False
    ) -> None:
        self._clouds = [cloud.points for cloud in clouds]
        self._height = float(height)
        self._keep = keep
        self._step = max(FINE, height / SLICES)
        self._columns: list[I32 | None] = [None] * len(clouds)
        self._slices: list[I8 | None] = [None] * len(clouds)
        low = np.min([cloud.low for cloud in clouds], axis=0)
        high = np.max([cloud.high for cloud in clouds], axis=0)
        self.corner: F64 = np.where(np.isfinite(low), low, 0.0)
        self.tiles = _tiles(low, high, side)
        self._grid = (self.corner, float(side), self.tiles)
        for cloud in clouds:  # a square covers parts of up to four tiles
            ends = [(cloud.squares - self.corner) / side + end for end in (-1, TILE + 1)]
            (i, j), (u, v) = (
                np.clip(end // TILE, 0, np.array(self.tiles.shape) - 1).astype(int).T
                for end in ends
            )
            self.tiles[np.concatenate([i, i, u, u]), np.concatenate([j, v, j, v])] = 0
        self._count = int(KERNELS.columns.number(self.tiles)) * TILE * TILE
        low_z: F64 = reduce(np.fmin, self._shared(self._lowest), np.full(self._count, np.nan))
        self.lowest = float(np.fmin.reduce(low_z, initial=np.inf))
        self.base: F64
        self.raised: Bool
        self.base, self.raised = KERNELS.columns.level(
            low_z, self.tiles, NEIGHBOURS, LEAST, DEVIATIONS
        )
        self.bits: I32 = reduce(
            np.bitwise_or, self._shared(self._fill), np.zeros(self._count, np.int32)
        )
        self.rows: I64 = KERNELS.columns.rows(self.bits)
        self.cuts = np.zeros((int(self.rows[-1]), 2), np.uint8)

    def __len__(self) -> int:
        """Number of columns."""
        return self._count

    def columns(self, points: F32) -> I32:
        """(N,) int32: column of each point; -1 if none."""
        found: I32 = KERNELS.columns.locate(points, *self._grid)
        return found

    def place(self, points: F32) -> Placed:
        """Column and slice of each point."""
        columns = self.columns(points)
        return columns, KERNELS.columns.slices(points, columns, self.base, self._height)

    def placed(self, cloud: int) -> Placed:
        """Column and slice of the points of one of the clouds."""
        points = self._clouds[cloud]
        columns = self._columns[cloud]
        slices = self._slices[cloud]
        columns = self.columns(points) if columns is None else columns
        if slices is None:
            slices = KERNELS.columns.slices(points, columns, self.base, self._height)
        return columns, slices

    def _shared(self, work: Callable[[range], T]) -> list[T]:
        """What some work on the clouds, shared among threads, returns.

        The same for any number of threads if merged.
        """
        lanes = min(kernels.threads_in_use(), len(self._clouds))
        parts = [range(lane, len(self._clouds), lanes) for lane in range(lanes)]
        return kernels.each(work, parts)

    def _lowest(self, part: range) -> F64:
        lowest = np.full(self._count, np.nan)
        for cloud in part:
            columns = self.columns(self._clouds[cloud])
            KERNELS.columns.lowest(self._clouds[cloud], columns, lowest)
            if self._keep:
                self._columns[cloud] = columns
        return lowest

    def _fill(self, part: range) -> I32:
        bits = np.zeros(self._count, np.int32)
        for cloud in part:
            columns, slices = self.placed(cloud)
            KERNELS.columns.fill(columns, slices, bits)
            if self._keep:
                self._slices[cloud] = slices
        return bits

    def find_ground(self, wanted: I32) -> None:
        """Find the ground in slices, given by their bits (n,), by the histograms of the heights of
        their points.
        """
        fine = np.zeros((len(self.cuts), 33), np.uint32)
        for cloud, points in enumerate(self._clouds):
            place = (points, *self.placed(cloud), self.base, self._height, self._step)
            KERNELS.columns.histograms(*place, self.bits, self.rows, wanted, fine)
        self.cuts = KERNELS.columns.ground(fine, GROUND_PART, GAP)

    def reasons(self, points: F32, steps: I32, splits: I32) -> Any:
        """(N,) uint8: reason of each point; see ``KERNELS.columns.reasons``."""
        place = (points, *self.place(points), self.base, self._height, self._step)
        return KERNELS.columns.reasons(*place, self.bits, self.rows, steps, splits, self.cuts)

    def bins(self, points: F32) -> tuple[I64, I64, I64, I64, I64]:
        """(N,) int64 each: column, slice and fine bin of points, and the ground's first bin and its
        end; -1 if none.
        """
        columns, slices = self.place(points)
        place = (points, columns, slices, self.base, self._height, self._step)
        fine, first, end = KERNELS.columns.bins(*place, self.bits, self.rows, self.cuts).T
        return (
            np.where(slices < 0, -1, columns).astype(np.int64),
            slices.astype(np.int64),
            fine,
            first,
            end,
        )

    def corners(self, columns: I64) -> F64:
        """(K, 2) float64: index of columns from the corner, along x and y."""
        tile = np.full(max(int(self.tiles.max(initial=0)) + 1, 1), -1)
        tile[self.tiles[self.tiles >= 0]] = np.flatnonzero(self.tiles.ravel() >= 0)
        i, j = np.divmod(tile[columns // 4096], self.tiles.shape[1])
        return np.stack([i * 64 + columns % 4096 // 64, j * 64 + columns % 64], 1)

    def window(self, first: I64, width: int) -> I64:
        """(width, width) int64: the columns from ``first`` (2,) on along x and y.

        -1 if they have no tile.
        """
        i, j = (first[a] + np.arange(width) for a in (0, 1))
        inside = [(x >= 0) & (x < 64 * self.tiles.shape[a]) for a, x in enumerate((i, j))]
        tile = self.tiles[
            np.ix_(np.where(inside[0], i >> 6, 0), np.where(inside[1], j >> 6, 0))
        ].astype(np.int64)
        columns: I64 = tile * 4096 + (i & 63)[:, None] * 64 + (j & 63)[None]
        columns[(tile < 0) | ~(inside[0][:, None] & inside[1][None])] = -1
        return columns


def _tiles(low: F64, high: F64, side: float) -> I32:
    """Tiles without points, -1, from the lowest to the highest x and y (2,), metres."""
    shape = (np.nan_to_num((high - low) / side, neginf=0.0) // TILE).astype(np.int64) + 1
    return np.full((int(shape[0]), int(shape[1])), -1, np.int32)
