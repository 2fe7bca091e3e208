"""Text files of poses: KITTI's (12 numbers a line), TUM's (time, position, quaternion), and CSV with a header."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np

from dynaviz.arrays import F64, I64
from dynaviz.errors import DataError
from dynaviz.io.atomic import opened
from dynaviz.io.text import read_table
from dynaviz.spatial import geometry

_FORMATS = (
    "A line has 12 numbers (KITTI: three rows of a matrix), 8 (TUM: time x y z qx qy qz qw), 16 (a 4x4 matrix), "
    "or values under a CSV header with a stamp or index, x y z, qx qy qz qw or T00 ... T33"
)
_TIME = r"(?:time|timestamp|time_?stamp|stamp|t|sec|secs|seconds)\s*[_\[(]*(ns|nsec|us|ms|s|sec)?[\])]?"
_SCALES = {"ns": 1, "nsec": 1, "us": 10**3, "ms": 10**6, "s": 10**9, "sec": 10**9}
_INDEX = r"index|idx|frame|frame_?id|scan|number|id"
_POSITION = r"(?:t|p|pos|position|trans|translation)?[_.]?([xyz])"
_ROTATION = r"(?:q|quat|quaternion|o|orientation|r|rot|rotation)[_.]?([xyzw])"
_ENTRY = r"[a-z]*_?([0-3])_?([0-3])"
_UNITS = ((17, 1), (14, 10**3), (11, 10**6))  # digits from which a whole number counts ns, us, ms since 1970


@dataclass(frozen=True, eq=False)
class PoseFile:
    """The poses of a file, in its order.

    Attributes:
        path: the file.
        kind: ``KITTI``, ``TUM``, ``4x4`` or ``CSV``.
        poses: (K, 4, 4) float64, metres.
        stamps: (K,) int64, nanoseconds; None where the file has none.
        numbers: (K,) int64, the scan's number of each pose; None where the file has none.
    """

    path: Path
    kind: str
    poses: F64
    stamps: I64 | None = None
    numbers: I64 | None = None

    def __len__(self) -> int:
        return len(self.poses)


def read_poses(path: str | os.PathLike[str]) -> PoseFile:
    """Read a file of poses in any of the formats; its first line tells which.

    Raises:
        DataError: for a file that cannot be read, a line of another length, or one that is no pose; it names the line.
    """
    path = Path(path)
    with opened(path, _FORMATS) as file:
        lines = [(n, line.decode("latin-1").strip()) for n, line in enumerate(file, 1)]
    lines = [(n, line) for n, line in lines if line]
    first = lines[0][1] if lines else ""
    if "," in first and re.search(r"[a-df-zA-DF-Z]", first):
        return _csv(path, first.lstrip("# "), lines[1:])
    rows = [(n, re.split(r"[\s,;]+", line)) for n, line in lines if not line.startswith("#")]
    if not rows:
        raise DataError(path, "holds no pose", hint=_FORMATS)
    columns = len(rows[0][1])
    if columns == 8:
        return PoseFile(path, "TUM", _quaternions(path, rows, range(1, 8)), _stamps(path, rows, 0))
    if columns in (12, 16):
        return PoseFile(path, "KITTI" if columns == 12 else "4x4", _matrices(path, rows, range(12)))
    raise DataError(path, f"has {columns} words in its first line", at=f"line {rows[0][0]}", hint=_FORMATS)


def find_poses(folder: Path) -> Path | None:
    """The file of poses in a folder by its usual names: ``poses.*``, ``trajectory.*``, else the only ``*.tum``.

    Raises:
        DataError: where there are several.
    """
    usual = ("poses.txt", "poses.tum", "poses.csv", "pose.txt", "pose.csv", "trajectory.txt", "trajectory.tum",
             "trajectory.csv", "traj.txt", "traj.tum", "traj.csv", "groundtruth.txt")  # fmt: skip
    found = sorted(set(folder.glob("*.tum")) | {folder / name for name in usual if (folder / name).is_file()})
    if len(found) > 1:
        names = ", ".join(path.name for path in found)
        raise DataError(folder, f"holds several files of poses: {names}", hint="Choose one with --poses FILE")
    return found[0] if found else None


def nanoseconds(text: str, scale: int | None = None) -> int:
    """A time as people write it.

    Args:
        text: a decimal number.
        scale: nanoseconds a count; None for seconds, or ms, us or ns since 1970, told apart by the number of digits.

    Raises:
        ValueError: for what is no finite number.
    """
    try:
        value = Decimal(text)
        if not -1e11 < value < 1e20:  # also what is no number
            raise ArithmeticError
        digits = value.adjusted() + 1
        return round(value * (scale or next((unit for least, unit in _UNITS if digits >= least), 10**9)))
    except ArithmeticError:
        raise ValueError(f"{text[:20]!r} is no time") from None


Rows = list[tuple[int, list[str]]]


def _csv(path: Path, header: str, lines: list[tuple[int, str]]) -> PoseFile:
    """Columns are found by their names, in any order; what else there is does not matter."""
    titles = [name.strip().strip("\"'").lower() for name in header.split(",")]
    names = [re.sub(r"\s*[\[(].*", "", title) for title in titles]
    rows = [(n, [word.strip() for word in line.split(",")]) for n, line in lines if not line.startswith("#")]
    for n, words in rows:
        if len(words) != len(names):
            raise DataError(
                path, f"has {len(words)} values, where the header has {len(names)}", at=f"line {n}", hint=_FORMATS
            )

    def columns(pattern: str, keys: list[str]) -> list[int] | None:
        """Where the columns are that a pattern names by these keys, all of them or none."""
        found = {"".join(match.groups()): k for k, name in enumerate(names) if (match := re.fullmatch(pattern, name))}
        return [found[key] for key in keys] if all(key in found for key in keys) else None

    position, rotation = columns(_POSITION, [*"xyz"]), columns(_ROTATION, [*"xyzw"])
    matrix = columns(_ENTRY, [f"{row}{column}" for row in range(3) for column in range(4)])
    time = next(((k, match[1]) for k, title in enumerate(titles) if (match := re.fullmatch(_TIME, title))), None)
    index = next((k for k, name in enumerate(names) if re.fullmatch(_INDEX, name)), None)
    if not rows or not (matrix or (position and rotation)):
        problem = "holds no pose" if not rows else f"has a header without a pose: {header[:80]}"
        raise DataError(path, problem, at="line 1", hint=_FORMATS)
    poses = (
        _matrices(path, rows, matrix) if matrix else _quaternions(path, rows, [*(position or []), *(rotation or [])])
    )
    stamps = None if time is None else _stamps(path, rows, time[0], _SCALES.get(time[1]))
    numbers = None if index is None else _floats(path, rows, [index])[:, 0].astype(np.int64)
    return PoseFile(path, "CSV", poses, stamps, numbers)


def _floats(path: Path, rows: Rows, columns: range | list[int]) -> F64:
    """(rows, columns) float64, all finite."""
    table = np.empty((len(rows), len(columns)))
    for k, (n, words) in enumerate(rows):
        try:
            if len(words) != len(rows[0][1]):
                raise ValueError(f"{len(words)} words, where the first line has {len(rows[0][1])}")
            table[k] = [float(words[column]) for column in columns]
            if not np.isfinite(table[k]).all():
                raise ValueError("a number that is not finite")
        except ValueError as error:
            raise DataError(path, f"is no pose ({error})", at=f"line {n}", hint=_FORMATS) from None
    return table


def _stamps(path: Path, rows: Rows, column: int, scale: int | None = None) -> I64:
    stamps = np.empty(len(rows), np.int64)
    for k, (n, words) in enumerate(rows):
        try:
            stamps[k] = nanoseconds(words[column], scale)
        except (ValueError, OverflowError) as error:
            raise DataError(path, f"has no time ({error})", at=f"line {n}", hint=_FORMATS) from None
    return stamps


def _quaternions(path: Path, rows: Rows, columns: range | list[int]) -> F64:
    """Poses of the columns x y z qx qy qz qw."""
    table = _floats(path, rows, columns)
    poses = np.empty((len(rows), 4, 4))
    for k, (x, y, z, qx, qy, qz, qw) in enumerate(table):
        try:
            poses[k] = geometry.pose((x, y, z), (qw, qx, qy, qz))
        except ValueError as error:
            raise DataError(path, f"is no pose ({error})", at=f"line {rows[k][0]}", hint=_FORMATS) from None
    return poses


def _matrices(path: Path, rows: Rows, columns: range | list[int]) -> F64:
    """Poses of the columns of three rows of a matrix."""
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3] = _floats(path, rows, columns).reshape(-1, 3, 4)
    if (wrong := _no_rotation(poses)) is not None:
        raise DataError(path, "has a matrix that is no rotation", at=f"line {rows[wrong][0]}", hint=_FORMATS)
    return poses


def _no_rotation(poses: F64) -> int | None:
    """The first of (N, 4, 4) poses that does not turn, but stretches or mirrors; None where all turn."""
    R = poses[:, :3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        off = np.abs(geometry.compose(R, np.swapaxes(R, 1, 2)) - np.eye(3)).max((1, 2))
        wrong = ~(off <= 0.02) | ~(np.linalg.det(R) > 0)
    return int(np.argmax(wrong)) if wrong.any() else None


def read_kitti_poses(path: str | os.PathLike[str]) -> F64:
    """Read KITTI's ``poses.txt``.

    Returns:
        (lines, 4, 4) float64, metres; T_world_camera for KITTI's own files.

    Raises:
        DataError: for a file that cannot be read, a line without 12 numbers, or with a matrix that is no rotation.
    """
    hint = "A line of poses has 12 numbers: three rows of a matrix, a rotation and a position"
    poses = np.tile(np.eye(4), (len(table := read_table(path, 12, hint)), 1, 1))
    poses[:, :3] = table.reshape(-1, 3, 4)
    if (wrong := _no_rotation(poses)) is not None:
        raise DataError(path, "has a matrix that is no rotation", at=f"row {wrong}, counted from 0", hint=hint)
    return poses
