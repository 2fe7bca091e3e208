"""Opening files with errors that a user understands, and writing them whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from dynaviz.errors import DataError

_DISK = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS}  # only writing fails so, and write() names no file


@contextlib.contextmanager
def opened(path: str | os.PathLike[str], hint: str) -> Iterator[IO[bytes]]:
    """Open a file for reading.

    Args:
        path: the file.
        hint: what to do where it cannot be read.

    Raises:
        DataError: where it cannot be opened or read.
    """
    try:
        with open(path, "rb") as file:
            yield file
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror or error})", hint=hint) from error


@contextlib.contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a path beside ``path`` to write to; rename it on success, remove it on failure.

    Raises:
        DataError: where the folder cannot be written, or the disk is full. Other errors come out as they are.
    """
    path = Path(path)
    beside = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield beside
        os.replace(beside, path)
    except OSError as error:
        if error.errno not in _DISK and error.filename not in _places(path, beside):
            raise
        raise _unwritable(path, error, "another folder with -o") from error
    finally:
        with contextlib.suppress(OSError):
            beside.unlink()


@contextlib.contextmanager
def whole_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give an empty folder beside ``path`` to write to; rename it on success, remove it on failure.

    Raises:
        DataError: where ``path`` exists already, the folder around it cannot be written, or the disk is full.
    """
    path = Path(path)
    if os.path.lexists(path):
        raise DataError(path, "exists already", hint="Remove it or choose another folder")
    beside = path.with_name(f".{path.name}.part")
    shutil.rmtree(beside, ignore_errors=True)
    try:
        beside.mkdir(parents=True)
        yield beside
        beside.rename(path)
    except OSError as error:
        inside = os.fspath(error.filename or "").startswith(os.fspath(beside))
        if error.errno not in _DISK and not inside and error.filename not in _places(path, beside):
            raise
        raise _unwritable(path, error, "another folder") from error
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def sha256(path: str | os.PathLike[str]) -> str:
    """Digest of a file.

    Raises:
        OSError: where it cannot be read.
    """
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def remove(path: str | os.PathLike[str]) -> None:
    """Remove a file, where there is one.

    Raises:
        DataError: where it is there and stays.
    """
    try:
        os.unlink(path)
    except (FileNotFoundError, NotADirectoryError):
        pass
    except OSError as error:
        raise DataError(path, f"cannot be removed ({error.strerror})", hint="Choose another folder with -o") from None


def write_whole(path: str | os.PathLike[str], content: bytes) -> None:
    """Write bytes, whole or not at all."""
    with whole_file(path) as beside:
        beside.write_bytes(content)


def _unwritable(path: Path, error: OSError, elsewhere: str) -> DataError:
    """What to say and to do where a file or folder cannot be written."""
    file = next((parent for parent in path.parents if parent.is_file()), None)
    hint = f"Free space or choose {elsewhere}" if file is None else f"{file} is a file: choose {elsewhere}"
    return DataError(path, f"cannot be written ({error.strerror})", hint=hint)


def _places(path: Path, beside: Path) -> set[str]:
    """What an OSError of making, writing or renaming the file gives as its file name."""
    return {os.fspath(place) for place in (path, beside, *path.parents)}
