"""Open NPY and NPZ files."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from typing import Any

import numpy as np

from dynaviz.errors import DataError
from dynaviz.io.atomic import open_file


@contextlib.contextmanager
def open_npy(path: str | os.PathLike[str], kind: str, hint: str) -> Iterator[Any]:
    """Open a file with ``numpy.load``.

    NPY as a memory-mapped array, NPZ as arrays by name, read on access.

    Args:
        path: the file.
        kind: expected file type, such as ``NPY file``, for the error message.
        hint: what to do if it is not of that type.

    Raises:
        DataError: if the file cannot be read, or reading it in the ``with`` block fails.
    """
    with open_file(path, hint) as file:
        try:
            # Map arrays: otherwise numpy allocates the size that the header states, however short
            # the file is.
            is_array = file.read(6) == b"\x93NUMPY"
            file.seek(0)
            yield np.load(path, "r") if is_array else np.load(file)
        except Exception as error:  # numpy raises many types of errors for corrupt files
            raise DataError(path, f"not a valid {kind} ({str(error)[:80]})", hint=hint) from None
