"""Tiles: squares of the world's xy plane. Each point belongs to exactly one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F64, I64
from dynaviz.scan import Scan

Tile = tuple[int, int]
"""Column and row: tile (i, j) spans [i, i + 1) * size in x and [j, j + 1) * size in y."""
_HALF = 1 << 30  # packs two indices into one int64
GRAIN = 64.0  # metres: local origins are multiples of this, which float32 coordinates represent exactly


@dataclass(frozen=True)
class TileGrid:
    """Squares of ``size`` metres."""

    size: float

    def owners(self, scan: Scan) -> I64:
        """(N,) int64: the packed tile of each point; points that are not finite belong to the sensor's tile."""
        xy = scan.points[:, :2].astype(np.float64)
        lost = ~np.isfinite(scan.points).all(1)
        xy[lost] = scan.position[:2]
        i, j = np.floor(xy / self.size).astype(np.int64).T
        packed: I64 = (i + _HALF) << 32 | (j + _HALF)
        return packed

    def bounds(self, tile: Tile) -> F64:
        """(2, 2) float64, metres: lower and upper corner of a tile in x and y."""
        return np.array([tile, np.add(tile, 1)], np.float64) * self.size

    def local_origin(self, tile: Tile, near: float) -> F64:
        """(3,) float64, metres: where a tile's run has its origin; 0 along axes on which it is near the world's.

        Far from the world's origin, voxel keys end. Moving points there and back changes no bit of them.

        Args:
            tile: the tile.
            near: metres, at least twice the size: within this distance, coordinates stay as they are, so that the
                labels are those of a run without tiles.
        """
        corners = self.bounds(tile)
        far = np.abs(corners).max(0) > near
        return np.append(np.where(far, np.round(corners.mean(0) / GRAIN) * GRAIN, 0.0), 0.0)


def unpacked(packed: int) -> Tile:
    """The tile of a packed number."""
    return int(packed >> 32) - _HALF, int(packed & 0xFFFFFFFF) - _HALF


def packed(tile: Tile) -> int:
    """The number of a tile, as in ``TileGrid.owners``."""
    return (tile[0] + _HALF) << 32 | (tile[1] + _HALF)
