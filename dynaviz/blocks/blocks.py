"""A sparse voxel grid with blocks only near points, and the marks that rays leave in it.

Wraps the kernels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I32, I64, U64, Bool
from dynaviz.blocks.rolling import RollingDirectory, empty_directory
from dynaviz.blocks.window import Window
from dynaviz.contracts.extent import CELL, Extent
from dynaviz.contracts.scan import Scan
from dynaviz.kernels.keys import REACH
from dynaviz.spatial.grid import SHIFTS, pack_indices, unpack

VOXELS = 8**3  # in a block
MARGIN = 10.0  # metres: bounds of points this far beyond the blocks are those of a tile of a map
State = TypeVar("State", bound=NDArray[Any])


@dataclass(frozen=True, slots=True, eq=False)
class Marks:
    """Voxels that the rays of one scan crossed or hit, by block of a grid.

    Attributes:
        blocks: (B,) int32, numbers of the touched blocks, without duplicates, in no particular
            order.
        bits: (B, 16) int64: for each block 512 bits of crossed voxels, then 512 bits of hit voxels;
            bit v of word w is voxel 64 w + v of the block.
    """

    blocks: I32
    bits: I64


class BlockGrid:
    """A sparse voxel grid in blocks of 8^3 voxels, which exist only where an extent contains
    points.

    Voxel k spans [k, k + 1) * resolution per axis. Its number is block * 512 + index in the block.
    The caller keeps the state in arrays of ``len(grid)`` rows, so memory grows with the mapped
    area. A directory of super-blocks of 16^3 blocks, dense over the bounds, finds the blocks, so
    maps of kilometres fit into memory.

    A grid made from a ``Window`` follows it: blocks come and go, and their numbers are used again.
    It is as long as there is room for blocks. Register state with ``per_block``, so that it is
    reset where a block goes.

    Like OctoMap's 16-bit keys, the grid reaches 32768 voxels to each side of the world's origin.
    Points beyond that, non-finite points and points outside the extent have no voxel.

    Args:
        extent: contains all points and ray origins.
        resolution: edge of a voxel, metres.
        spare: metres above and below the extent where ``extend`` may add blocks, up to as many as
            there are.

    Raises:
        ValueError: if the resolution is not positive.
    """

    _OF_WORD = 1  # number of kinds of marks at addresses

    def __init__(self, extent: Extent, resolution: float, spare: float = 0.0) -> None:
        if not resolution > 0:
            raise ValueError(f"resolution must be positive, not {resolution}")
        self.resolution = resolution
        self._per_metre = 1.0 / resolution
        self._rolling: RollingDirectory | None = None
        self._rectangle: F64 | None = (
            None  # (2, 2): around all blocks in x and y, if points lie far beyond
        )
        if isinstance(extent, Window):
            self._rolling = RollingDirectory(extent, self._per_metre, _covering)
            self._blocks = self._rolling.blocks
            self._place = self._rolling.place
        else:
            self._cover(extent, spare)
            self._rectangle = self._cropped(extent)
        lanes = kernels.threads_in_use()
        rows = len(self._blocks) + 1
        # Rows are filled in order, so rows that no scan needs never occupy physical memory.
        slots = np.zeros((lanes, rows), np.int32)
        owners = np.empty((lanes, rows), np.int32)
        masks = np.empty((lanes, rows, 16), np.int64)
        used = np.zeros(lanes, np.int64)
        self._scratch = (slots, owners, masks, used)
        near = kernels.addresses.BLOCKS if self._rolling else 0
        self._words, touched = kernels.addresses.memory(lanes, near, self._OF_WORD)
        self._near = self._words[..., 0], touched

    def _cover(self, extent: Extent, spare: float) -> None:
        """Make the blocks of an extent that is known, and their directory."""
        # super-blocks, metres
        reach = kernels.blocks.REACH // 128
        around = np.array([0.0, 0.0, spare])
        exact = np.array([extent.low - around, extent.high + around]) * self._per_metre / 128
        limits = np.nan_to_num(exact, posinf=0, neginf=0)
        bounds: I64 = np.clip(np.floor(limits), -reach, reach - 1).astype(np.int64)
        blocks = _covering(extent.cells, self._per_metre, bounds)
        rows = len(np.unique(pack_indices(blocks >> 4)))
        more = 2 if spare else 1
        directory, self._books = empty_directory(
            bounds[1] - bounds[0] + 1, 1 + more * rows, more * len(blocks)
        )
        self._place = (bounds[0], *directory)
        self._blocks = kernels.as_readonly(self._books[1], np.int64)
        self._add(blocks)

    def extend(self, points: F32) -> None:
        """Add the blocks of points (K, 3), metres, within the bounds and as long as there is room.

        Not in live use.
        """
        if self._rolling:
            return
        blocks = np.floor(points.astype(np.float64) * self._per_metre).astype(np.int64) >> 3
        base, shape = self._place[:2]
        blocks = blocks[((blocks >> 4 >= base) & (blocks >> 4 < base + shape)).all(1)]
        self._add(unpack(np.unique(pack_indices(blocks))))

    def _add(self, blocks: I32) -> None:
        kernels.window.add_blocks(kernels.as_readonly(blocks, np.int32), *self._place, *self._books)

    def _cropped(self, extent: Extent) -> F64 | None:
        """Corners (2, 2), metres, of the rectangle of all blocks, a voxel wider.

        None if the bounds are as large.
        """
        if not len(self._blocks):
            return None
        corners = (
            np.array([self._blocks[:, :2].min(0), self._blocks[:, :2].max(0) + 1])
            * 8
            * self.resolution
        )
        beyond = np.maximum(corners[0] - extent.low[:2], extent.high[:2] - corners[1]).max()
        return corners + np.array([[-1], [1]]) * self.resolution if beyond > MARGIN else None

    def reaching(self, points: F32, origins: F64) -> Bool:
        """(N,) bool: whether rays may cross a block, judged by bounds.

        In tiles of a map, most rays cross none.

        Args:
            points: (N, 3) float32, metres: ends of the rays.
            origins: (N or 1, 3) float64, metres.
        """
        found = np.ones(len(points), np.bool_)
        if self._rectangle is not None:
            for axis, (low, high) in enumerate(self._rectangle.T.tolist()):
                ends = points[:, axis]
                starts = origins[:, axis]
                found &= (np.minimum(ends, starts) <= high) & (np.maximum(ends, starts) >= low)
        return found

    def per_block(self, state: State, empty: float = 0) -> State:
        """Register state with one row per block, and return it.

        Args:
            state: (len or len + 1, ...), filled with ``empty``.
            empty: what the rows of a block are set to when it goes; blocks go in live use only.
        """
        if self._rolling:
            self._rolling.states.append((state, empty))
        return state

    @property
    def rolls(self) -> bool:
        """Whether blocks come and go."""
        return self._rolling is not None

    @property
    def blocks(self) -> I64:
        """(len, 3) int64, read-only: indices of the blocks from the world's origin.

        Sorted unless they come later.
        """
        return self._blocks

    @property
    def span(self) -> int:
        """Blocks that come and go exist within this number of blocks along each axis at a time."""
        return self._rolling.span if self._rolling else int(self._place[1].max()) * 16

    def existing(self) -> Bool:
        """(len,) bool: the blocks that exist."""
        return (
            self._rolling.exists
            if self._rolling
            else np.arange(len(self)) < len(self) - self._books[-1][0]
        )

    def neighbours(self) -> I32:
        """(len, 27) int32: numbers of the blocks around each block, by x, y and z; -1 if absent.

        Only for a grid without ``spare``. If blocks come and go, the array is kept up to date.
        """
        if self._rolling:
            return self._rolling.neighbours()
        shifts = np.array(list(product((-1, 0, 1), repeat=3))) @ (1 << SHIFTS)
        keys = self._blocks @ (1 << SHIFTS)  # sorted
        return np.stack([_positions(keys, keys + shift) for shift in shifts], 1).reshape(-1, 27)

    def remaining(self, blocks: I32) -> I32:
        """Those of some blocks (K,) from the last scan that still exist."""
        return blocks[self._rolling.exists[blocks]] if self._rolling else blocks

    def remaining_voxels(self, voxels: I64) -> I64:
        """Those of some voxels (K,) from the last scan whose blocks still exist."""
        return voxels[self._rolling.exists[voxels >> 9]] if self._rolling else voxels

    def watch(self, came: Callable[[I32], None]) -> None:
        """Call with the numbers of blocks that come, (K,) int32, before anything else happens to
        them.
        """
        if self._rolling:
            self._rolling.watchers.append(came)

    def __len__(self) -> int:
        """Number of blocks, or of those for which there is room."""
        return len(self._blocks)

    def locate(self, points: F32) -> I64:
        """Find the voxel of each point.

        Args:
            points: (N, 3) float32, metres, world frame.

        Returns:
            (N,) int64, voxel numbers; -1 for points without a voxel.
        """
        found: I64 = kernels.blocks.locate(
            kernels.as_readonly(points, np.float32), self._per_metre, *self._place
        )
        return found

    def keys(self, voxels: I64) -> I32:
        """(N, 3) int32: indices, from the world's origin, of voxel numbers (N,) int64."""
        keys: I32 = kernels.blocks.keys_of(kernels.as_readonly(voxels, np.int64), self._blocks)
        return keys

    def mark(self, scan: Scan, casts: Bool, hits: Bool) -> Marks:
        """Cast the rays of a scan.

        Args:
            scan: the scan with its ray origins.
            casts: (N,) bool: points whose rays mark voxels as crossed, from the origin's voxel to
                the last one before the point's own.
            hits: (N,) bool: points that mark their own voxel as hit.

        Returns:
            The marks; a voxel may be both crossed and hit. Rays that start beyond the grid's reach
            mark nothing.
        """
        if self._rectangle is not None:
            casts = casts & self.reaching(scan.points, scan.origins)
        return self._cast(scan.points, scan.origins, (~casts).astype(np.float32), hits)

    def _cast(self, ends: F32, origins: F64, begins: F32, hits: Bool) -> Marks:
        """Cast rays from origins (1 or N, 3) to ends (N, 3); see ``mark`` and ``raycast.mark``."""
        near = self._addresses(origins * self._per_metre)
        way = kernels.as_readonly(ends, np.float32), kernels.as_readonly(origins, np.float64)
        what = kernels.as_readonly(begins, np.float32), kernels.as_readonly(hits, np.bool_)
        kernels.raycast.mark(*(*way, *what, self._per_metre, *self._place, *self._scratch), *near)
        return self._collected(near)

    def _addresses(self, origins: F64) -> tuple[I64, U64, Bool]:
        """Addresses around the first origin within reach, (1 or more, 3), voxels.

        And their scratch memory.
        """
        first = origins[:1]
        # also finite
        within = (
            first if (np.abs(first) < REACH).all() else origins[(np.abs(origins) < REACH).all(1)]
        )
        centre: I64 = np.floor(within[0] if len(within) else np.zeros(3)).astype(np.int64)
        return centre, *self._near

    def _collected(self, near: tuple[I64, U64, Bool]) -> Marks:
        """The marks that rays left in scratch memory, which is reset."""
        if near[2].size:
            kernels.raycast.gather(*self._place, *self._scratch, *near)
        return Marks(*kernels.raycast.collect(*self._scratch))


