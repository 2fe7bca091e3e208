"""Polygon files (PLY 1.0): where the vertices lie; ascii and binary of both byte orders.

Open3D reads PLY too, but gives back uninitialised memory where a file is cut short or has no z.
"""

from __future__ import annotations

import itertools
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import numpy as np

from dynaviz.arrays import F32
from dynaviz.errors import DataError
from dynaviz.io.atomic import opened
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
_AGAIN = "Write or copy the file again"
_LONGEST_LINE = 1 << 16  # bytes; beyond, a header is taken for damaged
_MOST = 1 << 48  # things of a kind, likewise


@dataclass
class _Element:
    """What the header says of one kind of thing: how many there are, and their numbers in order."""

    name: str
    count: int
    properties: list[tuple[str, str]] = field(default_factory=list)
    has_list: bool = False

    def row(self, order: str) -> np.dtype[np.void]:
        return np.dtype([(name, order + kind) for name, kind in self.properties])


def read_ply(path: str | os.PathLike[str]) -> F32:
    """Read the vertices.

    Returns:
        (N, 3) float32, in the file's frame and unit.

    Raises:
        DataError: for a file that cannot be read, is damaged or too short, or whose vertices have no x, y, z.
    """
    path = Path(path)
    with opened(path, "Give a PLY file") as file:
        order, elements, lines = _header(path, file)
        names = [element.name for element in elements]
        if "vertex" not in names:
            raise DataError(path, "has no element 'vertex' in its header", hint="Write the cloud as vertices")
        before, vertex = elements[: names.index("vertex")], elements[names.index("vertex")]
        _check(path, [*before, vertex])
        rows = (_ascii if order == "=" else _binary)(path, file, order, before, vertex, lines)
        with np.errstate(over="ignore"):  # beyond float32 is infinite
            return np.stack([rows[axis].astype(np.float32) for axis in "xyz"], 1)


def _header(path: Path, file: IO[bytes]) -> tuple[str, list[_Element], int]:
    """Byte order, elements, and the number of lines; the content comes next."""
    order, elements = "", list[_Element]()
    for number in itertools.count(1):
        line = file.readline(_LONGEST_LINE)
        words, at = line.decode("latin-1").split(), f"line {number}"
        if not line.endswith(b"\n") or (number == 1 and words != ["ply"]):
            raise DataError(path, "is no PLY file, or ends in its header", at=at, hint="Give or copy a whole PLY file")
        try:
            match words:
                case ["format", name, "1.0"]:
                    order = _ORDERS[name]
                case ["element", name, count]:
                    elements.append(_Element(name, int(count)))
                    if not 0 <= elements[-1].count < _MOST:
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
            problem = f"has '{' '.join(words)[:60]}' in its header, which is no line of PLY 1.0"
            raise DataError(path, problem, at=at, hint=_AGAIN) from None
    raise AssertionError  # the counter never ends


def _check(path: Path, elements: list[_Element]) -> None:
    *_, vertex = elements
    for element in elements:
        names = [name for name, _ in element.properties]
        if element.has_list or len(set(names)) < len(names):
            problem = f"has lists or equal names among the properties of its element '{element.name}'"
            raise DataError(path, problem, hint="Write the cloud with plain numbers, vertices first")
    if missing := [axis for axis in "xyz" if axis not in dict(vertex.properties)]:
        problem = f"has vertices without {' '.join(missing)}"
        raise DataError(path, problem, hint="Write each vertex with x, y and z")


def _binary(
    path: Path, file: IO[bytes], order: str, before: list[_Element], vertex: _Element, lines: int
) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    row, start = vertex.row(order), file.tell()
    start += sum(element.count * element.row(order).itemsize for element in before)
    left = os.fstat(file.fileno()).st_size - start
    if left < vertex.count * row.itemsize:
        problem = f"is too short: {vertex.count} vertices need {vertex.count * row.itemsize} bytes, it has {left}"
        raise DataError(path, problem, at=f"byte {start}", hint=_AGAIN)
    file.seek(start)
    return np.fromfile(file, row, vertex.count)


def _ascii(
    path: Path, file: IO[bytes], order: str, before: list[_Element], vertex: _Element, lines: int
) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    skipped = sum(1 for _ in itertools.islice(file, sum(element.count for element in before)))
    rows = read_rows(path, itertools.islice(file, vertex.count), vertex.row("="), lines + skipped)
    if len(rows) < vertex.count:
        problem = f"has {len(rows)} vertices, where its header says {vertex.count}"
        raise DataError(path, problem, at="at its end", hint=_AGAIN)
    return rows
