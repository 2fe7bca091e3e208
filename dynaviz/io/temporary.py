"""Temporary files that hold what a run must not keep in memory."""

from __future__ import annotations

import tempfile
from typing import IO

from dynaviz.errors import DynavizError


def store(file: IO[bytes], rest: memoryview, size: int, what: str) -> None:
    """Write bytes to a temporary file.

    Args:
        file: unbuffered, at its end.
        rest: the bytes.
        size: of the file with them, bytes; for the error.
        what: what the file contains, for the error.

    Raises:
        DynavizError: if the disk is full.
    """
    try:
        while len(rest):
            rest = rest[file.write(rest) :]
    except OSError as error:
        raise DynavizError(
            f"{tempfile.gettempdir()}: cannot write {size / 1e6:.0f} MB of temporary {what} "
            f"({error.strerror}). "
            "Free some space, or set TMPDIR to a folder on a larger disk."
        ) from None
