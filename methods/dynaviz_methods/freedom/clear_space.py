"""The maps of FreeDOM: conservative free space in voxels, and levels of sub-voxels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F64, I64, U8, U64
from dynaviz.blocks.blocks import VOXELS, BlockGrid, voxels_of
from dynaviz.blocks.window import Window
from dynaviz.contracts.extent import CELL, Extent
from dynaviz.contracts.scan import Scan
from dynaviz_methods.shared.lanes import lane_marks, merged
from dynaviz_methods.shared.lookups import around, known

KERNELS = kernels.load("dynaviz_methods.freedom.kernels")
SHARED = kernels.load("dynaviz_methods.shared.kernels")

SUB_VOXELS = 4  # along the edge of a voxel
GROWTH = 3  # steps
# bits of a level: 0 to 3, and whether it was raised after its scan
LEVEL = 3
RAISED = 4


@dataclass(frozen=True, slots=True, eq=False)
class Occupied:
    """The voxels of a scan.

    Attributes:
        voxels: (N,) int64, voxel of each point; -1 without a voxel, -2 out of range.
        blocks: (K,) int32, blocks with points, sorted.
        cells: (M,) int64, voxels with points, sorted.
        levels: (M,) uint8, level of each of these: 3 in free space, 2 and 1 by growth, else 0.
    """

    voxels: I64
    blocks: Any
    cells: I64
    levels: U8


class ClearSpace(BlockGrid):
    """Free space near points, and the map of their sub-voxels.

    Args:
        extent: where points will lie.
        params: those of the method.

    Attributes:
        free, seen, often, revoked: (B, 8) uint64, bits of the voxels that are free, that a ray ever
            crossed, that were ever crossed often enough to be clear, and that were free until they
            were hit too often.
    """

    def __init__(self, extent: Extent, params: Any) -> None:
        size = SUB_VOXELS * params.sub_voxel
        # The port skips blocks that are free entirely, which depends on blocks far from any point.
        super().__init__(
            _filled(extent, 24 * size) if params.port else extent.widened(2 * size), size
        )
        self._params = params
        n = len(self)
        own = self.per_block
        self._neighbours = self.neighbours()
        self.free, self.seen, self.often, self.revoked, self._hit = (
            own(np.zeros((n, 8), np.uint64)) for _ in range(5)
        )
        self._recorded = own(np.zeros(n, np.bool_))
        self._free_count = own(np.zeros((n, VOXELS), np.int32))
        self._hit_count = own(np.zeros((n, VOXELS), np.int32))
        self._marks_of_rays = lane_marks(n)
        self._ranks = np.zeros(n * VOXELS, np.int32)
        # levels by voxel; the last entry is for points without one
        self._of_scan = np.zeros(n * VOXELS + 1, np.uint8)
        self._rows = np.empty(n * VOXELS, np.int32)
        self._used = 0
        self._stamp = 0
        if self.rolls:  # memory only for blocks that exist
            own(self._rows.reshape(n, VOXELS), -1)
            self.watch(lambda came: self._rows.reshape(n, VOXELS).__setitem__(came, -1))
        else:
            self._rows[:] = -1
        self._owners = np.zeros(1024, np.int64)
        self._marks = np.zeros(1024, np.int64)
        self._scans = np.full((1024, SUB_VOXELS**3), -1, np.int32)
        self._levels = np.zeros((1024, 64), np.uint8)

    def place(self, scan: Scan) -> I64:
        """(N,) int64: the voxel of each point; -1 if it has none, -2 if it is out of range."""
        p = self._params
        points = kernels.as_readonly(scan.points, np.float32)
        limits = np.array([p.min_range, p.max_range]), np.array([p.min_height, p.max_height])
        voxels: I64 = KERNELS.free_voxels.place(
            points, scan.position.copy(), *limits, self._per_metre, *self._place
        )
        return voxels

    def hit(self, voxels: I64) -> tuple[Occupied, I64]:
        """Detect points in free space, count hits, and revoke.

        Returns:
            The occupied voxels, and those that were hit too often.
        """
        k = KERNELS.free_voxels
        state = (self._recorded, self.free, self._free_count, self._hit_count, self.revoked)
        blocks = np.sort(SHARED.ever_free.put(voxels, self._hit))
        cells = voxels_of(blocks, self._hit[blocks].view(np.int64))
        levels = np.zeros(len(cells), np.uint8)
        self._ranks[cells] = np.arange(len(cells), dtype=np.int32)
        lost = k.hit(cells, self._params.counts_to_revert, *state, self._neighbours, levels)
        k.grow(cells, self._ranks, self._hit, self._neighbours, levels)
        return Occupied(voxels, blocks, cells, levels), lost

    def means(self, scan: Scan, occupied: Occupied) -> F64:
        """(M, 3) float64, metres: the mean of the points of each occupied voxel."""
        points = kernels.as_readonly(scan.points, np.float32)
        means: F64 = KERNELS.free_voxels.centres(
            points, occupied.voxels, self._ranks, len(occupied.cells)
        )
        return means

    def cast(self, scan: Scan, targets: F64) -> tuple[Any, U64, I64]:
        """Cast rays, count the voxels that they cross, and set free.

        Returns:
            The blocks with crossed voxels, the bits of these, and the voxels that turn free.
        """
        p = self._params
        k = KERNELS.free_voxels
        heights = np.array(
            [max(p.min_height, p.ray_min_height), min(p.max_height, p.ray_max_height)]
        )
        way = scan.position.copy(), min(p.max_range, p.ray_range), heights, self.resolution, p.port
        k.cast(targets, *way, self._hit, *self._place, *self._marks_of_rays)
        blocks, crossed = merged(*self._marks_of_rays)
        candidates = np.zeros_like(crossed)
        counts = self._recorded, self.free, self._free_count
        remembered = self.seen, self.often, candidates
        k.count(blocks, crossed, p.counts_to_free, p.port, *counts, self._hit_count, *remembered)
        chosen = voxels_of(blocks, candidates.view(np.int64))
        return (
            blocks,
            crossed,
            k.release(chosen, p.counts_to_free, self._neighbours, *counts, self.revoked),
        )

    def take_back(self, freed: I64) -> None:
        """Raise the levels of what earlier scans saw in voxels that turn free."""
        k = KERNELS.sub_voxels
        steps = GROWTH - 1 if self._params.port else GROWTH
        seeds = k.pairs(freed, self._rows, self._scans)
        seeds = seeds[np.argsort(seeds[:, 0], kind="stable")]
        table = self._rows, self._scans, self._levels
        self._stamp = k.take_back(seeds, steps, self._neighbours, *table, self._marks, self._stamp)

    def insert(self, scan: Scan, occupied: Occupied, number: int) -> U8:
        """Insert a scan into the map.

        Returns the level of each point by its own scan, (N,) uint8.
        """
        if self.rolls and self._used + len(occupied.cells) > len(self._owners):
            self._compact()
        while self._used + len(occupied.cells) > len(self._owners):
            self._owners = np.append(self._owners, np.zeros_like(self._owners))
            self._marks = np.append(self._marks, np.zeros_like(self._marks))
            self._levels = np.append(self._levels, np.zeros_like(self._levels), 0)
            self._scans = np.append(self._scans, np.full_like(self._scans, -1), 0)
        self._of_scan[occupied.cells] = occupied.levels
        table = self._rows, self._owners, self._used, self._scans, self._levels
        self._used = KERNELS.sub_voxels.insert(
            occupied.voxels, self._sub(scan), number, self._of_scan, *table
        )
        own = np.where(occupied.voxels >= 0, self._of_scan[occupied.voxels], 0).astype(np.uint8)
        self._of_scan[occupied.cells] = 0
        self._hit[occupied.blocks] = 0
        return own

    def _compact(self) -> None:
        """Close the gaps that voxels left in the table when their blocks went."""
        kept = np.flatnonzero(self._rows[self._owners[: self._used]] == np.arange(self._used))
        for table in (self._owners, self._marks, self._scans, self._levels):
            table[: len(kept)] = table[kept]
        self._scans[len(kept) :] = -1
        self._levels[len(kept) :] = 0
        self._used = len(kept)
        self._rows[self._owners[: self._used]] = np.arange(self._used, dtype=np.int32)

    def passes(self, voxels: I64) -> tuple[F64, F64]:
        """Scans in a row that passed through each voxel (K,), and clear voxels among the 27 around
        it; NaN if none.
        """
        voxels = np.maximum(voxels, -1)
        cubes = around(self, voxels)
        counts = np.where(cubes < 0, 0, self._free_count.ravel()[cubes])
        clear = (counts >= self._params.counts_to_free).sum(1)
        return known(self._free_count.ravel()[voxels], voxels), known(clear, voxels)

    def levels(self, scan: Scan, voxels: I64) -> U8:
        """(N,) uint8: the level of each point's sub-voxel, plus RAISED if it was raised after its
        scan.
        """
        found: U8 = KERNELS.sub_voxels.look_up(voxels, self._sub(scan), self._rows, self._levels)
        return found

    def _sub(self, scan: Scan) -> U8:
        """(N,) uint8: the index of each point's sub-voxel in its voxel."""
        points = kernels.as_readonly(scan.points, np.float32)
        found: U8 = KERNELS.sub_voxels.places(points, 1.0 / self._params.sub_voxel)
        return found


def _filled(extent: Extent, around: float) -> Extent:
    """All cells within the bounds of an extent, and around them, metres.

    Live, those that rays reach.
    """
    if isinstance(extent, Window):
        return extent
    low = extent.low - around
    high = extent.high + around
    first, last = (np.floor(bound / CELL).astype(np.int64) for bound in (low, high))
    axes = [np.arange(a, b + 1, dtype=np.int32) for a, b in zip(first, last, strict=True)]
    return Extent(low, high, np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3))
