"""The map of Dynablox: ever-free voxels, learned scan by scan from a projective TSDF."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I32, I64, U64, Bool
from dynaviz.blocks.blocks import VOXELS, BlockGrid, read, voxels_of
from dynaviz.blocks.window import Window
from dynaviz.contracts.extent import CELL, Extent
from dynaviz.contracts.probe import ImageSpan, Voxels
from dynaviz.contracts.scan import Scan
from dynaviz.spatial.grid import SHIFTS

KERNELS = kernels.load("dynaviz_methods.dynablox.kernels")
SHARED = kernels.load("dynaviz_methods.shared.kernels")

Bits = tuple[I32, U64]

KEY = 1 << SHIFTS  # packs the indices of a block into one number; the order is that of the grid
LONG_AGO = -(2**30)


@dataclass(frozen=True)
class SensorView:
    """The layout of the range image.

    Rows from the highest to the lowest elevation, columns over 360 degrees.

    Attributes:
        rows, columns: size, pixels.
        top, bottom: elevation of the centres of the first and the last row, degrees.
    """

    rows: int
    columns: int
    top: float
    bottom: float

    @property
    def numbers(self) -> tuple[float, float, float, float, float]:
        """Rows, columns, top elevation (radians), rows per radian, columns per radian, as the
        kernels take them.
        """
        per_row = math.degrees((self.rows - 1) / (self.top - self.bottom))
        return (
            float(self.rows),
            float(self.columns),
            math.radians(self.top),
            per_row,
            self.columns / (2 * math.pi),
        )

    @property
    def span(self) -> ImageSpan:
        """The directions that the image shows."""
        _, columns, top, per_row, per_column = self.numbers
        return ImageSpan(
            left=-math.pi - 0.5 / per_column,
            right=(columns - 0.5) / per_column - math.pi,
            top=top + 0.5 / per_row,
            bottom=top - (self.rows - 0.5) / per_row,
        )


class FreeSpace:
    """Truncated signed distances and ever-free flags of the voxels where points can lie and of
    their neighbours.

    Call per scan: ``look``, ``locate`` its points, ``learn`` (ever-free voxels from earlier scans
    and these points), ``integrate``.

    Attributes:
        free: (B, 8) uint64: bits of the ever-free voxels.
        revoked: (B, 8) uint64: bits of the voxels that were ever-free until they stayed occupied.
        neighbours: (B, 27) int32: numbers of the blocks around each block; -1 if absent.
        image: (rows, columns) float32, metres: the last scan's range image, 0 for pixels without
            return.
        span: the directions that it shows.
    """

    def __init__(self, extent: Extent, params: Any, view: SensorView) -> None:
        self._params = params
        self._view = view
        self._frame = -1
        n = self._follow(extent) if isinstance(extent, Window) else self._lay_out(extent)
        voxels = int(self._first[-1])
        self._distance = np.zeros(voxels, np.float32)
        self._weight = np.zeros(voxels, np.uint16)
        self._counts = np.zeros(voxels, np.uint16)
        if self.grid.rolls:
            for state in (self._distance, self._weight, self._counts):
                self.grid.per_block(state.reshape(n, VOXELS))
        (
            self.free,
            self.revoked,
            self._observed,
            self._near,
            self._clear,
            self._updated,
            self._hit,
            self._reached,
        ) = (self.grid.per_block(np.zeros((n, 8), np.uint64)) for _ in range(8))
        self._recent = self.grid.per_block(np.zeros((n, params.burn_in + 1, 8), np.uint64))
        self._stamps = self.grid.per_block(
            np.full((n, params.burn_in + 1), LONG_AGO, np.int32), LONG_AGO
        )
        self._seen: list[I32] = []  # blocks visited in each of the last frames
        self._in_view = np.empty(0, np.int32)
        self.image = np.zeros((view.rows, view.columns), np.float32)
        self.span = view.span

    def _lay_out(self, extent: Extent) -> int:
        """Allocate the blocks where points can lie and the blocks around them.

        Return their number.
        """
        size = self._params.resolution
        reach = math.ceil(size / CELL)
        shifts = np.array(list(product(range(-reach, reach + 1), repeat=3)), np.int32)
        cells = np.unique((extent.cells[:, None] + shifts).reshape(-1, 3), axis=0)
        self.grid = BlockGrid(
            Extent(extent.low - reach * CELL, extent.high + reach * CELL, cells), size
        )
        self._blocks = self.grid.blocks.copy()
        self._inner = np.isin(self._blocks @ KEY, BlockGrid(extent, size).blocks @ KEY)
        self._outer = np.append(~self._inner, True)  # the last entry is for points without a block
        self.neighbours = self.grid.neighbours()
        full = np.where(self._inner, ~np.uint64(0), np.uint64(0))
        self._needed = SHARED.ever_free.spread(np.repeat(full[:, None], 8, 1), self.neighbours)
        self._first = np.append(0, np.cumsum(np.bitwise_count(self._needed).sum(1, dtype=np.int64)))
        return len(self.grid)

    def _follow(self, window: Window) -> int:
        """Let blocks come and go with a window, with all voxels of each.

        Return for how many there is room.

        Pixels of the range image observe the space between rays, too.
        """
        p = self._params
        view = self._view
        pixel = max(1 / view.numbers[3], 1 / view.numbers[4])  # radians
        self.grid = BlockGrid(
            window.widened(pixel * window.reach + p.truncation + p.resolution), p.resolution
        )
        n = len(self.grid)
        self._blocks = self.grid.blocks
        self.neighbours = self.grid.neighbours()
        self._inner = np.ones(n, np.bool_)
        self._needed = np.full((n, 8), ~np.uint64(0))
        self._first = np.arange(n + 1) * VOXELS
        return n

    def locate(self, points: F32) -> I64:
        """(N,) int64: the voxel of each point, -1 if none.

        Args:
            points: (N, 3) float32, metres, world frame.
        """
        voxels = self.grid.locate(points)
        if not self.grid.rolls:
            voxels[self._outer[voxels // VOXELS]] = -1
        return voxels

    def distances(self, voxels: I64) -> F64:
        """(K,) float64, metres: the signed distances of voxels (K,).

        NaN where no scan observed them.
        """
        bits = np.unpackbits(self._needed[voxels >> 9].view(np.uint8), axis=1, bitorder="little")
        before = np.arange(VOXELS) < (voxels & 511)[:, None]
        places = np.minimum(
            self._first[voxels >> 9] + (bits * before).sum(1, dtype=np.int64),
            len(self._distance) - 1,
        )
        return np.where(read(self._observed, voxels), self._distance[places], np.nan).astype(
            np.float64
        )

    def clear(self, voxels: I64) -> Bool:
        """(K,) bool: which voxels are clear.

        Observed, far enough from a surface, and not occupied for a while.
        """
        return read(self._clear, voxels)

    def learn(self, voxels: I64) -> tuple[Bits, Bits]:
        """Update occupancy counts and ever-free voxels by one frame.

        Args:
            voxels: (K,) int64: voxels with points of this scan; -1 for none.

        Returns:
            Voxels that became ever-free, and voxels that are no longer ever-free; each as blocks
            and their bits.
        """
        p = self._params
        k = SHARED.ever_free
        lanes = kernels.threads_in_use()
        self._frame += 1
        self._in_view = self.grid.remaining(self._in_view)
        self._seen = [self.grid.remaining(blocks) for blocks in self._seen]
        now = self._union(self._in_view, k.put(voxels, self._hit))
        # Voxels last occupied more than burn_in frames ago may be clear now. At the end of the
        # first burn-in this holds for all voxels: those never occupied count as occupied just
        # before the first frame.
        forgotten = (
            self._seen if self._frame == p.burn_in else self._seen[: self._frame > p.burn_in]
        )
        active = self._union(now, *forgotten)
        reached = k.occupy(
            *(active, self._frame, p.burn_in, p.temporal_buffer, p.revoke_after),
            *(self._hit, self._updated, self._observed, self._near, self._recent, self._stamps),
            *(self._needed, self._first, self._counts, self._clear, self._reached),
        )
        inner = now[self._inner[now]]
        new = np.zeros((len(inner), 8), np.uint64)
        lost = np.zeros((0, 8), np.uint64)
        k.release(
            inner, self.neighbours, self._updated, self._clear, self.free, self.revoked, new, lanes
        )
        reaching = active[reached]
        losing = self._union(self.neighbours[reaching]) if len(reaching) else reaching
        if len(losing):
            lost = np.zeros((len(losing), 8), np.uint64)
            k.revoke(losing, self.neighbours, self._reached, self.free, self.revoked, lost, lanes)
            self._reached[reaching] = 0
        self._hit[now] = 0
        self._updated[now] = 0
        self._seen = [*self._seen, now][-p.burn_in - 1 :]
        return (inner, new), (losing, lost)

    def look(self, scan: Scan) -> Bool:
        """Make the range image of a scan; return the points within range, (N,) bool."""
        p = self._params
        self._position = scan.position.copy()
        self._axes = np.ascontiguousarray(scan.T_world_sensor[:3, :3].T)
        farthest = p.max_range or math.inf
        pixels, ranges, inside = KERNELS.signed_distance.pixels(
            scan.points, self._position, self._axes, p.min_range, farthest, self._view.numbers
        )
        image = KERNELS.signed_distance.image(pixels, ranges, self._view.rows, self._view.columns)
        self.image = image.reshape(self.image.shape)
        within: Bool = inside
        return within

    def integrate(self) -> None:
        """Update the TSDF of all voxels in view with the distances from the range image."""
        p = self._params
        view = self._view.numbers
        k = KERNELS.signed_distance
        pose = self._position, self._axes
        edge = 8 * p.resolution
        self._in_view = self._visible(edge)
        k.integrate(
            *(
                self._in_view,
                self._blocks,
                p.resolution,
                *pose,
                self._offsets(),
                view,
                self.image.ravel(),
            ),
            *(p.truncation, p.occupied_distance, p.max_weight, self._needed, self._first),
            *(
                self._distance,
                self._weight,
                self._observed,
                self._near,
                self._updated,
                kernels.threads_in_use(),
            ),
        )

    def _visible(self, edge: float) -> I32:
        """Blocks that may contain voxels in view."""
        p = self._params
        view = self._view
        k = KERNELS.signed_distance
        farthest = k.farthest(self.image.ravel(), view.rows, view.columns)
        pose = self._position, self._axes, view.numbers, farthest, p.truncation
        if self.grid.rolls:
            blocks = np.flatnonzero(self.grid.existing()).astype(np.int32)
            in_view: Bool = k.in_view(self._blocks, blocks, edge, *pose)
            return blocks[in_view]
        reach = float(self.image.max()) + p.truncation + edge
        ends = np.floor((self._position[0] + np.array((-reach, reach + edge))) / edge)
        first, last = np.searchsorted(self._blocks[:, 0], ends)  # blocks are sorted by x first
        near = np.arange(first, last, dtype=np.int32)
        seen: Bool = k.in_view(self._blocks, near, edge, *pose)
        return near[seen]

    def _union(self, *blocks: I32) -> I32:
        """The union of several lists of blocks, sorted; -1 is ignored."""
        chosen = np.zeros(len(self._blocks) + 1, np.bool_)
        for numbers in blocks:
            chosen[numbers] = True
        return np.flatnonzero(chosen[:-1]).astype(np.int32)

    def near(self, bits: Bits, distance: float) -> Voxels:
        """The voxels (blocks and bits) within a distance of the sensor, metres, as a
        state to show.
        """
        keys = self.grid.keys(voxels_of(bits[0], bits[1].view(np.int64)))
        size = self.grid.resolution
        offset = (keys + 0.5) * size - self._position
        return Voxels(keys[np.einsum("ij,ij->i", offset, offset) < distance**2], size)

    def _offsets(self) -> F32:
        """(3, 512) float32, metres, sensor axes.

        From a block's corner to the centres of its voxels.
        """
        places = np.stack(np.unravel_index(np.arange(VOXELS), (8, 8, 8)))
        return np.ascontiguousarray(
            self._axes @ (places + 0.5) * self._params.resolution, np.float32
        )
