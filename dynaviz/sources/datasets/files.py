"""Helpers shared by the formats: numbered sweeps, and choosing the only candidate."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

from dynaviz.contracts.attributes import Attributes
from dynaviz.contracts.reader import Reader
from dynaviz.errors import DataError
from dynaviz.io.velodyne import read_velodyne, velodyne_attributes

T = TypeVar("T")


class VelodyneSweeps(Reader):
    """Frames that are numbered ``.bin`` files; ``scans`` are these files by number, in order."""

    scans: dict[int, Path]

    def __len__(self) -> int:
        return len(self.scans)

    def index_of(self, position: int) -> int:
        """The number of the frame at a position."""
        return list(self.scans)[position]

    def scan_file(self, index: int) -> Path | None:
        """The file of the frame with this number."""
        return self.scans.get(index)

    def attributes(self, position: int) -> Attributes:
        """The intensity."""
        return velodyne_attributes(read_velodyne(self.scans[self.index_of(position)]))


def has_files(folder: Path, pattern: str) -> bool:
    """Whether a folder exists and contains a file that matches a pattern."""
    return next(folder.glob(pattern), None) is not None


def is_file(path: Path) -> bool:
    """Whether a file exists.

    False also for a name that the system does not allow, such as one that is too long.
    """
    try:
        return path.is_file()
    except OSError:
        return False


def numbered_files(folder: Path, suffix: str) -> dict[int, Path]:
    """The files of a folder by their number, in increasing order.

    Raises:
        DataError: if there are no files, a name is not a number, or two files have the same number.
    """
    files: dict[int, Path] = {}
    for path in folder.glob(f"*{suffix}"):
        stem = path.name.removesuffix(suffix)
        if not (stem.isascii() and stem.isdigit() and len(stem) < 20 and int(stem) < 1 << 63):
            hint = (
                f"Name the scans 000000{suffix}, 000001{suffix} ..., and keep other {suffix} files "
                "elsewhere"
            )
            raise DataError(path, "file name is not a frame number", hint=hint)
        if int(stem) in files:
            raise DataError(
                path, f"has the same number as {files[int(stem)].name}", hint="Remove one of them"
            )
        files[int(stem)] = path
    if not files:
        problem = f"has no *{suffix} files" if folder.is_dir() else "does not exist"
        raise DataError(folder, problem, hint="Give the folder of a sequence")
    return dict(sorted(files.items()))


def only_folder(folder: Path, what: str) -> Path:
    """The only subfolder of a folder.

    Raises:
        DataError: if there is none, or more than one.
    """
    subfolders = [path for path in folder.iterdir() if path.is_dir()] if folder.is_dir() else []
    return only(folder, what, {path.name: path for path in sorted(subfolders)})


def only(folder: Path, what: str, choices: Mapping[str, T]) -> T:
    """The only candidate in a folder.

    Args:
        folder: the folder, for the error message.
        what: plural noun for the candidates, for the error message.
        choices: the candidates by name.

    Raises:
        DataError: if there is none, or more than one.
    """
    if len(choices) == 1:
        return next(iter(choices.values()))
    if not choices:
        raise DataError(folder, f"contains no {what}", hint=f"Give a folder with {what}")
    hint = f"Choose one, for example {folder.name}/{next(iter(choices))}"
    raise DataError(folder, f"contains several {what}: {', '.join(list(choices)[:30])}", hint=hint)
