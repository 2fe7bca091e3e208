"""Write maps piece by piece, with attributes: PCD, PLY, LAS, LAZ, NPZ, and Autoware's divided maps.

A file appears only when the ``with`` block that writes it succeeds. Every format stores attributes
bit by bit. Coordinates are float64 in maps far from zero and in those of float64 sources, otherwise
float32; LAS stores multiples of 0.1 mm, or of the scale of the file that was cleaned.
"""

from __future__ import annotations

import contextlib
import json
import re
import tempfile
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F64
from dynaviz.errors import UsageError
from dynaviz.io.atomic import atomic_file, write_atomic
from dynaviz.io.las import import_laspy
from dynaviz.io.las_map import LAS, LasHead, las_map
from dynaviz.io.pcd import PcdWriter

Dtypes = Mapping[str, np.dtype[Any]]

_PLY_TYPES = {
    "i1": "char",
    "u1": "uchar",
    "i2": "short",
    "u2": "ushort",
    "i4": "int",
    "u4": "uint",
    "f4": "float",
    "f8": "double",
}


Append = Callable[[F64, Mapping[str, NDArray[Any]]], None]
"""Appends points to a map: (N, 3) float64, metres, finite; and (N,) of each attribute by name, with
all names."""

Writing = contextlib.AbstractContextManager[Append]


def open_map(
    path: Path, fields: Dtypes, origin: F64, head: LasHead | None = None, double: bool = False
) -> Writing:
    """Write a map; the suffix selects the format.

    Args:
        path: the file.
        fields: dtypes of the attributes by name: integers or floats.
        origin: (3,) float64, metres: where the map is. Coordinates are float64 unless it is zero.
        head: for the header of LAS and LAZ files.
        double: write float64 also if the origin is zero.

    Raises:
        UsageError: for an unknown suffix.
        MissingDependency: for LAS and LAZ if laspy is not installed.
    """
    writer = _writer(path)
    return (
        las_map(path, fields, origin, head)
        if writer is las_map
        else writer(path, row_dtype(fields, origin, double))
    )


def check_map_path(path: Path) -> None:
    """Raise UsageError if the suffix of a path is not that of a map, MissingDependency if its
    package is missing.
    """
    if _writer(path) is las_map:
        import_laspy(path)


def _writer(path: Path) -> Callable[..., Writing]:
    writer = _WRITERS.get(path.suffix.lower())
    if writer is None:
        raise UsageError(
            f"{path}: unknown map format. Give a file that ends in {', '.join(sorted(_WRITERS))}"
        )
    return writer


def row_dtype(fields: Dtypes, origin: F64, double: bool = False) -> np.dtype[Any]:
    """A point of a map, of the arguments of ``open_map``.

    X, y, z and the attributes, little-endian, no padding.
    """
    axis = np.dtype("<f8" if double or np.any(origin) else "<f4")
    columns = {
        name: np.dtype(np.uint8) if dtype.kind == "b" else dtype for name, dtype in fields.items()
    }
    return np.dtype(
        [(name, axis) for name in "xyz"]
        + [(name, d.newbyteorder("<")) for name, d in columns.items()]
    )


def rows_of(xyz: F64, fields: Mapping[str, NDArray[Any]], row: np.dtype[Any]) -> NDArray[Any]:
    """(N,) of ``row_dtype``."""
    rows = np.empty(len(xyz), row)
    for axis, name in enumerate("xyz"):
        rows[name] = xyz[:, axis]
    for name in (row.names or ())[3:]:
        rows[name] = fields[name]
    return rows


def header_names(row: np.dtype[Any]) -> dict[str, str]:
    """A name for each field that a text header can contain: other characters become underscores."""
    names: dict[str, str] = {}
    for name in row.names or ():
        plain = re.sub(r"[^!-~]+", "_", name).strip("_") or "field"
        names[name] = plain if plain not in names.values() else f"{plain}_{len(names)}"
    return names


@contextlib.contextmanager
def _pcd_map(path: Path, row: np.dtype[Any]) -> Iterator[Append]:
    names = header_names(row)
    with PcdWriter(path, {names[name]: row[name] for name in names}, np.eye(4)) as writer:

        def append(xyz: F64, fields: Mapping[str, NDArray[Any]]) -> None:
            rows = rows_of(xyz, fields, row)
            writer.append(**{names[name]: rows[name] for name in names})

        yield append


