"""Read columns of Feather files (Arrow tables) as arrays."""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz.errors import DataError
from dynaviz.io.atomic import open_file

_HINT = "Copy the file again"


def read_feather(
    path: str | os.PathLike[str],
    columns: Sequence[str],
    text: Collection[str] = (),
    integers: Collection[str] = (),
) -> dict[str, NDArray[Any]]:
    """Read columns of a table.

    Args:
        path: the file.
        columns: names of the columns; they contain numbers.
        text: those that contain text instead.
        integers: those that contain integers.

    Returns:
        (rows,) arrays by name, in the types of the file; text as objects.

    Raises:
        DataError: if the file cannot be read or is corrupt, or a column is missing, has missing
            values or a wrong type.
    """
    from pyarrow import feather, types

    with open_file(path, _HINT) as file:
        try:
            table = feather.read_table(file)
            table.validate(full=True)  # otherwise Arrow follows offsets that point outside the file
        except Exception as error:  # Arrow raises many types of errors for corrupt files
            problem = f"not a valid Feather file ({str(error)[:80]})"
            raise DataError(path, problem, hint=_HINT) from None
    for name in columns:
        if (count := table.column_names.count(name)) != 1:
            problem = f"column {name} is missing (found: {' '.join(table.column_names)})"
            raise DataError(
                path, f"there are {count} columns {name}" if count else problem, hint=_HINT
            )
        if table[name].null_count:
            raise DataError(path, f"column {name} has missing values", hint=_HINT)
        kind = table.schema.field(name).type
        if name in text:
            valid = types.is_string(kind) or types.is_large_string(kind)
            expected = "text"
        elif name in integers:
            valid = types.is_integer(kind)
            expected = "integers"
        else:
            valid = types.is_integer(kind) or types.is_floating(kind)
            expected = "numbers"
        if not valid:
            raise DataError(path, f"column {name} contains {kind}, not {expected}", hint=_HINT)
    return {name: np.asarray(table[name].to_numpy()) for name in columns}
