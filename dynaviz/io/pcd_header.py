"""Headers of PCD files (0.5 to 0.7): fields and their types, number of points, viewpoint."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import ArrayLike

from dynaviz.arrays import F64
from dynaviz.errors import DataError
from dynaviz.io.atomic import open_file
from dynaviz.spatial import geometry

ENCODINGS = ("ascii", "binary", "binary_compressed")
_KINDS = {"F": "f", "I": "i", "U": "u"}
_SIZES = {"f": (4, 8), "i": (1, 2, 4, 8), "u": (1, 2, 4, 8)}
_KEYWORDS = (
    "VERSION",
    "FIELDS",
    "SIZE",
    "TYPE",
    "COUNT",
    "WIDTH",
    "HEIGHT",
    "VIEWPOINT",
    "POINTS",
    "DATA",
)
# bytes; a header with more is treated as corrupt
_MAX_LINE = 1 << 16
_MAX_POINT = 1 << 20


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a point: ``count`` little-endian values of ``dtype``."""

    name: str
    dtype: np.dtype[Any]
    count: int = 1


@dataclass(frozen=True, eq=False)
class PcdHeader:
    """The header of a PCD file.

    Attributes:
        fields: in file order; ``_`` is padding.
        points: number of points, equal to width * height.
        width, height: of an organised cloud; height is 1 otherwise.
        viewpoint: (7,) float64: tx ty tz in metres, qw qx qy qz; None if the file has none.
        data: ``ascii``, ``binary`` or ``binary_compressed``.
        offset: byte offset of the points.
        lines: number of header lines.
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
        """Structured dtype of a point.

        Padding has no name, and the first of two equal names is used.
        """
        columns: dict[str, tuple[Any, int]] = {}
        offset = 0
        for field in self.fields:
            dtype = field.dtype if field.count == 1 else (field.dtype, (field.count,))
            if field.name != "_":
                columns.setdefault(field.name, (dtype, offset))
            offset += field.dtype.itemsize * field.count
        dtypes = [dtype for dtype, _ in columns.values()]
        offsets = [start for _, start in columns.values()]
        return np.dtype(
            {"names": list(columns), "formats": dtypes, "offsets": offsets, "itemsize": offset}
        )


def read_header(path: str | os.PathLike[str]) -> PcdHeader:
    """Read the header of a file.

    Raises:
        DataError: if the file cannot be read or its header is invalid; names the line.
    """
    with open_file(path, "Give a PCD file") as file:
        return parse_header(Path(path), file)


def parse_header(path: Path, file: IO[bytes]) -> PcdHeader:
    """Read the header of an open file and leave the file at the first point.

    Raises as ``read_header``.
    """
    words: dict[str, tuple[list[str], str]] = {}
    lines = 0
    while "DATA" not in words:
        line = file.readline(_MAX_LINE)
        lines += 1
        at = f"line {lines}"
        if not line.endswith(b"\n"):
            raise DataError(
                path,
                "not a PCD file, or truncated in the header",
                at=at,
                hint="Write or copy the file again",
            )
        word, *values = line.decode("latin-1").split() or ["#"]
        word = {"COLUMNS": "FIELDS"}.get(word.upper(), word.upper())  # its name in version 0.5
        if word in _KEYWORDS:
            words[word] = values, at
        elif not word.startswith("#"):
            hint = f"The lines of a PCD header are {' '.join(_KEYWORDS)}"
            raise DataError(path, f"unknown keyword {word[:20]!r} in the header", at=at, hint=hint)
    return _validated(path, words, file.tell(), lines)


def _validated(
    path: Path, words: dict[str, tuple[list[str], str]], offset: int, lines: int
) -> PcdHeader:
    """The header from its words, or DataError at the first invalid line."""

    def invalid(word: str, problem: str) -> DataError:
        return DataError(
            path,
            problem,
            at=words.get(word, ([], "header"))[1],
            hint="Write or copy the file again",
        )

    def values(word: str, kind: Callable[[str], Any], length: int, default: str) -> list[Any]:
        texts = words[word][0] if word in words else [default] * length
        try:
            found = [kind(text) for text in texts]
        except (ValueError, KeyError):
            found = []
        if len(found) != length:
            shown = " ".join([word, *texts])[:80]
            raise invalid(
                word,
                f"'{shown}' in the header: expected {length} valid "
                f"{'value' if length == 1 else 'values'}",
            )
        return found

    names = words["FIELDS"][0] if "FIELDS" in words else []
    n = len(names)
    kinds = values("TYPE", _KINDS.__getitem__, n, "F")
    sizes = values("SIZE", int, n, "4")
    counts = values("COUNT", _count, n, "1")
    for name, kind, size, count in zip(names, kinds, sizes, counts, strict=True):
        if size not in _SIZES[kind]:
            raise invalid(
                "SIZE", f"field '{name[:40]}' has an invalid TYPE {kind.upper()} or SIZE {size}"
            )
        if count < 1 and name != "_":  # padding may be empty
            raise invalid("COUNT", f"field '{name[:40]}' has the invalid COUNT {count}")
    if not 0 < sum(size * count for size, count in zip(sizes, counts, strict=True)) <= _MAX_POINT:
        raise invalid("FIELDS", "the header has no FIELDS, or points larger than 1 MiB")
    height = values("HEIGHT", _count, 1, "1")[0]
    width = values("WIDTH", _count, 1, " ".join(words["POINTS"][0]) if "POINTS" in words else "")[0]
    points = values("POINTS", _count, 1, str(width * height))[0]
    if points != width * height:
        raise invalid("POINTS", f"POINTS is {points}, but WIDTH x HEIGHT is {width} x {height}")
    data = values("DATA", ENCODINGS.index, 1, "")[0]
    viewpoint = np.array(values("VIEWPOINT", float, 7, "")) if "VIEWPOINT" in words else None
    fields = tuple(
        Field(a, np.dtype(f"<{k}{s}"), c)
        for a, k, s, c in zip(names, kinds, sizes, counts, strict=True)
    )
    return PcdHeader(fields, points, width, height, viewpoint, ENCODINGS[data], offset, lines)


def _count(text: str) -> int:
    """A count in a header; ValueError if it is not a non-negative integer below 10**18."""
    if not (text.isascii() and text.isdigit() and len(text) < 19):
        raise ValueError(text)
    return int(text)


def fields_from_dtypes(dtypes: Mapping[str, np.dtype[Any]]) -> tuple[Field, ...]:
    """Fields for dtypes; ValueError if PCD does not support a name or type."""
    fields = []
    for name, dtype in dtypes.items():
        base = np.dtype(np.uint8) if dtype.base == np.bool_ else dtype.base
        shape = dtype.shape
        if not (name.isascii() and name == "".join(name.split()) and name not in ("", "_")):
            raise ValueError(f"'{name}' is not a valid name for a PCD field")
        if (
            base.kind not in _SIZES
            or base.itemsize not in _SIZES[base.kind]
            or len(shape) > 1
            or 0 in shape
        ):
            raise ValueError(f"field '{name}': PCD does not support {dtype}")
        fields.append(Field(name, base.newbyteorder("<"), shape[0] if shape else 1))
    if not fields:
        raise ValueError("a PCD file needs at least one field")
    return tuple(fields)


def header_text(fields: tuple[Field, ...], points: int, T_world_sensor: ArrayLike | None) -> bytes:
    """The header of a binary file.

    Its length does not depend on the number of points, so it can be rewritten later.
    """
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
        "DATA binary",
    ]
    if T_world_sensor is not None:
        T = np.asarray(T_world_sensor, np.float64)
        view = (*T[:3, 3], *geometry.quaternion(T[:3, :3]))
        lines.insert(8, "VIEWPOINT " + " ".join(f"{value:.17g}" for value in view))
    return "\n".join(lines).encode() + b"\n"
