"""JSON files that are read as a whole."""

from __future__ import annotations

import json
import os
from typing import Any

from dynaviz.errors import DataError
from dynaviz.io.atomic import opened


def read_json(path: str | os.PathLike[str], hint: str) -> Any:
    """Read a file.

    Args:
        path: the file.
        hint: what to do where it is none.

    Raises:
        DataError: where it cannot be read, or is not JSON.
    """
    with opened(path, hint) as file:
        try:
            return json.load(file)
        except (ValueError, RecursionError) as error:
            raise DataError(path, f"is not JSON ({error})", hint=hint) from None