def voxels_of(blocks: I32, bits: I64) -> I64:
    """Numbers of the voxels whose bit is set, from blocks (B,) and their bits (B, 8)."""
    voxels: I64 = kernels.blocks.voxels_of(
        kernels.as_readonly(blocks, np.int32), kernels.as_readonly(bits, np.int64)
    )
    return voxels


def read(bits: NDArray[Any], voxels: I64) -> Bool:
    """Look up the bits of voxels.

    Args:
        bits: (B, 8 or more) int64 or uint64, one row per block: bit v of word w is voxel 64 w + v
            of the block.
        voxels: (N,) int64, voxel numbers.

    Returns:
        (N,) bool; False for -1.
    """
    found: Bool = kernels.blocks.read(voxels, bits.view(np.uint64))
    return found


def _covering(cells: I32, per_metre: float, bounds: I64) -> I32:
    """(B, 3): all blocks that can contain a float32 point of a cell, within bounds of super-blocks
    (2, 3).
    """
    low = _lowest(cells.astype(np.int64))
    high = np.nextafter(_lowest(cells.astype(np.int64) + 1), np.float32(-np.inf))
    # The same products as for points. They are monotonic, so rounding cannot leave the range.
    first, last = (
        np.floor(p.astype(np.float64) * per_metre).astype(np.int64) >> 3 for p in (low, high)
    )
    spans = [range(s + 1) for s in (last - first).max(0, initial=0)]
    packed: list[I64] = [np.empty(0, np.int64)]
    for shift in product(*spans):
        blocks = np.minimum(first + np.array(shift), last)
        blocks = blocks[((blocks >> 4 >= bounds[0]) & (blocks >> 4 <= bounds[1])).all(1)]
        packed.append(pack_indices(blocks))
    return unpack(np.unique(np.concatenate(packed)))


def _positions(keys: I64, wanted: I64) -> I32:
    """Positions of the wanted keys among sorted keys; -1 if absent."""
    if not len(keys):
        return np.empty(0, np.int32)
    at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    return np.where(keys[at] == wanted, at, -1).astype(np.int32)


def _lowest(cells: I64) -> F32:
    """The lowest float32 that lies in each cell."""
    guess = (cells * CELL).astype(np.float32)
    below = np.floor(guess.astype(np.float64) * (1.0 / CELL)) < cells
    guess = np.where(below, np.nextafter(guess, np.float32(np.inf)), guess)
    lower = np.nextafter(guess, np.float32(-np.inf))
    return np.where(
        np.floor(lower.astype(np.float64) * (1.0 / CELL)) >= cells, lower, guess
    ).astype(np.float32)
