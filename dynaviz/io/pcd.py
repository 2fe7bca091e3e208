"""Point Cloud Data files (PCD 0.5 to 0.7): ascii, binary and binary_compressed."""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from dynaviz import geometry, kernels
from dynaviz.errors import DataError
from dynaviz.io.atomic import whole_file
from dynaviz.scan import F32, F64

ENCODINGS = ("ascii", "binary", "binary_compressed")
_KINDS = {"F": "f", "I": "i", "U": "u"}
_SIZES = {"f": (4, 8), "i": (1, 2, 4, 8), "u": (1, 2, 4, 8)}
_LARGEST_RATIO = 88  # three bytes of LZF unpack to at most 264
_WORDS = ("VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA")
_LONGEST_LINE, _LARGEST_POINT = 1 << 16, 1 << 20  # bytes; beyond them a header is taken for damaged


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a point: ``count`` little-endian values of ``dtype``."""

    name: str
    dtype: np.dtype[Any]
    count: int = 1


@dataclass(frozen=True, eq=False)
class PcdHeader:
    """What stands before the points.

    Attributes:
        fields: in the order of the file; ``_`` is padding.
        points: their number, equal to width * height.
        width, height: of an organised cloud; height is 1 otherwise.
        viewpoint: (7,) float64: tx ty tz in metres, qw qx qy qz; None where the file has none.
        data: ``ascii``, ``binary`` or ``binary_compressed``.
        offset: byte at which the points begin.
        lines: number of lines before the points.
    """

    fields: tuple[Field, ...]
    points: int
    width: int
    height: int
    viewpoint: F64 | None
    data: str
    offset: int
    lines: int

    @cached_property
    def row(self) -> np.dtype[Any]:
        """A point in the file as a structured dtype; padding has no name, of two equal names the first one counts."""
        named: dict[str, tuple[Any, int]] = {}
        place = 0
        for field in self.fields:
            form = field.dtype if field.count == 1 else (field.dtype, (field.count,))
            if field.name != "_":
                named.setdefault(field.name, (form, place))
            place += field.dtype.itemsize * field.count
        forms, places = [f for f, _ in named.values()], [p for _, p in named.values()]
        return np.dtype({"names": list(named), "formats": forms, "offsets": places, "itemsize": place})


@dataclass(frozen=True, eq=False)
class Pcd:
    """The points of a file, or some rows of them.

    Attributes:
        path: where they came from.
        header: of the whole file.
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
            DataError: where the file has no such field.
        """
        if name not in self:
            has = " ".join(self.rows.dtype.names or ())
            raise DataError(self.path, f"has no field '{name}', only: {has}", hint="Write the cloud with that field")
        return self.rows[name]

    @cached_property
    def xyz(self) -> F32:
        """(N, 3) float32, C-contiguous, in the file's frame.

        Raises:
            DataError: where x, y or z is missing, or is more than one number.
        """
        out = np.empty((len(self), 3), np.float32)
        for axis, name in enumerate("xyz"):
            column = self[name]
            if column.ndim != 1:
                raise DataError(self.path, f"has more than one number in {name}", hint="Write it with COUNT 1")
            with np.errstate(over="ignore"):  # beyond float32 is infinite
                out[:, axis] = column
        return out

    @property
    def T_world_sensor(self) -> F64 | None:
        """(4, 4) float64, metres: the VIEWPOINT as a pose; None where the file has none.

        Raises:
            DataError: for a VIEWPOINT that is no pose.
        """
        view = self.header.viewpoint
        if view is None:
            return None
        if not (np.isfinite(view).all() and np.any(view[3:])):
            hint = "Give the sensor's pose as tx ty tz qw qx qy qz, with a quaternion of length 1"
            raise DataError(self.path, f"has a VIEWPOINT that is no pose: {view.tolist()}", at="VIEWPOINT", hint=hint)
        return geometry.pose(view[:3], view[3:])


def read_header(path: str | os.PathLike[str]) -> PcdHeader:
    """Read what stands before the points.

    Raises:
        DataError: for a file that cannot be read or has no valid header; it names the line.
    """
    with _opened(path) as file:
        return _header(Path(path), file)


def read_pcd(path: str | os.PathLike[str], rows: tuple[int, int] | None = None) -> Pcd:
    """Read points.

    Args:
        path: the file.
        rows: only the points from the first to before the second number; of a ``binary`` file nothing else is read.

    Raises:
        DataError: for a file that cannot be read, is damaged or too short; it names the line or byte.
    """
    path = Path(path)
    with _opened(path) as file:
        header = _header(path, file)
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
    data: str = "binary",
) -> None:
    """Write points, whole or not at all.

    Args:
        path: the file.
        fields: (N,) or (N, count) of integers or floats by name; bool is written as uint8.
        T_world_sensor: (4, 4) float64, metres; written as VIEWPOINT, which is left out without it.
        data: ``ascii``, ``binary`` or ``binary_compressed``.

    Raises:
        DataError: where the file cannot be written.
        ValueError: for fields that a PCD file cannot hold.
    """
    arrays = {name: np.asarray(array) for name, array in fields.items()}
    layout = _layout({name: np.dtype((array.dtype, array.shape[1:])) for name, array in arrays.items()})
    rows = _rows(layout, arrays)
    if data not in ENCODINGS:
        raise ValueError(f"data is one of {', '.join(ENCODINGS)}, not {data}")
    if data == "binary_compressed" and rows.nbytes >= 1 << 32:
        raise ValueError("binary_compressed holds at most 4 GiB: write it as binary")
    encode = {"ascii": _ascii, "binary": lambda fields, rows: rows.data, "binary_compressed": _compressed}[data]
    with whole_file(path) as beside, open(beside, "wb") as file:
        file.write(_header_text(layout, len(rows), T_world_sensor, data))
        file.write(encode(layout, rows))


class PcdWriter:
    """A binary PCD file of unknown length, written piece by piece; it appears when the ``with`` block ends well.

    Args:
        path: the file.
        fields: dtype by name; ``(dtype, (count,))`` for several values.
        T_world_sensor: as in ``write_pcd``.

    Raises:
        DataError: where the file cannot be written.
        ValueError: for fields that a PCD file cannot hold.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        fields: Mapping[str, DTypeLike],
        T_world_sensor: ArrayLike | None = None,
    ) -> None:
        self.path, self.points = Path(path), 0
        self._fields = _layout({name: np.dtype(dtype) for name, dtype in fields.items()})
        self._T_world_sensor = T_world_sensor
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> PcdWriter:
        with contextlib.ExitStack() as stack:
            beside = stack.enter_context(whole_file(self.path))
            self._file = stack.enter_context(open(beside, "wb"))
            self._write_header()
            stack.callback(self._write_header)  # again at the end, with the number of points
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        self._stack.__exit__(*error)

    def append(self, **fields: ArrayLike) -> None:
        """Add points: every field by its name, (N,) or (N, count)."""
        rows = _rows(self._fields, {name: np.asarray(array) for name, array in fields.items()})
        self._file.write(rows.data)
        self.points += len(rows)

    def _write_header(self) -> None:
        self._file.seek(0)
        self._file.write(_header_text(self._fields, self.points, self._T_world_sensor, "binary"))


