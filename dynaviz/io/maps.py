"""Write maps piece by piece, with attributes: PCD, PLY, LAS, LAZ, NPZ, and Autoware's divided maps.

A writer is a context manager; its file appears only when the ``with`` block succeeds. Every writer stores attributes
bit by bit. Coordinates are float64 in maps far from zero and in those of float64 sources, otherwise float32; LAS stores
multiples of 0.1 mm, or of the scale of the file that was cleaned.
"""

from __future__ import annotations

import contextlib
import re
import tempfile
import warnings
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F64
from dynaviz.errors import UsageError
from dynaviz.io.atomic import atomic_file
from dynaviz.io.las import import_laspy
from dynaviz.io.las_map import LAS, LasHead, LasMap
from dynaviz.io.pcd import PcdWriter

Dtypes = Mapping[str, np.dtype[Any]]

_PLY_TYPES = {"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint", "f4": "float",
              "f8": "double"}  # fmt: skip


class MapWriter(Protocol):
    """Writes a map of unknown length."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *error: Any) -> None: ...

    def append(self, xyz: F64, fields: Mapping[str, NDArray[Any]]) -> None:
        """Append points.

        Args:
            xyz: (N, 3) float64, metres; finite.
            fields: (N,) of the dtypes given to ``open_map``, by name, with all names.
        """
        ...


def open_map(path: Path, fields: Dtypes, origin: F64, head: LasHead | None = None, double: bool = False) -> MapWriter:
    """A writer for a map; the suffix selects the format.

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
    return LasMap(path, fields, origin, head) if writer is LasMap else writer(path, row_dtype(fields, origin, double))


def check_map_path(path: Path) -> None:
    """Raise UsageError if the suffix of a path is not that of a map, MissingDependency if its package is missing."""
    if _writer(path) is LasMap:
        import_laspy(path)


def _writer(path: Path) -> Callable[..., MapWriter]:
    writer = _WRITERS.get(path.suffix.lower())
    if writer is None:
        raise UsageError(f"{path}: unknown map format. Give a file that ends in {', '.join(sorted(_WRITERS))}")
    return writer


def row_dtype(fields: Dtypes, origin: F64, double: bool = False) -> np.dtype[Any]:
    """A point of a map, of the arguments of ``open_map``: x, y, z and the attributes, little-endian, no padding."""
    axis = np.dtype("<f8" if double or np.any(origin) else "<f4")
    columns = {name: np.dtype(np.uint8) if dtype.kind == "b" else dtype for name, dtype in fields.items()}
    return np.dtype([(name, axis) for name in "xyz"] + [(name, d.newbyteorder("<")) for name, d in columns.items()])


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


class PcdMap:
    """Writes a binary PCD file."""

    def __init__(self, path: Path, row: np.dtype[Any]) -> None:
        self._row = row
        self._names = header_names(self._row)
        self._writer = PcdWriter(path, {self._names[n]: self._row[n] for n in self._names}, np.eye(4))

    def __enter__(self) -> Self:
        self._writer.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._writer.__exit__(*error)

    def append(self, xyz: F64, fields: Mapping[str, NDArray[Any]]) -> None:
        """As ``MapWriter``."""
        rows = rows_of(xyz, fields, self._row)
        self._writer.append(**{self._names[name]: rows[name] for name in self._names})


class PlyMap:
    """Writes a binary PLY file. PLY has no 64-bit integers: such attributes are left out with a warning."""

    def __init__(self, path: Path, row: np.dtype[Any]) -> None:
        stored = [name for name in row.names or () if row[name].str[1:] in _PLY_TYPES]
        if missing := [name for name in row.names or () if name not in stored]:
            problem = f"PLY cannot store {row[missing[0]]}; the map has no {', '.join(missing)}"
            warnings.warn(f"{path}: {problem}. Write PCD, LAZ or NPZ to keep them", stacklevel=2)
        self._row = np.dtype([(name, row[name]) for name in stored])
        self._path, self._points, self._stack = path, 0, contextlib.ExitStack()

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as stack:
            self._file: IO[bytes] = stack.enter_context(open(stack.enter_context(atomic_file(self._path)), "wb"))
            self._write_header()
            stack.callback(self._write_header)  # again at the end, with the number of points
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        self._stack.__exit__(*error)

    def append(self, xyz: F64, fields: Mapping[str, NDArray[Any]]) -> None:
        """As ``MapWriter``."""
        self._file.write(rows_of(xyz, fields, self._row).data)
        self._points += len(xyz)

    def _write_header(self) -> None:
        names = header_names(self._row)
        properties = [f"property {_PLY_TYPES[self._row[name].str[1:]]} {text}" for name, text in names.items()]
        lines = ["ply", "format binary_little_endian 1.0", f"element vertex {self._points:018d}", *properties]
        self._file.seek(0)
        self._file.write("\n".join([*lines, "end_header", ""]).encode())


