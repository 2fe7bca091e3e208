"""Point clouds as text: a point per line, with or without a line of titles.

Titles name the columns. Without them, the columns are x y z, then intensity or colours, if the
numbers allow no other reading.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F64
from dynaviz.errors import DataError
from dynaviz.io.atomic import open_file

SUFFIXES = (".xyz", ".asc", ".txt", ".csv")
COLOURS = ("red", "green", "blue")
_HINT = "Name the columns in the first line, such as x,y,z,intensity,time"
_BRIGHTEST = 255
_FARTHEST = 1e8  # metres; larger numbers are no coordinates
_TITLES = {
    "r": "red",
    "g": "green",
    "b": "blue",
    "i": "intensity",
    "reflectance": "intensity",
    "remission": "intensity",
}


def read_text_fields(path: str | os.PathLike[str]) -> dict[str, NDArray[Any]]:
    """Read all columns.

    Returns:
        (N,) float64 by name: x, y and z in metres, and the others by their titles, or as in
        ``names_of``.

    Raises:
        DataError: if the file cannot be read, a line is no point, or nobody can tell what the
            columns hold; names the line.
    """
    path = Path(path)
    with open_file(path, _HINT) as file:
        lines = file.read().decode("latin-1").splitlines()
    titles, skipped = _titles(lines)
    rows = _rows(path, lines, skipped)
    names = titles or names_of(path, rows)
    if len(names) != rows.shape[1]:
        raise DataError(
            path,
            f"{rows.shape[1]} numbers per line, but {len(names)} titles ({', '.join(names)})",
            at=f"line {skipped + 1}",
            hint=_HINT,
        )
    return {name: rows[:, k] for k, name in enumerate(names)}


def is_text_cloud(path: Path) -> bool:
    """Whether the first lines of a text file are points: three numbers or more.

    Times and labels have fewer columns, and matrices more. Without titles, eight columns are a time
    and a pose, and seven are a pose if the last number is that of a quaternion.
    """
    try:
        with path.open("rb") as file:
            lines = file.read(4096).decode("latin-1").splitlines()
    except OSError:
        return False
    titles, skipped = _titles(lines)
    shown = [_words(line) for line in lines[skipped : skipped + 3]]
    numbers = all(_is_number(word) for words in shown for word in words)
    if len(shown) < 3 or not numbers or "qw" in titles:
        return False
    columns = {len(words) for words in shown}
    posed = columns == {8} or (columns == {7} and all(abs(float(w[6])) <= 1.0 for w in shown))
    return len(columns) == 1 and 3 <= min(columns) < 12 and bool(titles or not posed)


def names_of(path: Path, rows: F64) -> list[str]:
    """The names of columns without titles.

    Three are x y z; a fourth is intensity; three more of whole numbers up to 255 are colours.

    Raises:
        DataError: for fewer columns, for others, or if the first one counts points or is a time.
    """
    number = rows.shape[1]
    coordinates = rows[:, :3]
    known = {3: [], 4: ["intensity"], 6: [*COLOURS], 7: ["intensity", *COLOURS]}
    steps = np.diff(rows[:, 0])
    counts = len(steps) > 1 and bool((steps > 0).all()) and bool(np.ptp(steps) < 1e-6)
    bright = rows[:, -3:]
    colours = number < 6 or bool(
        ((bright >= 0) & (bright <= _BRIGHTEST) & (bright == np.round(bright))).all()
    )
    far = bool((np.abs(coordinates[np.isfinite(coordinates)]) > _FARTHEST).any())
    if number not in known or counts or far or not colours:
        why = "the first one counts points or is a time" if counts or far else f"there are {number}"
        raise DataError(path, f"cannot tell what its columns hold: {why}", hint=_HINT)
    return [*"xyz", *known[number]]


def _titles(lines: list[str]) -> tuple[list[str], int]:
    """The titles, and the number of lines before the first point.

    Lines before it may be comments, titles, or the number of points.
    """
    titles: list[str] = []
    for number, line in enumerate(lines):
        words = _words(line.lstrip("#/ "))
        if len(words) >= 3 and all(_is_number(word) for word in words) and line[:1] not in "#/":
            return titles, number
        named = [_TITLES.get(word.lower(), word.lower()) for word in words]
        if {"x", "y", "z"} <= set(named):
            titles = named
    return titles, len(lines)


def _rows(path: Path, lines: list[str], skipped: int) -> F64:
    """(N, columns) float64."""
    points = [line for line in lines[skipped:] if line.strip() and line[:1] not in "#/"]
    if not points:
        raise DataError(path, "contains no points", hint=_HINT)
    separator = next((each for each in (",", ";") if each in points[0]), None)
    try:
        table: F64 = np.loadtxt(points, np.float64, comments=None, delimiter=separator, ndmin=2)
    except ValueError as error:
        columns = len(_words(points[0]))
        wrong = next((k for k, x in enumerate(lines[skipped:]) if not _is_point(x, columns)), 0)
        raise DataError(
            path,
            f"not a point ({str(error).partition(';')[0][:80]})",
            at=f"line {skipped + wrong + 1}",
            hint=_HINT,
        ) from None
    return table


def _is_point(line: str, columns: int) -> bool:
    words = _words(line)
    return not words or (len(words) == columns and all(_is_number(word) for word in words))


def _words(line: str) -> list[str]:
    words = re.split(r"[,;]\s*|\s+", line.strip())
    return [word.strip("\"'") for word in words if word]


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