@contextlib.contextmanager
def _opened(path: str | os.PathLike[str]) -> Iterator[IO[bytes]]:
    try:
        with open(path, "rb") as file:
            yield file
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror})", hint="Give a PCD file") from error


def _header(path: Path, file: IO[bytes]) -> PcdHeader:
    words: dict[str, tuple[list[str], str]] = {}
    lines = 0
    while "DATA" not in words:
        line = file.readline(_LONGEST_LINE)
        lines += 1
        at = f"line {lines}"
        if not line.endswith(b"\n"):
            raise DataError(path, "ends before its points, or is no PCD file", at=at, hint="Write or copy it again")
        word, *values = line.decode("latin-1").split() or ["#"]
        word = {"COLUMNS": "FIELDS"}.get(word.upper(), word.upper())  # the name in 0.5
        if word in _WORDS:
            words[word] = values, at
        elif not word.startswith("#"):
            hint = f"A PCD header has the lines {' '.join(_WORDS)}"
            raise DataError(path, f"has the unknown word {word[:20]!r} in its header", at=at, hint=hint)
    return _checked(path, words, file.tell(), lines)


def _checked(path: Path, words: dict[str, tuple[list[str], str]], offset: int, lines: int) -> PcdHeader:
    """The header of its words, or DataError at the line of the first that is wrong."""

    def wrong(word: str, problem: str) -> DataError:
        return DataError(path, problem, at=words.get(word, ([], "header"))[1], hint="Write or copy the file again")

    def values(word: str, kind: Callable[[str], Any], length: int, default: str) -> list[Any]:
        texts = words[word][0] if word in words else [default] * length
        try:
            found = [kind(text) for text in texts]
        except (ValueError, KeyError):
            found = []
        if len(found) != length:
            shown = " ".join([word, *texts])[:80]
            raise wrong(word, f"has '{shown}' in its header, where {length} sensible values belong")
        return found

    names = words["FIELDS"][0] if "FIELDS" in words else []
    n = len(names)
    kinds = values("TYPE", _KINDS.__getitem__, n, "F")
    sizes, counts = values("SIZE", int, n, "4"), values("COUNT", _count, n, "1")
    for name, kind, size, count in zip(names, kinds, sizes, counts, strict=True):
        if size not in _SIZES[kind] or count < 1:
            raise wrong("SIZE", f"has a field '{name[:40]}' of TYPE {kind.upper()}, SIZE {size} and COUNT {count}")
    if not 0 < sum(size * count for size, count in zip(sizes, counts, strict=True)) <= _LARGEST_POINT:
        raise wrong("FIELDS", "has no FIELDS in its header, or points of more than 1 MiB")
    height = values("HEIGHT", _count, 1, "1")[0]
    width = values("WIDTH", _count, 1, " ".join(words["POINTS"][0]) if "POINTS" in words else "")[0]
    points = values("POINTS", _count, 1, str(width * height))[0]
    if points != width * height:
        raise wrong("POINTS", f"has {points} POINTS in its header, but WIDTH x HEIGHT is {width} x {height}")
    data = values("DATA", ENCODINGS.index, 1, "")[0]
    viewpoint = np.array(values("VIEWPOINT", float, 7, "")) if "VIEWPOINT" in words else None
    fields = tuple(Field(a, np.dtype(f"<{k}{s}"), c) for a, k, s, c in zip(names, kinds, sizes, counts, strict=True))
    return PcdHeader(fields, points, width, height, viewpoint, ENCODINGS[data], offset, lines)


