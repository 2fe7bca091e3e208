"""Maps divided into files, one per square tile, with an index."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from dynaviz.arrays import F64
from dynaviz.io.atomic import write_atomic
from dynaviz.io.las_map import LasHead
from dynaviz.io.maps import Dtypes, TiledMap, open_map

INDEX = "tiles.json"
_ROWS = 1_000_000  # points that pass through memory at once


class MapTiles(TiledMap):
    """Writes a folder with a file per tile, ``tile_X_Y.laz``, and ``tiles.json``.

    The index contains the edge of a tile, and for each tile its file, column and row (the tile spans
    ``[column, column + 1) * size`` in x), number of points and bounds in metres.

    Args:
        folder: the folder; tiles of an earlier map in it are removed.
        fields, origin, head, double: as for ``dynaviz.io.maps.open_map``.
        size: edge of a tile, metres.
        suffix: of the files, which selects their format.
    """

    def __init__(
        self,
        folder: Path,
        fields: Dtypes,
        origin: F64,
        size: float,
        suffix: str,
        head: LasHead | None = None,
        double: bool = False,
    ) -> None:
        super().__init__(folder, fields, origin, size, double)
        self._fields, self._suffix, self._where = fields, suffix, (origin, head, double)

    def _finish(self) -> None:
        for old in (self._folder / INDEX, *self._folder.glob(f"tile_*{self._suffix}")):
            old.unlink(missing_ok=True)
        tiles = [self._tile(x, y, spool) for (x, y), spool in sorted(self._spools.items())]
        index = {"size_m": self._size, "attributes": list(self._fields), "tiles": tiles}
        write_atomic(self._folder / INDEX, json.dumps(index, indent=1).encode())

    def _tile(self, column: int, row: int, spool: Path) -> dict[str, Any]:
        """Write the file of a tile; its entry in the index."""
        name, points = f"tile_{column}_{row}{self._suffix}", 0
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        with open_map(self._folder / name, self._fields, *self._where) as writer, spool.open("rb") as file:
            while len(rows := np.fromfile(file, self._row, _ROWS)):
                xyz = np.column_stack([rows[axis] for axis in "xyz"]).astype(np.float64)
                writer.append(xyz, {field: rows[field] for field in self._fields})
                low, high, points = np.minimum(low, xyz.min(0)), np.maximum(high, xyz.max(0)), points + len(rows)
        bounds = {"low": low.round(4).tolist(), "high": high.round(4).tolist()}
        return {"file": name, "column": column, "row": row, "points": points, **bounds}
