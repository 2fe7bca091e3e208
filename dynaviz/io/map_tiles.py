"""Maps divided into files, one per square tile, with an index."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from dynaviz.arrays import F64
from dynaviz.io.atomic import write_atomic
from dynaviz.io.las_map import LasHead
from dynaviz.io.maps import Append, Dtypes, open_map, row_dtype, spooled_tiles

INDEX = "tiles.json"
_ROWS = 1_000_000  # points that pass through memory at once


@contextlib.contextmanager
def map_tiles(
    folder: Path,
    fields: Dtypes,
    origin: F64,
    size: float,
    suffix: str,
    head: LasHead | None = None,
    double: bool = False,
) -> Iterator[Append]:
    """Write a folder with a file per tile, ``tile_X_Y.laz``, and ``tiles.json``.

    The index contains the edge of a tile, and for each tile its file, column and row (the tile spans
    ``[column, column + 1) * size`` in x), number of points and bounds in metres.

    Args:
        folder: the folder; tiles of an earlier map in it are removed.
        fields, origin, head, double: as for ``dynaviz.io.maps.open_map``.
        size: edge of a tile, metres.
        suffix: of the files, which selects their format.
    """
    row = row_dtype(fields, origin, double)

    def write_tile(column: int, line: int, spool: Path) -> dict[str, Any]:
        """Write the file of a tile; its entry in the index."""
        name, points = f"tile_{column}_{line}{suffix}", 0
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        with open_map(folder / name, fields, origin, head, double) as append_to_tile, spool.open("rb") as file:
            while len(rows := np.fromfile(file, row, _ROWS)):
                xyz = np.column_stack([rows[axis] for axis in "xyz"]).astype(np.float64)
                append_to_tile(xyz, {field: rows[field] for field in fields})
                low, high, points = np.minimum(low, xyz.min(0)), np.maximum(high, xyz.max(0)), points + len(rows)
        bounds = {"low": low.round(4).tolist(), "high": high.round(4).tolist()}
        return {"file": name, "column": column, "row": line, "points": points, **bounds}

    with spooled_tiles(folder, row, size) as (append, spools):
        yield append
        for old in (folder / INDEX, *folder.glob(f"tile_*{suffix}")):
            old.unlink(missing_ok=True)
        tiles = [write_tile(column, line, spool) for (column, line), spool in sorted(spools.items())]
        index = {"size_m": size, "attributes": list(fields), "tiles": tiles}
        write_atomic(folder / INDEX, json.dumps(index, indent=1).encode())
