"""Tiles: squares of the world's xy plane. Each point belongs to exactly one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from dynaviz.arrays import F64, I64, Intp
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Outcome, Scan
from dynaviz.engine.loop import Listener
from dynaviz.scores.sections import TileRow, Tiling

Tile = tuple[int, int]
"""Column and row: tile (i, j) spans [i, i + 1) * size in x and [j, j + 1) * size in y."""
_HALF = 1 << 30  # packs two indices into one int64
_NEAR = 1.0  # metres: more than any rounding of coordinates
GRAIN = (
    64.0  # metres: local origins are multiples of this, which float32 coordinates represent exactly
)


@dataclass(frozen=True)
class TileGrid:
    """Squares of ``size`` metres."""

    size: float

    def owners(self, scan: Scan) -> I64:
        """(N,) int64: the packed tile of each point.

        Points that are not finite belong to the sensor's tile.
        """
        x = scan.points[:, 0].astype(np.float64)
        y = scan.points[:, 1].astype(np.float64)
        if not np.isfinite(scan.points).all():
            lost = ~np.isfinite(scan.points).all(1)
            x[lost], y[lost] = scan.position[:2]
        i, j = (np.floor(along / self.size).astype(np.int64) + _HALF for along in (x, y))
        packed: I64 = i << 32 | j
        return packed

    def counted(self, scan: Scan) -> tuple[I64, I64, I64]:
        """The tiles of a scan, (T,) packed and in order, the place in these of each point, (N,),
        and points of each.
        """
        # runs of equal tiles are long, so these are sorted instead of points
        owners = self.owners(scan)
        starts = np.flatnonzero(
            np.append(len(owners) > 0, owners[1:] != owners[:-1])[: len(owners)]
        )
        tiles, of = np.unique(owners[starts], return_inverse=True)
        lengths = np.diff(np.append(starts, len(owners)))
        counts = np.bincount(of, lengths, len(tiles)).astype(np.int64)
        return tiles, np.repeat(of, lengths), counts

    def rows(self, scan: Scan, tile: Tile, origin: F64) -> Intp:
        """(K,) the points that belong to a tile, of a scan to whose coordinates ``origin``, (3,)
        metres, is added.
        """
        low, high = self.bounds(tile) - origin[:2]
        near = np.ones(len(scan), np.bool_)
        for axis, (first, last) in enumerate(
            zip((low - _NEAR).tolist(), (high + _NEAR).tolist(), strict=True)
        ):
            near &= (scan.points[:, axis] >= first) & (scan.points[:, axis] <= last)
        if not np.isfinite(scan.points).all():
            near |= ~np.isfinite(scan.points).all(1)
        rows = np.flatnonzero(near)
        chosen = scan.chosen(rows)
        own: Intp = rows[
            self.owners(chosen.moved(origin) if origin.any() else chosen) == packed(tile)
        ]
        return own

    def bounds(self, tile: Tile) -> F64:
        """(2, 2) float64, metres: lower and upper corner of a tile in x and y."""
        return np.array([tile, np.add(tile, 1)], np.float64) * self.size

    def local_origin(self, tile: Tile, near: float) -> F64:
        """(3,) float64, metres: where a tile's run has its origin.

        0 along axes on which it is near the world's.

        Far from the world's origin, voxel keys end. Moving points there and back changes no bit of
        them.

        Args:
            tile: the tile.
            near: metres, at least twice the size: within this distance, coordinates stay as they
                are, so that the labels are those of a run without tiles.
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


class TileCounts(Listener):
    """Counts points by tile and outcome; memory grows with the number of tiles only.

    Args:
        tiling: of the run, without its counts.

    Attributes:
        outcomes: (6,) int64 numbers of points by ``Outcome``, of each tile with points.
    """

    def __init__(self, tiling: Tiling) -> None:
        self.size = tiling.size_m
        self._tiling = tiling
        self._grid = TileGrid(self.size)
        self.outcomes: dict[Tile, I64] = {}

    def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
        """Count the points of a scan."""
        tiles, of, _ = self._grid.counted(labelled.scan)
        kinds = len(Outcome)
        counts = np.bincount(of * kinds + labelled.outcome, minlength=len(tiles) * kinds).reshape(
            -1, kinds
        )
        for tile, count in zip(map(unpacked, tiles.tolist()), counts, strict=True):
            self.outcomes[tile] = self.outcomes.get(tile, 0) + count

    def sections(self) -> Mapping[str, Any]:
        """The tiling with the counts."""
        return {"tiling": msgspec.structs.replace(self._tiling, tile=self.rows())}

    def rows(self) -> tuple[TileRow, ...]:
        """The counts for the result, by column and row."""
        return tuple(
            TileRow(
                *tile,
                *(
                    int(count[outcome])
                    for outcome in (
                        Outcome.STATIC_KEPT,
                        Outcome.FALSE_POSITIVE,
                        Outcome.DYNAMIC_REMOVED,
                        Outcome.FALSE_NEGATIVE,
                        Outcome.UNLABELLED_KEPT,
                        Outcome.UNLABELLED_REMOVED,
                    )
                ),
            )
            for tile, count in sorted(self.outcomes.items())
        )
