"""A window that follows the sensor.

The extent of live use, whose cells come with the rays and go beyond reach.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F64, I32
from dynaviz.contracts.extent import CELL, Extent
from dynaviz.contracts.scan import Scan

SLACK = 0.1  # part of the reach by which cells must lie beyond it before they are dropped
# metres: the height of the space for which there is room over the whole disc; rarely half of it is
# needed
HIGH = 20.0
MOVE = 2 * CELL  # metres that the sensor moves between two looks for what can be dropped
CROWDED = 0.8  # part of the cells that is kept if there is no room for more


class Follower(Protocol):
    """What lives in a window: a grid.

    Attributes:
        farthest: metres from the world's origin, along each axis, up to which it has keys.
    """

    farthest: float

    def grow(self, cells: I32, position: F64) -> bool:
        """Add what covers new cells (K, 3); returns False if there was no room for all."""
        ...

    def shrink(self, position: F64, limit: float) -> None:
        """Drop what lies farther than ``limit`` metres from a position (3,), metres,
        world frame.
        """
        ...


class Window(Extent):
    """The extent of live use: cells that any ray reached so far, within a distance of the sensor.

    In a recorded sequence the extent is known before the first scan, and only space with points has
    state. Live, a point may arrive anywhere later, so all space that rays cross has state from then
    on. Grids made from a window follow it. Call ``follow`` with each scan before the method
    observes it.

    Args:
        reach: metres around the sensor. Cells up to a tenth farther are kept if they exist.
        around: metres around rays and points that must exist, too.
    """

    _cells: _Cells

    def __init__(self, reach: float, around: float = CELL) -> None:
        nowhere = np.zeros((0, 3), np.int32)
        super().__init__(np.zeros(3), np.zeros(3), nowhere)
        object.__setattr__(self, "_cells", _Cells(reach, max(1, math.ceil(around / CELL))))

    @property
    def reach(self) -> float:
        """Metres around the sensor."""
        return self._cells.reach

    @property
    def limit(self) -> float:
        """Metres around the sensor beyond which nothing exists for long."""
        return self._cells.reach * (1 + SLACK)

    @property
    def farthest(self) -> float:
        """Metres from the world's origin up to which a sensor may go.

        All grids reach beyond it by the limit.
        """
        return (
            min((follower.farthest for follower in self._cells.followers), default=math.inf)
            - 1.5 * self.limit
        )

    @property
    def room(self) -> int:
        """Largest number of cells."""
        return len(self._cells.cells)

    def __len__(self) -> int:
        """Number of cells now."""
        return self._cells.count

    def widened(self, around: float, axes: tuple[int, ...] = (0, 1, 2)) -> Window:
        """This window, with all cells within ``around`` metres of rays and points,
        along all axes.
        """
        self._cells.around = max(self._cells.around, math.ceil(around / CELL))
        return self

    def attach(self, follower: Follower) -> None:
        """Let a grid follow the window."""
        self._cells.followers.append(follower)

    def follow(self, scan: Scan) -> None:
        """Move to the scan's sensor, and add the cells that its rays reach."""
        self._cells.follow(scan)


class _Cells:
    """The cells of a window; see ``kernels/window.py``."""

    def __init__(self, reach: float, around: int) -> None:
        self.reach = reach
        self.around = around
        self.followers = list[Follower]()
        limit = reach * (1 + SLACK) / CELL + around + 2  # cells
        self._size = 1 << math.ceil(math.log2(2 * limit + 4))
        self._flags = np.zeros(self._size**3, np.uint8)
        disc = math.pi * limit**2
        self.cells = np.zeros((round(disc * min(HIGH / CELL, 2 * limit)), 3), np.int32)
        self.count = 0
        self._looked = np.full(3, np.inf)  # position at the last look for what can be dropped

    def follow(self, scan: Scan) -> None:
        if not np.isfinite(scan.position).all():
            return
        if not np.abs(scan.position - self._looked).max() < MOVE:
            self._drop(scan.position, self.reach * (1 + SLACK))
        before = self.count
        self._visit(scan)
        new = self.cells[before : self.count]
        room = [follower.grow(new, scan.position) for follower in self.followers]
        if self.count == len(self.cells) or not all(room):
            self._crowd_out(scan)

    def _visit(self, scan: Scan) -> None:
        points = kernels.as_readonly(scan.points, np.float32)
        origins = kernels.as_readonly(scan.origins, np.float64)
        mask = self._size - 1
        to = self.reach, 1.0 / CELL, self.around, self._flags, mask, self.cells, self.count
        self.count = int(kernels.window.visit(points, origins, *to))

    def _drop(self, position: F64, limit: float) -> None:
        self._looked = position.copy()
        far = limit / CELL
        inner = limit / CELL - 2 * (self.around + 1)
        to = position / CELL, far, inner, self._flags, self._size - 1, self.cells, self.count
        self.count = int(kernels.window.drop(*to))
        for follower in self.followers:
            follower.shrink(position, limit)

    def _crowd_out(self, scan: Scan) -> None:
        """Drop the farthest cells to make room.

        Memory is bounded even where rays fill all space.
        """
        centres = (self.cells[: self.count] + 0.5) * CELL
        distances = np.linalg.norm(centres - scan.position, axis=1)
        self._drop(scan.position, float(np.quantile(distances, CROWDED)))
        self._flags &= ~kernels.window.VISITED
        self._visit(scan)
        for follower in self.followers:
            follower.grow(self.cells[: self.count], scan.position)
