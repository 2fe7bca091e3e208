"""Open files with readable errors, and write files and folders atomically.

Complete or not at all.
"""

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

# raised by writes only; write() sets no filename
_DISK_ERRORS = {
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EFBIG,
    errno.EROFS,
}


@contextlib.contextmanager
def open_file(path: str | os.PathLike[str], hint: str) -> Iterator[IO[bytes]]:
    """Open a file for reading.

    Args:
        path: the file.
        hint: what to do if it cannot be read, for the error message.

    Raises:
        DataError: if the file cannot be opened or read.
    """
    try:
        with open(path, "rb") as file:
            yield file
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror or error})", hint=hint) from error


@contextlib.contextmanager
def atomic_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path next to ``path`` to write to.

    Rename it on success, remove it on failure.

    Raises:
        DataError: if the folder is not writable or the disk is full. Other errors are passed on
            unchanged.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        if error.errno not in _DISK_ERRORS and error.filename not in _involved_paths(
            path, temporary
        ):
            raise
        raise write_error(path, error, "another folder with -o") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


@contextlib.contextmanager
def atomic_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield an empty temporary folder next to ``path``; rename it on success, remove it on failure.

    Raises:
        DataError: if ``path`` already exists, its parent is not writable, or the disk is full.
    """
    path = Path(path)
    if os.path.lexists(path):
        raise DataError(path, "already exists", hint="Remove it or choose another folder")
    temporary = path.with_name(f".{path.name}.part")
    shutil.rmtree(temporary, ignore_errors=True)
    try:
        temporary.mkdir(parents=True)
        yield temporary
        temporary.rename(path)
    except OSError as error:
        in_temporary = os.fspath(error.filename or "").startswith(os.fspath(temporary))
        if (
            error.errno not in _DISK_ERRORS
            and not in_temporary
            and error.filename not in _involved_paths(path, temporary)
        ):
            raise
        raise write_error(path, error, "another folder") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def sha256(path: str | os.PathLike[str]) -> str:
    """SHA-256 digest of a file.

    Raises:
        OSError: if the file cannot be read.
    """
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def remove(path: str | os.PathLike[str]) -> None:
    """Remove a file if it exists.

    Raises:
        DataError: if the file exists and cannot be removed.
    """
    try:
        os.unlink(path)
    except (FileNotFoundError, NotADirectoryError):
        pass
    except OSError as error:
        raise DataError(
            path, f"cannot be removed ({error.strerror})", hint="Choose another folder with -o"
        ) from None


def write_atomic(path: str | os.PathLike[str], content: bytes) -> None:
    """Write bytes atomically."""
    with atomic_file(path) as temporary:
        temporary.write_bytes(content)


def write_error(path: Path, error: OSError, alternative: str) -> DataError:
    """The error for a file or folder that cannot be written."""
    places = (path, *path.parents) if isinstance(error, FileExistsError) else path.parents
    file = next((place for place in places if place.is_file()), None)
    hint = (
        f"{file} is a file: choose {alternative}"
        if file
        else f"Free disk space or choose {alternative}"
    )
    return DataError(path, f"cannot be written ({error.strerror})", hint=hint)


def _involved_paths(path: Path, temporary: Path) -> set[str]:
    """The file names that an OSError reports when the file is created, written or renamed."""
    return {os.fspath(involved) for involved in (path, temporary, *path.parents)}
