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
    """What ``numpy.load`` makes of a file: an array, or arrays by name that are read when asked for.

    Args:
        path: the file.
        kind: what it should be, as ``NPY file``, for errors.
        hint: what to do where it is not.

    Raises:
        DataError: where it cannot be read, or reading in the ``with`` block fails.
    """
    with opened(path, hint) as file:
        try:
            yield np.load(file, allow_pickle=False)
        except Exception as error:  # damaged headers and archives make numpy fail in many ways
            raise DataError(path, f"is no whole {kind} ({str(error)[:80]})", hint=hint) from None
