"""What the formats share: numbered files, and one thing among several."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

from dynaviz.errors import DataError

T = TypeVar("T")


def holds(folder: Path, pattern: str) -> bool:
    """Whether a folder is there and holds a file of a pattern."""
    return next(folder.glob(pattern), None) is not None


def numbered(folder: Path, suffix: str) -> dict[int, Path]:
    """The files of a folder by the number that is their name, in the order of the numbers.

    Raises:
        DataError: where there is none, a name is no number, or two are the same number.
    """
    files: dict[int, Path] = {}
    for path in folder.glob(f"*{suffix}"):
        if not (path.stem.isascii() and path.stem.isdigit() and len(path.stem) < 20 and int(path.stem) < 1 << 63):
            hint = f"Name the scans 000000{suffix} and so on, and keep other {suffix} files elsewhere"
            raise DataError(path, "has a name that is no frame number", hint=hint)
        if int(path.stem) in files:
            raise DataError(path, f"has the same number as {files[int(path.stem)].name}", hint="Remove one of them")
        files[int(path.stem)] = path
    if not files:
        problem = f"has no *{suffix} files" if folder.is_dir() else "is missing"
        raise DataError(folder, problem, hint="Give the folder of a sequence")
    return dict(sorted(files.items()))


def only_folder(folder: Path, what: str) -> Path:
    """The only folder in a folder.

    Raises:
        DataError: where there is none, or a choice.
    """
    inside = [path for path in folder.iterdir() if path.is_dir()] if folder.is_dir() else []
    return only(folder, what, {path.name: path for path in sorted(inside)})


def only(folder: Path, what: str, choices: Mapping[str, T]) -> T:
    """The only one of the things in a folder, by name.

    Raises:
        DataError: where there is none, or a choice.
    """
    if len(choices) == 1:
        return next(iter(choices.values()))
    names = ", ".join(list(choices)[:30])
    problem = f"holds several {what}: {names}" if choices else f"holds no {what}"
    one = f"Give one of the {what}, as in {folder.name}/{next(iter(choices), '')}"
    raise DataError(folder, problem, hint=one if choices else f"Give a folder with {what}")
