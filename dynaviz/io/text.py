"""Read lines of numbers, with errors that name the line. All text formats use it."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F64
from dynaviz.errors import DataError
from dynaviz.io.atomic import open_file


def read_rows(
    path: str | os.PathLike[str], file: Iterable[bytes], dtype: np.dtype[Any], line: int = 0
) -> NDArray[Any]:
    """Read the rest of an open file; empty lines and lines that start with ``#`` are skipped.

    Args:
        path: file name for error messages.
        file: a file open for reading bytes, or an iterable of lines.
        dtype: structured, one field per number.
        line: number of lines already read.

    Returns:
        (lines,) of the dtype.

    Raises:
        DataError: if a line does not match the dtype; names the line.
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
        raise DataError(
            path, problem, at=f"line {line}", hint="Write or copy the file again"
        ) from None


def read_table(path: str | os.PathLike[str], columns: int, hint: str) -> F64:
    """Read a text file of numbers.

    Args:
        path: the file.
        columns: numbers per line.
        hint: expected content, for error messages.

    Returns:
        (lines, columns) float64, all finite.

    Raises:
        DataError: if the file cannot be read or a line is invalid.
    """
    with open_file(path, hint) as file:
        rows = read_rows(path, file, np.dtype([(str(k), np.float64) for k in range(columns)]))
    table: F64 = rows.view(np.float64).reshape(len(rows), columns)
    if not np.isfinite(table).all():
        row = int(np.flatnonzero(~np.isfinite(table).all(1))[0])
        raise DataError(path, "a number is not finite", at=f"row {row}, counted from 0", hint=hint)
    return table
