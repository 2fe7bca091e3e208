"""Arrays in NPY and NPZ files."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from typing import Any

import numpy as np

from dynaviz.errors import DataError
from dynaviz.io.atomic import opened


@contextlib.contextmanager
def loaded(path: str | os.PathLike[str], kind: str, hint: str) -> Iterator[Any]:
    """What ``numpy.load`` makes of a file: a mapped array, or arrays by name that are read when asked for.

    Args:
        path: the file.
        kind: what it should be, as ``NPY file``, for errors.
        hint: what to do where it is not.

    Raises:
        DataError: where it cannot be read, or reading in the ``with`` block fails.
    """
    with opened(path, hint) as file:
        try:
            # An array is mapped, for else room is made for whatever its header says, however short the file.
            plain = file.read(6) == b"\x93NUMPY"
            file.seek(0)
            yield np.load(path, "r") if plain else np.load(file)
        except Exception as error:  # damaged headers and archives make numpy fail in many ways
            raise DataError(path, f"is no whole {kind} ({str(error)[:80]})", hint=hint) from None
