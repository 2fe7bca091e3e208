"""Lines of numbers: the base of every text format here, with errors that name the line."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F64
from dynaviz.errors import DataError
from dynaviz.io.atomic import opened


def read_rows(path: str | os.PathLike[str], file: Iterable[bytes], dtype: np.dtype[Any], line: int = 0) -> NDArray[Any]:
    """Read what is left of an open file; empty lines and those that begin with ``#`` are skipped.

    Args:
        path: its name, for errors.
        file: open for reading bytes, or some of its lines.
        dtype: structured, one field a number.
        line: number of lines that were read before.

    Returns:
        (lines,) of the dtype.

    Raises:
        DataError: for a line that has other numbers than the dtype; it names the line.
    """

    def lines() -> Iterator[str]:
        nonlocal line
        for content in file:
            line += 1
            text = content.decode("latin-1")
            if not (text.isspace() or text.startswith("#")):
                yield text

    content = lines()
    first = next(content, None)
    if first is None:
        return np.empty(0, dtype)
    try:
        return np.loadtxt(itertools.chain([first], content), dtype, comments=None, ndmin=1)
    except (ValueError, OverflowError) as error:
        problem = f"cannot be read ({str(error).partition(';')[0][:80]})"
        raise DataError(path, problem, at=f"line {line}", hint="Write or copy the file again") from None


def read_table(path: str | os.PathLike[str], columns: int, hint: str) -> F64:
    """Read a text file of numbers.

    Args:
        path: the file.
        columns: how many numbers a line has.
        hint: what the file should hold, for errors.

    Returns:
        (lines, columns) float64, all finite.

    Raises:
        DataError: for a file that cannot be read, or a line of other numbers.
    """
    with opened(path, hint) as file:
        rows = read_rows(path, file, np.dtype([(str(k), np.float64) for k in range(columns)]))
    table: F64 = rows.view(np.float64).reshape(len(rows), columns)
    if not np.isfinite(table).all():
        row = int(np.flatnonzero(~np.isfinite(table).all(1))[0])
        raise DataError(path, f"has a number that is not finite in row {row}, counted from 0", hint=hint)
    return table