@contextlib.contextmanager
def _ply_map(path: Path, row: np.dtype[Any]) -> Iterator[Append]:
    """PLY has no 64-bit integers: such attributes are left out with a warning."""
    stored = np.dtype(
        [(name, row[name]) for name in row.names or () if row[name].str[1:] in _PLY_TYPES]
    )
    if missing := [name for name in row.names or () if name not in (stored.names or ())]:
        problem = f"PLY cannot store {row[missing[0]]}; the map has no {', '.join(missing)}"
        warnings.warn(f"{path}: {problem}. Write PCD, LAZ or NPZ to keep them", stacklevel=2)
    names = header_names(stored)
    points = 0
    properties = [
        f"property {_PLY_TYPES[stored[name].str[1:]]} {text}" for name, text in names.items()
    ]
    with atomic_file(path) as temporary, open(temporary, "wb") as file:

        def append(xyz: F64, fields: Mapping[str, NDArray[Any]]) -> None:
            nonlocal points
            file.write(rows_of(xyz, fields, stored).data)
            points += len(xyz)

        def write_header() -> None:
            lines = [
                "ply",
                "format binary_little_endian 1.0",
                f"element vertex {points:018d}",
                *properties,
            ]
            file.seek(0)
            file.write("\n".join([*lines, "end_header", ""]).encode())

        write_header()
        yield append
        write_header()  # again, with the number of points


@contextlib.contextmanager
def _npz_map(path: Path, row: np.dtype[Any]) -> Iterator[Append]:
    """``points`` (N, 3), and an array of N values for each attribute.

    Spooled row by row, written column by column.
    """
    points = 0
    with atomic_file(path) as part, tempfile.TemporaryFile(dir=part.parent) as spool:

        def append(xyz: F64, fields: Mapping[str, NDArray[Any]]) -> None:
            nonlocal points
            spool.write(rows_of(xyz, fields, row).data)
            points += len(xyz)

        yield append
        columns: dict[str, tuple[list[str], tuple[int, ...]]] = {
            "points": (["x", "y", "z"], (points, 3))
        }
        columns |= {name: ([name], (points,)) for name in (row.names or ())[3:]}
        with zipfile.ZipFile(part, "w") as archive:
            for name, (sources, shape) in columns.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                    head = {"descr": row[sources[0]].str, "fortran_order": False, "shape": shape}
                    np.lib.format.write_array_header_1_0(file, head)
                    spool.seek(0)
                    while raw := spool.read(row.itemsize << 16):
                        rows = np.frombuffer(raw, row)
                        file.write(np.column_stack([rows[source] for source in sources]).tobytes())


@contextlib.contextmanager
def spooled_tiles(
    folder: Path, row: np.dtype[Any], size: float
) -> Iterator[tuple[Append, dict[tuple[int, int], Path]]]:
    """Sort points into temporary files, one per square tile.

    Yields:
        Appends points; and the files of rows of dtype ``row`` by column and row of the tile.
    """
    folder.mkdir(parents=True, exist_ok=True)
    spools: dict[tuple[int, int], Path] = {}
    with tempfile.TemporaryDirectory(dir=folder, prefix=".tiles") as temporary:

        def append(xyz: F64, fields: Mapping[str, NDArray[Any]]) -> None:
            rows = rows_of(xyz, fields, row)
            tiles, of = np.unique(
                np.floor(xyz[:, :2] / size).astype(np.int64), axis=0, return_inverse=True
            )
            order = np.argsort(of.reshape(-1), kind="stable")
            ends = np.searchsorted(of.reshape(-1)[order], np.arange(1, len(tiles) + 1))
            for (x, y), chosen in zip(tiles.tolist(), np.split(order, ends)[:-1], strict=True):
                path = spools.setdefault((x, y), Path(temporary) / f"{x}_{y}")
                with open(path, "ab") as file:  # thousands of tiles cannot all be kept open
                    file.write(rows[chosen].tobytes())

        yield append, spools


DIVIDED_METADATA = "pointcloud_map_metadata.yaml"
DIVIDED_TILES = "pointcloud_map.pcd"
"""The metadata and the folder of tiles of Autoware's divided maps."""
PROJECTOR = "map_projector_info.yaml"
"""What the coordinates of Autoware's maps mean."""


