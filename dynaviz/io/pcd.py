"""Point Cloud Data files (PCD 0.5 to 0.7).

Reads ascii, binary and binary_compressed, and writes binary.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from dynaviz import kernels
from dynaviz.arrays import F32, F64, U8, single
from dynaviz.errors import DataError
from dynaviz.io.atomic import atomic_file, open_file
from dynaviz.io.pcd_header import (
    ENCODINGS,
    Field,
    PcdHeader,
    fields_from_dtypes,
    header_text,
    parse_header,
    read_header,
)
from dynaviz.io.text import read_rows
from dynaviz.spatial import geometry

__all__ = [
    "ENCODINGS",
    "Field",
    "Pcd",
    "PcdHeader",
    "PcdWriter",
    "read_header",
    "read_pcd",
    "write_pcd",
]

_MAX_RATIO = 88  # three bytes of LZF expand to at most 264
_RETRY_HINT = "Write or copy the file again"


@dataclass(frozen=True, eq=False)
class Pcd:
    """The points of a file, or a slice of them.

    Attributes:
        path: the file.
        header: header of the whole file.
        rows: (N,) of dtype ``header.row``.
    """

    path: Path
    header: PcdHeader
    rows: NDArray[Any]

    def __len__(self) -> int:
        return len(self.rows)

    def __contains__(self, name: object) -> bool:
        return name in (self.rows.dtype.names or ())

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A field, (N,) or (N, count), in the type of the file.

        Raises:
            DataError: if the file does not have the field.
        """
        if name not in self:
            fields = " ".join(self.rows.dtype.names or ())
            raise DataError(
                self.path,
                f"field '{name}' is missing (found: {fields})",
                hint="Write the cloud with it",
            )
        return self.rows[name]

    @cached_property
    def xyz(self) -> F32:
        """(N, 3) float32, C-contiguous, in the file's frame.

        Raises:
            DataError: if x, y or z is missing or has more than one value per point.
        """
        out = np.empty((len(self), 3), np.float32)
        for axis, name in enumerate("xyz"):
            column = self[name]
            if column.ndim != 1:
                raise DataError(
                    self.path,
                    f"field {name} has more than one value per point",
                    hint="Write it with COUNT 1",
                )
            out[:, axis] = single(column)
        return out

    @property
    def T_world_sensor(self) -> F64 | None:
        """(4, 4) float64, metres: the VIEWPOINT as a pose; None if the file has none.

        Raises:
            DataError: if VIEWPOINT is not a valid pose.
        """
        view = self.header.viewpoint
        if view is None:
            return None
        try:
            return geometry.pose(view[:3], view[3:])
        except ValueError:
            hint = "Give the sensor pose as tx ty tz qw qx qy qz, with a quaternion of length 1"
            problem = f"not a valid pose: {view.tolist()}"
            raise DataError(self.path, problem, at="VIEWPOINT", hint=hint) from None


def read_pcd(path: str | os.PathLike[str], rows: tuple[int, int] | None = None) -> Pcd:
    """Read points.

    Args:
        path: the file.
        rows: half-open range of points to read; a ``binary`` file is not read beyond it. Default:
            all points.

    Raises:
        DataError: if the file cannot be read, is corrupt or too short; names the line or byte.
    """
    path = Path(path)
    with open_file(path, "Give a PCD file") as file:
        header = parse_header(path, file)
        first, last, _ = slice(*(rows or (None,))).indices(header.points)
        left = os.fstat(file.fileno()).st_size - header.offset
        if header.data == "binary":
            return Pcd(path, header, _read_binary(file, path, header, left, first, last))
        read = _read_ascii if header.data == "ascii" else _read_compressed
        return Pcd(path, header, read(file, path, header, left)[first:last])


def write_pcd(
    path: str | os.PathLike[str],
    fields: Mapping[str, ArrayLike],
    T_world_sensor: ArrayLike | None = None,
) -> None:
    """Write points atomically, as ``binary``.

    Args:
        path: the file.
        fields: (N,) or (N, count) integers or floats by name; bool is written as uint8.
        T_world_sensor: (4, 4) float64, metres, written as VIEWPOINT; None writes no VIEWPOINT.

    Raises:
        DataError: if the file cannot be written.
        ValueError: for fields that PCD cannot store.
    """
    arrays = {name: np.asarray(array) for name, array in fields.items()}
    layout = {name: np.dtype((array.dtype, array.shape[1:])) for name, array in arrays.items()}
    with PcdWriter(path, layout, T_world_sensor) as writer:
        writer.append(**arrays)