def _count(text: str) -> int:
    """A number of something in a header."""
    if not (text.isascii() and text.isdigit() and len(text) < 19):
        raise ValueError(text)
    return int(text)


def _read_binary(file: IO[bytes], path: Path, header: PcdHeader, left: int, first: int, last: int) -> NDArray[Any]:
    _expect(path, header, left, header.points * header.row.itemsize)
    file.seek(header.offset + first * header.row.itemsize)
    return np.fromfile(file, header.row, max(last - first, 0))


def _read_compressed(file: IO[bytes], path: Path, header: PcdHeader, left: int) -> NDArray[Any]:
    if not header.points:
        return np.empty(0, header.row)
    _expect(path, header, left, 8)
    packed, size = (int(n) for n in np.fromfile(file, "<u4", 2))
    _expect(path, header, left, 8 + packed)
    if size != header.points * header.row.itemsize or size > packed * _LARGEST_RATIO:
        problem = f"says that {packed} bytes unpack to {size}, not to {header.points} points of {header.row.itemsize}"
        raise DataError(path, problem, at=f"byte {header.offset}", hint="Write or copy the file again")
    columns = np.empty(size, np.uint8)
    source = kernels.frozen(np.fromfile(file, np.uint8, packed), np.uint8)
    bad = kernels.lzf.decompress(source, columns)
    if bad >= 0:
        at = f"byte {header.offset + 8 + bad}"
        raise DataError(path, "has damaged compressed points", at=at, hint="Write or copy the file again")
    rows = np.empty((header.points, header.row.itemsize), np.uint8)
    start = 0
    for column in _columns(header.fields, rows):
        column[:] = columns[start : start + column.size].reshape(column.shape)
        start += column.size
    return rows.view(header.row)[:, 0]


def _read_ascii(file: IO[bytes], path: Path, header: PcdHeader, left: int) -> NDArray[Any]:
    if not header.points:
        return np.empty(0, header.row)
    flat = _flat(header.fields)
    _expect(path, header, left, 2 * header.points * len(flat) - 1)  # a digit and a space each
    line = header.lines

    def lines() -> Iterator[str]:
        nonlocal line
        for content in file:
            line += 1
            if not content.isspace():
                yield content.decode("latin-1")

    try:
        rows: NDArray[Any] = np.loadtxt(lines(), flat, comments=None, ndmin=1)
    except (ValueError, OverflowError) as error:
        problem = f"has a point that cannot be read ({str(error)[:80]})"
        raise DataError(path, problem, at=f"line {line}", hint="Write or copy the file again") from None
    if rows.size < header.points:
        problem = f"has {rows.size} points, where its header says {header.points}"
        raise DataError(path, problem, at=f"line {line}", hint="Write or copy the file again")
    return rows[: header.points].view(header.row)