class NpzMap:
    """Writes an NPZ file: ``points`` (N, 3), and an array of N values for each attribute."""

    def __init__(self, path: Path, row: np.dtype[Any]) -> None:
        self._path, self._row, self._points = path, row, 0
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as stack:
            self._part = stack.enter_context(atomic_file(self._path))
            self._spool: IO[bytes] = stack.enter_context(tempfile.TemporaryFile(dir=self._part.parent))
            self._stack = stack.pop_all()
        return self

    def __exit__(self, kind: Any, *error: Any) -> None:
        try:
            if kind is None:
                self._pack()
        finally:
            self._stack.__exit__(kind, *error)

    def append(self, xyz: F64, fields: Mapping[str, NDArray[Any]]) -> None:
        """As ``MapWriter``."""
        self._spool.write(rows_of(xyz, fields, self._row).data)
        self._points += len(xyz)

    def _pack(self) -> None:
        """Write column by column what was spooled row by row."""
        columns: dict[str, tuple[list[str], tuple[int, ...]]] = {"points": (["x", "y", "z"], (self._points, 3))}
        columns |= {name: ([name], (self._points,)) for name in (self._row.names or ())[3:]}
        with zipfile.ZipFile(self._part, "w") as archive:
            for name, (sources, shape) in columns.items():
                dtype = self._row[sources[0]]
                with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                    head = {"descr": dtype.str, "fortran_order": False, "shape": shape}
                    np.lib.format.write_array_header_1_0(file, head)
                    self._spool.seek(0)
                    while raw := self._spool.read(self._row.itemsize << 16):
                        rows = np.frombuffer(raw, self._row)
                        column = (
                            np.column_stack([rows[source] for source in sources]) if len(sources) > 1 else rows[name]
                        )
                        file.write(np.ascontiguousarray(column).tobytes())


class TiledMap:
    """Writes a folder with a PCD file per square tile, and ``pointcloud_map_metadata.yaml``, as Autoware reads it.

    Args:
        folder: the folder; tiles of an earlier map in it are removed.
        fields, origin, double: as for ``open_map``.
        size: edge of a tile, metres.
    """

    METADATA = "pointcloud_map_metadata.yaml"
    TILES = "pointcloud_map.pcd"  # a folder in divided maps, a file otherwise

    def __init__(self, folder: Path, fields: Dtypes, origin: F64, size: float = 20.0, double: bool = False) -> None:
        self._folder, self._row, self._size = folder, row_dtype(fields, origin, double), size
        self._spools: dict[tuple[int, int], Path] = {}
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> Self:
        self._folder.mkdir(parents=True, exist_ok=True)
        self._spool = Path(self._stack.enter_context(tempfile.TemporaryDirectory(dir=self._folder, prefix=".tiles")))
        return self

    def __exit__(self, kind: Any, *error: Any) -> None:
        try:
            if kind is None:
                self._finish()
        finally:
            self._stack.__exit__(kind, *error)

    def append(self, xyz: F64, fields: Mapping[str, NDArray[Any]]) -> None:
        """As ``MapWriter``."""
        rows = rows_of(xyz, fields, self._row)
        tiles, of = np.unique(np.floor(xyz[:, :2] / self._size).astype(np.int64), axis=0, return_inverse=True)
        order = np.argsort(of.reshape(-1), kind="stable")
        ends = np.searchsorted(of.reshape(-1)[order], np.arange(1, len(tiles) + 1))
        for (x, y), chosen in zip(tiles.tolist(), np.split(order, ends)[:-1], strict=True):
            path = self._spools.setdefault((x, y), self._spool / f"{x}_{y}")
            with open(path, "ab") as file:  # thousands of tiles cannot all be kept open
                file.write(rows[chosen].tobytes())

    def _finish(self) -> None:
        tiles = self._folder / self.TILES
        tiles.mkdir(exist_ok=True)
        for old in (self._folder / self.METADATA, *tiles.glob("tile_*.pcd")):
            old.unlink(missing_ok=True)
        lines = [f"x_resolution: {self._size}", f"y_resolution: {self._size}"]
        for (x, y), spool in sorted(self._spools.items()):
            name = f"tile_{x}_{y}.pcd"
            rows = np.fromfile(spool, self._row)
            with PcdWriter(tiles / name, {n: self._row[n] for n in self._row.names or ()}, np.eye(4)) as writer:
                writer.append(**{n: rows[n] for n in self._row.names or ()})
            lines.append(f"{name}: [{x * self._size}, {y * self._size}]")
        with atomic_file(self._folder / self.METADATA) as temporary:
            temporary.write_text("\n".join([*lines, ""]), encoding="utf-8")


_WRITERS: dict[str, Callable[..., MapWriter]] = {
    ".pcd": PcdMap,
    ".ply": PlyMap,
    **dict.fromkeys(LAS, LasMap),
    ".npz": NpzMap,
}