class PcdWriter:
    """Writes a binary PCD file of unknown length piece by piece.

    It appears only when the ``with`` block succeeds.

    Args:
        path: the file.
        fields: dtype by name; ``(dtype, (count,))`` for several values.
        T_world_sensor: as in ``write_pcd``.

    Raises:
        DataError: if the file cannot be written.
        ValueError: for fields that PCD cannot store.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        fields: Mapping[str, DTypeLike],
        T_world_sensor: ArrayLike | None = None,
    ) -> None:
        self.path = Path(path)
        self.points = 0
        self._fields = fields_from_dtypes({name: np.dtype(dtype) for name, dtype in fields.items()})
        self._T_world_sensor = T_world_sensor
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> PcdWriter:
        with contextlib.ExitStack() as stack:
            temporary = stack.enter_context(atomic_file(self.path))
            self._file = stack.enter_context(open(temporary, "wb"))
            self._write_header()
            stack.callback(self._write_header)  # rewritten at the end with the number of points
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        self._stack.__exit__(*error)

    def append(self, **fields: ArrayLike) -> None:
        """Append points, given all fields by name, (N,) or (N, count)."""
        rows = _pack(self._fields, {name: np.asarray(array) for name, array in fields.items()})
        self._file.write(rows.data)
        self.points += len(rows)

    def _write_header(self) -> None:
        self._file.seek(0)
        self._file.write(header_text(self._fields, self.points, self._T_world_sensor))


def _read_binary(
    file: IO[bytes], path: Path, header: PcdHeader, left: int, first: int, last: int
) -> NDArray[Any]:
    _check_length(path, header, left, header.points * header.row.itemsize)
    file.seek(header.offset + first * header.row.itemsize)
    return np.fromfile(file, header.row, max(last - first, 0))


def _read_compressed(file: IO[bytes], path: Path, header: PcdHeader, left: int) -> NDArray[Any]:
    if not header.points:
        return np.empty(0, header.row)
    _check_length(path, header, left, 8)
    packed, size = (int(n) for n in np.fromfile(file, "<u4", 2))
    _check_length(path, header, left, 8 + packed)
    if size != header.points * header.row.itemsize or size > packed * _MAX_RATIO:
        expected = header.points * header.row.itemsize
        problem = (
            f"inconsistent size of compressed points: {packed} bytes to {size}, expected {expected}"
        )
        raise DataError(path, problem, at=f"byte {header.offset}", hint=_RETRY_HINT)
    columns = np.empty(size, np.uint8)
    source = kernels.as_readonly(np.fromfile(file, np.uint8, packed), np.uint8)
    bad = kernels.lzf.decompress(source, columns)
    if bad >= 0:
        at = f"byte {header.offset + 8 + bad}"
        raise DataError(path, "corrupt compressed points", at=at, hint=_RETRY_HINT)
    rows = np.empty((header.points, header.row.itemsize), np.uint8)
    start = 0
    for column in _byte_columns(header.fields, rows):
        column[:] = columns[start : start + column.size].reshape(column.shape)
        start += column.size
    return rows.view(header.row)[:, 0]


def _read_ascii(file: IO[bytes], path: Path, header: PcdHeader, left: int) -> NDArray[Any]:
    if not header.points:
        return np.empty(0, header.row)
    # "0 0 0"
    _check_length(
        path, header, left, 2 * header.points * sum(field.count for field in header.fields) - 1
    )
    single_values = [
        (f"{k}.{i}", field.dtype)
        for k, field in enumerate(header.fields)
        for i in range(field.count)
    ]
    rows = read_rows(path, file, np.dtype(single_values), header.lines)
    if rows.size < header.points:
        problem = f"contains {rows.size} points, but the header states {header.points}"
        raise DataError(path, problem, at="end of file", hint=_RETRY_HINT)
    return rows[: header.points].view(header.row)


def _check_length(path: Path, header: PcdHeader, left: int, needed: int) -> None:
    if left < needed:
        problem = (
            f"file is too short: {header.points} points need {needed} bytes from here, {left} are "
            "left"
        )
        raise DataError(path, problem, at=f"byte {header.offset}", hint=_RETRY_HINT)


def _byte_columns(fields: tuple[Field, ...], rows: U8) -> Iterator[U8]:
    """The bytes of each field, (N, bytes of the field), in rows of (N, bytes of a point)."""
    offset = 0
    for field in fields:
        size = field.dtype.itemsize * field.count
        yield rows[:, offset : offset + size]
        offset += size


def _pack(fields: tuple[Field, ...], arrays: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
    """The points as rows, in the layout of ``binary`` files."""
    if set(arrays) != {field.name for field in fields}:
        raise ValueError(
            f"expected the fields {', '.join(field.name for field in fields)}, not "
            f"{', '.join(arrays)}"
        )
    n = len(arrays[fields[0].name])
    rows = np.empty(n, [(field.name, field.dtype, (field.count,)) for field in fields])
    for field in fields:
        array = arrays[field.name]
        if array.shape != (n, field.count) and (array.shape, field.count) != ((n,), 1):
            raise ValueError(
                f"field '{field.name}' has shape {array.shape}, not ({n},) or ({n}, {field.count})"
            )
        np.copyto(rows[field.name], array.reshape(n, field.count), casting="same_kind")
    return rows
