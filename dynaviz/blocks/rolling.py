"""The directory of a block grid whose blocks come and go with a window."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz import kernels
from dynaviz.arrays import F64, I32, I64
from dynaviz.blocks.window import Window
from dynaviz.contracts.extent import CELL

FAR = 20  # super-blocks beyond the window, through which rays to far points lead
ROOM = 1.3  # blocks per cell, of the same size: a cell that rounding splits needs two

Covering = Callable[[I32, float, I64], I32]
Directory = tuple[I64, I32, I32]  # its shape in super-blocks, ``top`` and ``children``
# blocks per row of children, keys, free blocks and children, and how many
Books = tuple[I32, I64, I32, I32, I64]


def empty_directory(shape: I64, rows: int, capacity: int) -> tuple[Directory, Books]:
    """A directory without blocks (``kernels/blocks.py``), and the books of what is free
    (``kernels/window.py``).

    Args:
        shape: (3,), number of super-blocks along each axis.
        rows: of children, the first of which stays empty.
        capacity: number of blocks for which there is room.
    """
    top = np.zeros(int(shape.prod()), np.int32)
    children = np.zeros((rows, 4096), np.int32)
    # The last entries are used first, so rows fill from the first on and the others never occupy
    # memory.
    free = np.arange(capacity - 1, -1, -1, dtype=np.int32)
    free_children = np.arange(rows - 1, 0, -1, dtype=np.int32)
    left = np.array([len(free), len(free_children)])
    keys = np.zeros((capacity, 3), np.int64)
    return (shape, top, children), (np.zeros(rows, np.int32), keys, free, free_children, left)


class RollingDirectory:
    """Blocks in rows that are used again, and the directory that finds them
    (``kernels/blocks.py``).

    Args:
        window: which cells exist.
        per_metre: voxels per metre.
        covering: the blocks that cover cells, within bounds of super-blocks.

    Attributes:
        blocks: (capacity, 3) int64, read-only: indices of the blocks.
        exists: (capacity,) bool.
        farthest: metres from the world's origin, along each axis, up to which blocks exist.
        span: no two blocks that exist are so many blocks apart along an axis.
        place: base, shape, top and children, as the kernels take them; changed in place.
        states: arrays with one row per block, and the value of empty rows.
        watchers: called with the numbers of blocks that come.
    """

    def __init__(self, window: Window, per_metre: float, covering: Covering) -> None:
        self._per_metre = per_metre
        self._covering = covering
        self._edge = 8 / per_metre  # of a block, metres
        capacity = round(ROOM * window.room * max((CELL / self._edge) ** 3, 1.0))
        across = math.ceil(2 * (window.limit + 4 * CELL) / (16 * self._edge)) + 2  # super-blocks
        self.farthest = kernels.blocks.REACH / per_metre
        self.span = 16 * across
        shape = np.full(3, across + 2 * FAR, np.int64)
        directory, self._books = empty_directory(shape, across**3 + 1, capacity)
        self.place = (np.zeros(3, np.int64), *directory)
        self.blocks: I64 = self._books[1].view()
        self.blocks.flags.writeable = False
        self.exists = np.zeros(capacity, np.bool_)
        self.states: list[tuple[NDArray[Any], float]] = []
        self.watchers: list[Callable[[I32], None]] = []
        self._gone = np.empty(0, np.int32)
        self._neighbours: I32 | None = None
        window.attach(self)

    def neighbours(self) -> I32:
        """(capacity, 27) int32, kept up to date from the first call on.

        The blocks around each block; -1 if absent.
        """
        if self._neighbours is None:
            # rows are filled when their block comes
            self._neighbours = np.empty((len(self.exists), 27), np.int32)
        return self._neighbours

    def grow(self, cells: I32, position: F64) -> bool:
        """Add the blocks that cover cells (K, 3); returns False if there was no room for all."""
        self._centre(position)
        base, shape, *_ = self.place
        reach = kernels.blocks.REACH // 128
        bounds = np.clip([base, base + shape - 1], -reach, reach - 1)
        if (bounds[0] > bounds[1]).any():
            return True
        blocks = kernels.as_readonly(self._covering(cells, self._per_metre, bounds), np.int32)
        added, room = kernels.window.add_blocks(blocks, *self.place, *self._books)
        self.exists[added] = True
        if self._neighbours is not None:
            kernels.window.join(added, *self.place, self._books[1], self._neighbours)
        for came in self.watchers:
            came(added)
        return bool(room)

    def shrink(self, position: F64, limit: float) -> None:
        """Remove the blocks of which no cell is within ``limit`` metres of a position, and reset
        their state.

        Their rows are used again only after the next call, so that methods which remember numbers
        of blocks or voxels from the last scan find out with ``exists`` that they are gone.
        """
        free = self._books[2]
        left = self._books[4]
        free[left[0] : left[0] + len(self._gone)] = self._gone
        left[0] += len(self._gone)
        limit += CELL + self._edge  # of centres: half diagonals of both
        gone = kernels.window.far_blocks(
            self.blocks, self.exists, position / self._edge, limit / self._edge
        )
        for state, empty in self.states:
            state[gone] = empty
        self.exists[gone] = False
        if self._neighbours is not None:
            kernels.window.part(gone, self._neighbours)
        kernels.window.remove_blocks(gone, *self.place, *self._books)
        self._gone = gone

    def _centre(self, position: F64) -> None:
        """Move the directory if the sensor is more than a quarter of FAR from its middle."""
        base, shape, top, _ = self.place
        wanted = np.floor(position / (16 * self._edge)).astype(np.int64) - shape // 2
        if np.abs(wanted - base).max() <= FAR // 4:
            return
        old = top.reshape(shape).copy()
        new = np.zeros(shape, np.int32)
        shift = wanted - base
        if (np.abs(shift) < shape).all():
            to = tuple(slice(max(-s, 0), n - max(s, 0)) for s, n in zip(shift, shape, strict=True))
            of = tuple(slice(max(s, 0), n - max(-s, 0)) for s, n in zip(shift, shape, strict=True))
            new[to] = old[of]
        top[:] = new.ravel()
        base[:] = wanted
