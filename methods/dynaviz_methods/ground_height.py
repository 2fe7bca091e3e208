"""Ground height under a map that grows scan by scan, column by column."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I32, I64, Bool
from dynaviz.blocks.blocks import BlockGrid

STEEP = 0.2  # metres per metre: anything steeper is an object on the ground
SLOPE = 0.1  # metres per metre: maximum incline of the ground around, and its maximum slope beyond that incline
AROUND = 16  # columns: edge of the squares, 3 x 3 of which have a common incline
ACROSS = 4  # columns: edge of the squares that are seen as a whole
WIDE = 1024  # columns to each side of the sensor; heights beyond are infinite, because stray returns may be anywhere
PIT = 0.3  # metres: columns this far below most of those around them are reflections, not ground
NEAR = 30.0  # metres from the sensor: where errors of poses in height are corrected
LAYER = 0.1  # metres: height of a scan's densest layer, its ground
OFF = 0.06, 0.3  # metres: minimum and maximum distance of that layer from the ground of the map
LAYERED = 50, 0.1  # minimum number of points in the layer, and minimum share of the points around
SWAY = 0.005  # radians: maximum error of a pose that lifts or lowers the ground far away
SQUARE = 12.8  # metres: edge of the cells in which such an error is measured
MANY = 10  # minimum number of points near the ground there


class GroundHeight:
    """Heights above the ground: the densest layer near the lowest points, as steep as the ground around, or a bit more.

    A column is 8 x 8 voxels wide and as high as the map. A column without visible ground, for example under a car,
    gets the ground of its neighbours. A few points far below the ground do not matter: ground must contain a minimum
    share of a column's points, and must not be a pit among the surrounding columns.

    Attributes:
        squares: (columns + 1,) int32, number of the square of 4 x 4 columns that contains each column; the last is for
            voxels -1.

    Args:
        blocks: (B, 3) int64, keys of a grid's blocks of 8^3 voxels, sorted.
        resolution: edge of a voxel, metres.
    """

    squares: I32

    def __init__(self, blocks: I64, resolution: float) -> None:
        self._blocks, self._edge = blocks, 8 * resolution
        firsts = np.flatnonzero((np.diff(blocks[:, :2], axis=0, prepend=np.iinfo(np.int32).min) != 0).any(1))
        n = len(firsts)
        self._starts = np.append(firsts, len(blocks))
        self._columns = blocks[firsts, :2].astype(np.int64)
        self._column = np.append(np.repeat(np.arange(n), np.diff(self._starts)), n)  # of each block; the last is for -1
        keys, square = np.unique(self._columns // ACROSS, axis=0, return_inverse=True)
        self.squares = np.append(square, len(keys)).astype(np.int32)
        self._number, self._height = np.zeros((len(blocks), 8), np.int32), np.zeros((len(blocks), 8), np.int64)
        self._floor, self._stale = np.full(n, np.inf), np.zeros(n + 1, np.bool_)

    def __len__(self) -> int:
        """Number of columns."""
        return len(self._columns)

    def add(self, points: F32, voxels: I64) -> None:
        """Add the points of a scan.

        Args:
            points: (N, 3) float32, metres, world frame.
            voxels: (N,) int64, the voxel of each point, -1 for none.
        """
        layers = self._number, self._height, self._column, self._stale
        kernels.ground_height.add(voxels, kernels.as_readonly(points, np.float32), *layers)

    def height(self, points: F32, voxels: I64, position: F64) -> F32:
        """(N,) float32, metres: height of each point above the ground.

        Infinite if no ground is known around the scan, for points without a voxel, and beyond ``WIDE`` columns from the
        sensor.

        Args:
            points: (N, 3) float32, metres, world frame.
            voxels: (N,) int64, -1 for none.
            position: (3,) float64, metres, world frame: position of the sensor.
        """
        self._refresh()
        place = (voxels, self._column, self._columns)
        low, high = kernels.ground_height.spanned(*place)
        middle = np.floor(position[:2] / self._edge).astype(np.int64)
        low, high = np.maximum(low, middle - WIDE), np.minimum(high, middle + WIDE)
        if (low > high).any():
            return np.full(len(points), np.inf, np.float32)
        near = self._between(low[0], high[0])
        surface = kernels.ground_height.surface(self._columns[near], self._floor[near], low, high)
        for _ in range(2):  # reflections next to each other look like ground, until those below the others are gone
            surface[kernels.ground_height.pits(surface, PIT)] = np.inf
        incline = kernels.ground_height.inclines(surface, low, AROUND, STEEP * self._edge, SLOPE * self._edge)
        kernels.ground_height.lower(surface, incline, SLOPE * self._edge)
        of = kernels.as_readonly(points, np.float32), *place, low, surface, self._edge
        height: F32 = kernels.ground_height.heights(*of)
        return height

    def _refresh(self) -> None:
        """Compute the floors of the columns that got points."""
        stale = np.flatnonzero(self._stale[:-1])
        kernels.ground_height.floors(stale, self._starts, self._blocks, self._number, self._height, self._floor)
        self._stale[:] = False

    def _between(self, low: int, high: int) -> slice:
        """The columns from one x to another, both included, and maybe others."""
        return slice(*np.searchsorted(self._columns[:, 0], (low, high + 1)))

    def quarters(self, voxels: I64) -> I64:
        """(N,) int64: number of the quarter column that contains each voxel; the last numbers are for voxels -1."""
        quarters: I64 = kernels.ground_height.quarters(voxels, self._column)
        return quarters


class RollingGroundHeight(GroundHeight):
    """Heights above the ground in a grid whose blocks come and go.

    The numbers of columns wrap around in both directions, at a distance in which no two blocks exist at a time.

    Args:
        grid: follows a window.
    """

    def __init__(self, grid: BlockGrid) -> None:
        self._grid, self._edge = grid, 8 * grid.resolution
        self._size = grid.span
        n, rows = self._size**2, len(grid)
        self._columns = np.full((n, 2), np.iinfo(np.int32).min, np.int64)
        x, y, across = *np.divmod(np.arange(n), self._size), self._size // ACROSS
        self.squares = np.append(x // ACROSS * across + y // ACROSS, across**2).astype(np.int32)
        self._square_keys = np.full((across**2, 2), np.iinfo(np.int32).min, np.int64)
        self._column = np.full(rows + 1, n)  # of each block; the last is for -1
        self._number = grid.per_block(np.zeros((rows, 8), np.int32))
        self._height = grid.per_block(np.zeros((rows, 8), np.int64))
        self._floor, self._stale = np.full(n, np.inf), np.zeros(n + 1, np.bool_)
        self._watchers: list[Callable[[I64, I64], None]] = []
        grid.watch(self._came)

    def watch(self, moved: Callable[[I64, I64], None]) -> None:
        """Call ``moved`` with the numbers of columns, (M,), and of squares, whenever they come to lie elsewhere."""
        self._watchers.append(moved)

    def _came(self, numbers: I32) -> None:
        """Number the columns of new blocks; a column that was elsewhere before has no floor."""
        keys = self._grid.blocks[numbers, :2]
        columns = (keys % self._size) @ np.array([self._size, 1])
        self._column[numbers] = columns
        moved = (self._columns[columns] != keys).any(1)
        self._floor[columns[moved]] = np.inf
        self._columns[columns] = keys
        squares, places = self.squares[columns], keys // ACROSS
        elsewhere = (self._square_keys[squares] != places).any(1)
        self._square_keys[squares] = places
        for watcher in self._watchers:
            watcher(columns[moved], squares[elsewhere])

    def _refresh(self) -> None:
        blocks = np.flatnonzero(self._grid.existing())
        blocks = kernels.ground_height.stale_blocks(blocks, self._stale, self._column, self._number)
        order = np.argsort((self._column[blocks] << 32) + self._grid.blocks[blocks, 2])
        blocks = blocks[order]
        columns = self._column[blocks]
        firsts = np.flatnonzero(np.diff(columns, prepend=-1))
        floor = np.empty(len(firsts))
        layers = self._number[blocks], self._height[blocks]
        keys = kernels.as_readonly(self._grid.blocks[blocks], np.int64)
        kernels.ground_height.floors(np.arange(len(firsts)), np.append(firsts, len(blocks)), keys, *layers, floor)
        self._floor[columns[firsts]] = floor
        self._stale[:] = False

    def _between(self, low: int, high: int) -> slice:
        return slice(None)


def levelled(height: F32, points: F32, within: Bool, position: F64, low: float) -> F32:
    """(N,) float32, metres: heights above the ground as the pose of one scan places it.

    An error of the pose in height lifts or lowers the ground: near the sensor, the densest layer of the scan's points
    shows it. An error of 0.2 degrees lifts or lowers the ground by 0.2 m at 60 m: the mean height of the scan's points
    near the ground shows it.

    Args:
        height: (N,) float32, metres: heights above the ground of the map.
        points: (N, 3) float32, metres, world frame, read-only.
        within: (N,) bool: points to level; they must be finite.
        position: (3,) float64, metres, world frame: position of the sensor.
        low: metres: points at most this high are near the ground, if the pose is right.
    """
    layer = (LAYER, *OFF), *LAYERED
    height = kernels.ground_height.aligned(height, points, within, position, NEAR, SQUARE, *layer)
    near = low, PIT, SWAY, SQUARE, MANY
    found: F32 = kernels.ground_height.levelled(height, points, within, position, *near)
    return found
