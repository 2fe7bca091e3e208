"""Read JSON files."""

from __future__ import annotations

import json
import os
from typing import Any

from dynaviz.errors import DataError
from dynaviz.io.atomic import open_file


def read_json(path: str | os.PathLike[str], hint: str) -> Any:
    """Read a file.

    Args:
        path: the file.
        hint: what to do if it is not valid JSON, for the error message.

    Raises:
        DataError: if the file cannot be read or is not valid JSON.
    """
    with open_file(path, hint) as file:
        try:
            return json.load(file, parse_int=_integer)
        except (ValueError, RecursionError) as error:
            raise DataError(path, f"not valid JSON ({error})", hint=hint) from None


def _integer(text: str) -> int:
    """The number; ValueError for more than 64 bits, which arrays cannot hold."""
    number = int(text)
    if not -(1 << 63) <= number < 1 << 64:
        raise ValueError(f"{text[:20]}... has more than 64 bits")
    return number
