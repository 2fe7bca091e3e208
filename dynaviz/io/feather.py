"""Feather files (Arrow tables) as arrays."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz.errors import DataError
from dynaviz.io.atomic import opened

_HINT = "Copy the file again"


def read_feather(path: str | os.PathLike[str], columns: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Read columns of a table.

    Args:
        path: the file.
        columns: their names.

    Returns:
        By name, (rows,) arrays of the file's own types; text as objects.

    Raises:
        DataError: for a file that cannot be read, is cut, lacks a column, or has gaps in one.
    """
    from pyarrow import feather, types

    with opened(path, _HINT) as file:
        try:
            table = feather.read_table(file)
            table.validate(full=True)  # else offsets that lead out of the file are followed
        except Exception as error:  # damaged files make Arrow fail in many ways
            problem = f"is no whole Feather file ({str(error)[:80]})"
            raise DataError(path, problem, hint=_HINT) from None
    for name in columns:
        if name not in table.column_names:
            raise DataError(path, f"has no column {name}, only: {' '.join(table.column_names)}", hint=_HINT)
        if table[name].null_count:
            raise DataError(path, f"has gaps in its column {name}", hint=_HINT)
        kind = table.schema.field(name).type
        if not (
            types.is_integer(kind) or types.is_floating(kind) or types.is_string(kind) or types.is_large_string(kind)
        ):
            raise DataError(path, f"has {kind} in its column {name}", hint=_HINT)
    return {name: np.asarray(table[name].to_numpy()) for name in columns}
