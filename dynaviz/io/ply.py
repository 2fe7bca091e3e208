"""Vertices of PLY files (1.0): ascii, and binary in both byte orders.

Open3D also reads PLY, but returns uninitialised memory if a file is truncated or has no z.
"""

from __future__ import annotations

import itertools
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import numpy as np

from dynaviz.errors import DataError
from dynaviz.io.atomic import open_file
from dynaviz.io.text import read_rows

_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_RETRY_HINT = "Write or copy the file again"
_MAX_LINE = 1 << 16  # bytes; a header with a longer line is treated as corrupt
_MAX_COUNT = 1 << 48  # items of an element, likewise


@dataclass
class _Element:
    """An element of the header: name, number of items, and their properties in file order."""

    name: str
    count: int
    properties: list[tuple[str, str]] = field(default_factory=list)
    has_list: bool = False

    def dtype(self, order: str) -> np.dtype[np.void]:
        return np.dtype([(name, order + kind) for name, kind in self.properties])


def read_ply_rows(path: str | os.PathLike[str]) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    """Read the vertices with all properties.

    Returns:
        (N,) of a structured dtype with the properties of the file.

    Raises:
        DataError: if the file cannot be read, is corrupt or too short, or its vertices have no x, y
            or z.
    """
    path = Path(path)
    with open_file(path, "Give a PLY file") as file:
        order, elements, lines = _read_header(path, file)
        names = [element.name for element in elements]
        if "vertex" not in names:
            raise DataError(
                path, "the header has no element 'vertex'", hint="Write the points as vertices"
            )
        before = elements[: names.index("vertex")]
        vertex = elements[names.index("vertex")]
        _check_properties(path, [*before, vertex])
        return (_read_ascii if order == "=" else _read_binary)(
            path, file, order, before, vertex, lines
        )


def _read_header(path: Path, file: IO[bytes]) -> tuple[str, list[_Element], int]:
    """Byte order, elements and number of lines; leaves the file at the content."""
    order = ""
    elements = list[_Element]()
    for number in itertools.count(1):
        line = file.readline(_MAX_LINE)
        words = line.decode("latin-1").split()
        at = f"line {number}"
        if not line.endswith(b"\n") or (number == 1 and words != ["ply"]):
            raise DataError(
                path,
                "not a PLY file, or truncated in the header",
                at=at,
                hint="Give a complete PLY file",
            )
        try:
            match words:
                case ["format", name, "1.0"]:
                    order = _ORDERS[name]
                case ["element", name, count]:
                    elements.append(_Element(name, int(count)))
                    if not 0 <= elements[-1].count < _MAX_COUNT:
                        raise ValueError(count)
                case ["property", "list", *_]:
                    elements[-1].has_list = True
                case ["property", kind, name]:
                    elements[-1].properties.append((name, _TYPES[kind]))
                case ["end_header"] if order:
                    return order, elements, number
                case ["ply" | "comment" | "obj_info", *_] | []:
                    pass
                case _:
                    raise ValueError(words)
        except (KeyError, ValueError, IndexError):
            problem = f"'{' '.join(words)[:60]}' in the header is not valid PLY 1.0"
            raise DataError(path, problem, at=at, hint=_RETRY_HINT) from None
    raise AssertionError  # unreachable: the loop never ends


def _check_properties(path: Path, elements: list[_Element]) -> None:
    *_, vertex = elements
    for element in elements:
        names = [name for name, _ in element.properties]
        if element.has_list or len(set(names)) < len(names):
            problem = f"element '{element.name}' has list properties or duplicate names"
            raise DataError(
                path, problem, hint="Write the cloud with scalar properties, vertices first"
            )
    if missing := [axis for axis in "xyz" if axis not in dict(vertex.properties)]:
        problem = f"the vertices have no {', '.join(missing)}"
        raise DataError(path, problem, hint="Write each vertex with x, y and z")


def _read_binary(
    path: Path, file: IO[bytes], order: str, before: list[_Element], vertex: _Element, lines: int
) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    row = vertex.dtype(order)
    start = file.tell()
    start += sum(element.count * element.dtype(order).itemsize for element in before)
    left = os.fstat(file.fileno()).st_size - start
    if left < vertex.count * row.itemsize:
        problem = (
            f"file is too short: {vertex.count} vertices need {vertex.count * row.itemsize} bytes, "
            f"{left} are left"
        )
        raise DataError(path, problem, at=f"byte {start}", hint=_RETRY_HINT)
    file.seek(start)
    return np.fromfile(file, row, vertex.count)


def _read_ascii(
    path: Path, file: IO[bytes], order: str, before: list[_Element], vertex: _Element, lines: int
) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    skipped = sum(1 for _ in itertools.islice(file, sum(element.count for element in before)))
    rows = read_rows(path, itertools.islice(file, vertex.count), vertex.dtype("="), lines + skipped)
    if len(rows) < vertex.count:
        problem = f"contains {len(rows)} vertices, but the header states {vertex.count}"
        raise DataError(path, problem, at="end of file", hint=_RETRY_HINT)
    return rows
