"""Labels that another program wrote, one file per scan, as moving object segmentation networks
write them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynaviz.contracts.method import Context, Labels, MethodInfo, Reason
from dynaviz.contracts.scan import Scan
from dynaviz.errors import DataError
from dynaviz.io.scan_labels import SUFFIXES, read_moving
from dynaviz.sources.drive import Drive

_STATIC, _MOVING, _UNANSWERED = range(3)
UNANSWERED = "unanswered"
"""Reason of points whose scan has no labels."""
_REASONS = (
    Reason("labelled_static", "kept: static in its label file"),
    Reason("labelled_moving", "removed: moving in its label file"),
    Reason(UNANSWERED, "kept and not scored: its scan has no label file"),
)
_LAYOUT = (
    "Give a folder with a .label, .npy or .npz file for each scan, named by frame number "
    "(000000.label)"
)


@dataclass(frozen=True)
class NoParams:
    """Labels by index have no parameters."""


class LabelFolder:
    """Labels from a folder with one file per scan (``dynaviz.io.scan_labels``), by frame number.

    Scans without a file are unanswered: their points are kept and not scored.

    Args:
        path: the folder with the files; or one that contains them in ``predictions`` or
            ``sequences/NN/predictions``, of which the sequence's is used.
        name: for tables.
        sequence: the sequence that they label.
        key: name of the array in ``.npz`` files with several.

    Raises:
        DataError: if there are no such files, two for one frame, none for any frame, or if the
            first or the last frame cannot be read.
    """

    scoring = "mask"

    def __init__(self, path: Path, name: str, sequence: Drive, key: str | None = None) -> None:
        self.path = _folder(path, sequence.name)
        self.params = NoParams()
        self._key = key
        self.files = _numbered(self.path)
        self.info = MethodInfo(
            name, f"{name} (labels)", f"another program, which wrote {path.name}", _REASONS
        )
        ends = sequence[0], sequence[len(sequence) - 1]
        first, last = (scan.index for scan in ends)
        if not any(first <= number <= last for number in self.files):
            numbers = f"{min(self.files)} to {max(self.files)}"
            problem = (
                f"labels the frames {numbers}, but {sequence.name} has the frames {first} to {last}"
            )
            raise DataError(self.path, problem, hint="Name each file by the number of its frame")
        for scan in ends:  # before anything is written: most mistakes are in every file
            self.label(scan)

    def begin(self, context: Context) -> None:
        """Nothing to prepare."""

    def label(self, scan: Scan) -> Labels:
        """The labels in the scan's file; no answer if it has none.

        Raises:
            DataError: if the file cannot be read, or has a different number of points.
        """
        if scan.index not in self.files:
            return Labels(
                np.zeros(len(scan), np.bool_),
                np.full(len(scan), _UNANSWERED, np.uint8),
                answered=False,
            )
        moving = read_moving(self.files[scan.index], len(scan), self._key)
        return Labels(moving, np.where(moving, _MOVING, _STATIC).astype(np.uint8))


def _folder(path: Path, sequence: str) -> Path:
    """The folder that contains the files: the path itself, or one below it."""
    if any(_files(path)):
        return path
    several = sorted([*path.glob("sequences/*/predictions"), *path.glob("*/predictions")])
    folders = [path / "predictions"] if (path / "predictions").is_dir() else several
    own = [folder for folder in folders if folder.parent.name in sequence.split("_")]
    chosen = own if len(folders) > 1 else folders
    if len(chosen) == 1:
        return chosen[0]
    found = ", ".join(str(folder.relative_to(path)) for folder in folders[:30])
    problem = (
        f"contains several folders with labels: {found}" if found else "contains no label files"
    )
    raise DataError(path, problem, hint="Give one of them" if found else _LAYOUT)


def _files(folder: Path) -> Iterator[Path]:
    """The label files of a folder: a known format, and a number for a name."""
    try:
        entries = sorted(folder.iterdir())
    except OSError as error:
        raise DataError(folder, error.strerror or "cannot be read", hint=_LAYOUT) from None
    for path in entries:
        if (
            path.suffix in SUFFIXES
            and path.stem.isascii()
            and path.stem.isdigit()
            and len(path.stem) < 19
        ):
            yield path


def _numbered(folder: Path) -> dict[int, Path]:
    """The label files of a folder by frame number."""
    files: dict[int, Path] = {}
    for path in _files(folder):
        if other := files.get(int(path.stem)):
            raise DataError(
                path, f"labels the same frame as {other.name}", hint="Keep one file per frame"
            )
        files[int(path.stem)] = path
    if not files:
        raise DataError(folder, "contains no label files", hint=_LAYOUT)
    return files