@contextlib.contextmanager
def divided_map(folder: Path, fields: Dtypes, origin: F64, size: float = 20.0) -> Iterator[Append]:
    """Write a folder with a PCD file per square tile, ``pointcloud_map_metadata.yaml``, and
    ``map_projector_info.yaml``, as Autoware reads it.

    Coordinates are float32, because PCL reads nothing else, and local: the origin is subtracted,
    and stated in the file of the projector.

    Args:
        folder: the folder; tiles of an earlier map in it are removed.
        fields, origin: as for ``open_map``.
        size: edge of a tile, metres.
    """
    row = row_dtype(fields, np.zeros(3))
    tiles = folder / DIVIDED_TILES
    with spooled_tiles(folder, row, size) as (append, spools):
        yield lambda xyz, attributes: append(xyz - origin, attributes)
        tiles.mkdir(exist_ok=True)
        for old in (folder / DIVIDED_METADATA, folder / PROJECTOR, *tiles.glob("tile_*.pcd")):
            old.unlink(missing_ok=True)
        lines = [f"x_resolution: {size}", f"y_resolution: {size}"]
        for (x, y), spool in sorted(spools.items()):
            name = f"tile_{x}_{y}.pcd"
            rows = np.fromfile(spool, row)
            with PcdWriter(tiles / name, {n: row[n] for n in row.names or ()}, np.eye(4)) as writer:
                writer.append(**{n: rows[n] for n in row.names or ()})
            lines.append(f"{name}: [{x * size}, {y * size}]")
        write_atomic(folder / DIVIDED_METADATA, "\n".join([*lines, ""]).encode())
        write_atomic(folder / PROJECTOR, _projector(origin).encode())


def _projector(origin: F64) -> str:
    """The file of a map in local coordinates, with what was subtracted from those of the source."""
    offset = ", ".join(f"{value:.3f}" for value in origin)
    lines = ["projector_type: Local"]
    if origin.any():
        lines = [f"# coordinates of the source = coordinates of this map + [{offset}]", *lines]
    return "\n".join([*lines, ""])


_WRITERS: dict[str, Callable[..., Writing]] = {
    ".pcd": _pcd_map,
    ".ply": _ply_map,
    **dict.fromkeys(LAS, las_map),
    ".npz": _npz_map,
}


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

    The index contains the edge of a tile, and for each tile its file, column and row (the tile
    spans ``[column, column + 1) * size`` in x), number of points and bounds in metres.

    Args:
        folder: the folder; tiles of an earlier map in it are removed.
        fields, origin, head, double: as for ``dynaviz.io.maps.open_map``.
        size: edge of a tile, metres.
        suffix: of the files, which selects their format.
    """
    row = row_dtype(fields, origin, double)

    def write_tile(column: int, line: int, spool: Path) -> dict[str, Any]:
        """Write the file of a tile; its entry in the index."""
        name = f"tile_{column}_{line}{suffix}"
        points = 0
        low = np.full(3, np.inf)
        high = np.full(3, -np.inf)
        with (
            open_map(folder / name, fields, origin, head, double) as append_to_tile,
            spool.open("rb") as file,
        ):
            while len(rows := np.fromfile(file, row, _ROWS)):
                xyz = np.column_stack([rows[axis] for axis in "xyz"]).astype(np.float64)
                append_to_tile(xyz, {field: rows[field] for field in fields})
                low = np.minimum(low, xyz.min(0))
                high = np.maximum(high, xyz.max(0))
                points = points + len(rows)
        bounds = {"low": low.round(4).tolist(), "high": high.round(4).tolist()}
        return {"file": name, "column": column, "row": line, "points": points, **bounds}

    with spooled_tiles(folder, row, size) as (append, spools):
        yield append
        for old in (folder / INDEX, *folder.glob(f"tile_*{suffix}")):
            old.unlink(missing_ok=True)
        tiles = [
            write_tile(column, line, spool) for (column, line), spool in sorted(spools.items())
        ]
        index = {"size_m": size, "attributes": list(fields), "tiles": tiles}
        write_atomic(folder / INDEX, json.dumps(index, indent=1).encode())