def _expect(path: Path, header: PcdHeader, left: int, needed: int) -> None:
    if left < needed:
        problem = f"is too short: {header.points} points need {needed} bytes from there on, it has {left}"
        raise DataError(path, problem, at=f"byte {header.offset}", hint="Write or copy the file again")


def _columns(fields: tuple[Field, ...], rows: NDArray[np.uint8]) -> Iterator[NDArray[np.uint8]]:
    """For each field its bytes in rows (N, bytes of a point): (N, bytes of the field) each."""
    place = 0
    for field in fields:
        size = field.dtype.itemsize * field.count
        yield rows[:, place : place + size]
        place += size


def _layout(dtypes: Mapping[str, np.dtype[Any]]) -> tuple[Field, ...]:
    """Fields of dtypes, or ValueError where PCD has no such type."""
    fields = []
    for name, dtype in dtypes.items():
        base, shape = (np.dtype(np.uint8) if dtype.base == np.bool_ else dtype.base), dtype.shape
        if not (name.isascii() and name == "".join(name.split()) and name not in ("", "_")):
            raise ValueError(f"'{name}' is no name for a field of a PCD file")
        if base.kind not in _SIZES or base.itemsize not in _SIZES[base.kind] or len(shape) > 1 or 0 in shape:
            raise ValueError(f"field '{name}': PCD has no type for {dtype}")
        fields.append(Field(name, base.newbyteorder("<"), shape[0] if shape else 1))
    if not fields:
        raise ValueError("a PCD file needs at least one field")
    return tuple(fields)


def _rows(fields: tuple[Field, ...], arrays: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
    """The points row by row, as ``binary`` has them."""
    if set(arrays) != {field.name for field in fields}:
        raise ValueError(f"fields are {', '.join(field.name for field in fields)}, not {', '.join(arrays)}")
    n = len(arrays[fields[0].name])
    rows = np.empty(n, [(field.name, field.dtype, (field.count,)) for field in fields])
    for field in fields:
        array = arrays[field.name]
        if array.shape not in ((n, field.count), *([(n,)] if field.count == 1 else [])):
            raise ValueError(f"field '{field.name}' has shape {array.shape}, not ({n},) or ({n}, {field.count})")
        np.copyto(rows[field.name], array.reshape(n, field.count), casting="same_kind")
    return rows


def _header_text(fields: tuple[Field, ...], points: int, T_world_sensor: ArrayLike | None, data: str) -> bytes:
    """The header; as long for every number of points, so that it can be written again when the number is known."""
    lines = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        "FIELDS " + " ".join(field.name for field in fields),
        "SIZE " + " ".join(str(field.dtype.itemsize) for field in fields),
        "TYPE " + " ".join(field.dtype.kind.upper() for field in fields),
        "COUNT " + " ".join(str(field.count) for field in fields),
        f"WIDTH {points:<18}",
        "HEIGHT 1",
        f"POINTS {points:<18}",
        f"DATA {data}",
    ]
    if T_world_sensor is not None:
        T = np.asarray(T_world_sensor, np.float64)
        view = (*T[:3, 3], *geometry.quaternion(T[:3, :3]))
        lines.insert(8, "VIEWPOINT " + " ".join(f"{value:.17g}" for value in view))
    return "\n".join(lines).encode() + b"\n"


def _ascii(fields: tuple[Field, ...], rows: NDArray[Any]) -> bytes:
    out = io.BytesIO()
    digits = {"f4": "%.9g", "f8": "%.17g"}  # enough to read the same number back
    form = [digits.get(field.dtype.str[1:], "%d") for field in fields for _ in range(field.count)]
    np.savetxt(out, rows.view(_flat(fields)), form)
    return out.getvalue()


def _compressed(fields: tuple[Field, ...], rows: NDArray[Any]) -> bytes:
    if not len(rows):
        return b""
    pieces = _columns(fields, rows.view(np.uint8).reshape(len(rows), -1))
    columns = np.concatenate([piece.ravel() for piece in pieces])
    out = np.empty(len(columns) * 33 // 32 + 2, np.uint8)
    packed = kernels.lzf.compress(kernels.frozen(columns, np.uint8), out)
    return np.array([packed, len(columns)], "<u4").tobytes() + out[:packed].tobytes()


def _flat(fields: tuple[Field, ...]) -> np.dtype[Any]:
    """A point as single numbers, for text."""
    return np.dtype([(f"{k}.{i}", field.dtype) for k, field in enumerate(fields) for i in range(field.count)])
