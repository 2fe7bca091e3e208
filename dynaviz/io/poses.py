"""Read poses: KITTI (12 numbers per line), TUM (time, position, quaternion), CSV with a header, PCD
of LIO-SAM.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np

from dynaviz.arrays import F64, I64, Intp
from dynaviz.errors import DataError
from dynaviz.io.atomic import open_file
from dynaviz.io.pcd import read_pcd
from dynaviz.io.text import read_table
from dynaviz.spatial import geometry

_FORMATS = (
    "Write 12 numbers per line (KITTI, 3x4 matrix), 8 (TUM, time x y z qx qy qz qw) or 16 (4x4 "
    "matrix), "
    "or CSV with a header: stamp or index, and x y z qx qy qz qw or T00 ... T33; or PCD with x y z "
    "roll pitch yaw time"
)
_TIME = (
    r"(?:time|timestamp|time_?stamp|stamp|t|sec|secs|seconds)\s*[_\[(]*(ns|nsec|us|ms|s|sec)?[\])]?"
)
_SCALES = {"ns": 1, "nsec": 1, "us": 10**3, "ms": 10**6, "s": 10**9, "sec": 10**9}
_INDEX = r"index|idx|frame|frame_?id|scan|number|id"
_POSITION = r"(?:t|p|pos|position|trans|translation)?[_.]?([xyz])"
_ROTATION = r"(?:q|quat|quaternion|o|orientation|r|rot|rotation)[_.]?([xyzw])"
_ENTRY = r"[a-z]*_?([0-3])_?([0-3])"
# minimum number of digits of a time in ns, us, ms since 1970
_UNITS = (
    (17, 1),
    (14, 10**3),
    (11, 10**6),
)
_UNIT_NAMES = (
    (20, "picoseconds"),
    (17, "nanoseconds"),
    (14, "microseconds"),
    (11, "milliseconds"),
    (0, "seconds"),
)
_LIMIT = 1 << 63  # nanoseconds since 1970, in the year 2262
_LARGEST_NUMBER = 1 << 53  # whole numbers up to here are exact in float64
_TIME_HINT = (
    "Give times in s, ms, us or ns since 1970; in CSV state the unit in the header, such as stamp "
    "[ns]"
)


@dataclass(frozen=True, eq=False)
class PoseFile:
    """The poses of a file, in file order.

    Attributes:
        path: the file.
        kind: ``KITTI``, ``TUM``, ``4x4``, ``CSV`` or ``PCD``.
        poses: (K, 4, 4) float64, metres.
        stamps: (K,) int64, nanoseconds; None if the file has none.
        numbers: (K,) int64, scan number of each pose; None if the file has none.
        lidar: (K,) int64, number of the lidar of each pose; None if the file has none.
    """

    path: Path
    kind: str
    poses: F64
    stamps: I64 | None = None
    numbers: I64 | None = None
    lidar: I64 | None = None

    def __len__(self) -> int:
        return len(self.poses)

    @property
    def lidars(self) -> dict[int, Intp]:
        """Rows of each lidar, by its number.

        All rows as those of lidar 0 if the file does not tell lidars apart.
        """
        lidar = np.zeros(len(self), np.int64) if self.lidar is None else self.lidar
        return {number: np.flatnonzero(lidar == number) for number in np.unique(lidar).tolist()}


def read_poses(path: str | os.PathLike[str]) -> PoseFile:
    """Read a pose file. The format is detected from the first line.

    Raises:
        DataError: if the file cannot be read, or a line has a different length or is not a pose;
            names the line.
    """
    path = Path(path)
    if path.suffix.lower() == ".pcd":
        return _pcd(path)
    with open_file(path, _FORMATS) as file:
        lines = [(n, line.decode("latin-1").strip()) for n, line in enumerate(file, 1)]
    lines = [(n, line) for n, line in lines if line]
    first = lines[0][1] if lines else ""
    if "," in first and re.search(r"[a-df-zA-DF-Z]", first):
        return _csv(path, first.lstrip("# "), lines[1:])
    rows = [(n, re.split(r"[\s,;]+", line)) for n, line in lines if not line.startswith("#")]
    if not rows:
        raise DataError(path, "contains no poses", hint=_FORMATS)
    columns = len(rows[0][1])
    if columns == 8:
        return PoseFile(path, "TUM", _quaternions(path, rows, range(1, 8)), _stamps(path, rows, 0))
    if columns in (12, 16):
        return PoseFile(path, "KITTI" if columns == 12 else "4x4", _matrices(path, rows, range(12)))
    raise DataError(
        path,
        f"unknown pose format with {columns} values per line",
        at=f"line {rows[0][0]}",
        hint=_FORMATS,
    )


def find_poses(folder: Path) -> Path | None:
    """The pose file of a folder, found by the usual names.

    ``poses.*``, ``trajectory.*``, ..., or any ``*.tum``.

    Raises:
        DataError: if there are several.
    """
    usual = (
        "poses.txt",
        "poses.tum",
        "poses.csv",
        "pose.txt",
        "pose.csv",
        "trajectory.txt",
        "trajectory.tum",
        "trajectory.csv",
        "traj.txt",
        "traj.tum",
        "traj.csv",
        "groundtruth.txt",
    )
    found = sorted(
        set(folder.glob("*.tum")) | {folder / name for name in usual if (folder / name).is_file()}
    )
    if len(found) > 1:
        names = ", ".join(path.name for path in found)
        raise DataError(folder, f"several pose files: {names}", hint="Choose one with --poses FILE")
    return found[0] if found else None


def nanoseconds(text: str, scale: int | None = None) -> int:
    """Parse a time into nanoseconds.

    Args:
        text: a decimal number.
        scale: nanoseconds per unit. None detects seconds, or ms, us or ns since 1970, by the number
            of digits.

    Raises:
        ValueError: if the text is not a finite number, or a time that 64 bits cannot store in
            nanoseconds.
    """
    try:
        value = Decimal(text)
    except ArithmeticError:
        raise ValueError(f"{text[:20]!r} is not a time") from None
    if not (value.is_finite() and -1e11 < value < 1e30):
        raise ValueError(f"{text[:20]!r} is not a time")
    digits = value.adjusted() + 1
    unit = scale or next((unit for min_digits, unit in _UNITS if digits >= min_digits), 10**9)
    if abs(stamp := round(value * unit)) >= _LIMIT:
        named = next(name for name, per_unit in _SCALES.items() if per_unit == unit)
        likely = next(name for min_digits, name in _UNIT_NAMES if digits >= min_digits)
        raise ValueError(
            f"{text[:30]} {named} is after the year 2262; {digits} digits suggest {likely} since "
            "1970"
        )
    return stamp


Rows = list[tuple[int, list[str]]]


def _pcd(path: Path) -> PoseFile:
    """A point per pose, with roll, pitch and yaw in radians (about x, then y, then z) and time, as
    LIO-SAM writes.
    """
    from scipy.spatial.transform import Rotation

    rows = read_pcd(path)
    table = np.column_stack(
        [rows[name].astype(np.float64) for name in ("x", "y", "z", "roll", "pitch", "yaw")]
    )
    if not len(table) or not np.isfinite(table).all():
        raise DataError(
            path, "contains no poses" if not len(table) else "a value is not finite", hint=_FORMATS
        )
    poses = np.tile(np.eye(4), (len(table), 1, 1))
    poses[:, :3, 3] = table[:, :3]
    poses[:, :3, :3] = Rotation.from_euler("xyz", table[:, 3:]).as_matrix()
    times = (
        [(number, [repr(time)]) for number, time in enumerate(rows["time"].tolist(), 1)]
        if "time" in rows
        else None
    )
    return PoseFile(path, "PCD", poses, None if times is None else _stamps(path, times, 0))


def _csv(path: Path, header: str, lines: list[tuple[int, str]]) -> PoseFile:
    """Find the columns by name, in any order; other columns are ignored."""
    titles = [name.strip().strip("\"'").lower() for name in header.split(",")]
    names = [re.sub(r"\s*[\[(].*", "", title) for title in titles]
    rows = [
        (n, [word.strip() for word in line.split(",")])
        for n, line in lines
        if not line.startswith("#")
    ]
    for n, words in rows:
        if len(words) != len(names):
            raise DataError(
                path,
                f"{len(words)} values, but the header has {len(names)} columns",
                at=f"line {n}",
                hint=_FORMATS,
            )

    def columns(pattern: str, keys: list[str]) -> list[int] | None:
        """Positions of the columns that match a pattern with these keys; None if any is missing."""
        found = {
            "".join(match.groups()): k
            for k, name in enumerate(names)
            if (match := re.fullmatch(pattern, name))
        }
        return [found[key] for key in keys] if all(key in found for key in keys) else None

    position = columns(_POSITION, [*"xyz"])
    rotation = columns(_ROTATION, [*"xyzw"])
    matrix = columns(_ENTRY, [f"{row}{column}" for row in range(3) for column in range(4)])
    time = next(
        ((k, match[1]) for k, title in enumerate(titles) if (match := re.fullmatch(_TIME, title))),
        None,
    )
    index = next((k for k, name in enumerate(names) if re.fullmatch(_INDEX, name)), None)
    if not rows or not (matrix or (position and rotation)):
        problem = f"the header has no pose columns: {header[:80]}" if rows else "contains no poses"
        raise DataError(path, problem, at="line 1", hint=_FORMATS)
    poses = (
        _matrices(path, rows, matrix)
        if matrix
        else _quaternions(path, rows, [*(position or []), *(rotation or [])])
    )
    stamps = None if time is None else _stamps(path, rows, time[0], _SCALES.get(time[1]))
    numbers = None if index is None else _numbers(path, rows, index)
    lidar = _numbers(path, rows, names.index("lidar")) if "lidar" in names else None
    return PoseFile(path, "CSV", poses, stamps, numbers, lidar)


def _floats(path: Path, rows: Rows, columns: range | list[int]) -> F64:
    """(rows, columns) float64, all finite."""
    table = np.empty((len(rows), len(columns)))
    for k, (n, words) in enumerate(rows):
        try:
            if len(words) != len(rows[0][1]):
                raise ValueError(f"{len(words)} values, but the first line has {len(rows[0][1])}")
            table[k] = [float(words[column]) for column in columns]
            if not np.isfinite(table[k]).all():
                raise ValueError("a value is not finite")
        except ValueError as error:
            raise DataError(
                path, f"not a valid pose ({error})", at=f"line {n}", hint=_FORMATS
            ) from None
    return table


def _stamps(path: Path, rows: Rows, column: int, scale: int | None = None) -> I64:
    stamps = np.empty(len(rows), np.int64)
    for k, (n, words) in enumerate(rows):
        try:
            stamps[k] = nanoseconds(words[column], scale)
        except ValueError as error:
            raise DataError(
                path, f"not a valid time ({error})", at=f"line {n}", hint=_TIME_HINT
            ) from None
    return stamps


def _numbers(path: Path, rows: Rows, column: int) -> I64:
    """Numbers of scans."""
    numbers = _floats(path, rows, [column])[:, 0]
    for number, (n, words) in zip(numbers, rows, strict=True):
        if abs(number) >= _LARGEST_NUMBER:
            raise DataError(
                path,
                f"not a valid scan number ({words[column][:30]})",
                at=f"line {n}",
                hint=_FORMATS,
            )
    return numbers.astype(np.int64)


def _quaternions(path: Path, rows: Rows, columns: range | list[int]) -> F64:
    """Poses from the columns x y z qx qy qz qw."""
    table = _floats(path, rows, columns)
    poses = np.empty((len(rows), 4, 4))
    for k, (x, y, z, qx, qy, qz, qw) in enumerate(table):
        try:
            poses[k] = geometry.pose((x, y, z), (qw, qx, qy, qz))
        except ValueError as error:
            raise DataError(
                path, f"not a valid pose ({error})", at=f"line {rows[k][0]}", hint=_FORMATS
            ) from None
    return poses


def _matrices(path: Path, rows: Rows, columns: range | list[int]) -> F64:
    """Poses from the columns of 3x4 matrices, row by row."""
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3] = _floats(path, rows, columns).reshape(-1, 3, 4)
    if (invalid := _first_invalid_rotation(poses)) is not None:
        problem = (
            geometry.rotation_problem(poses[invalid, :3, :3]) or "the matrix is not a rotation"
        )
        raise DataError(path, problem, at=f"line {rows[invalid][0]}", hint=_FORMATS)
    return poses


def _first_invalid_rotation(poses: F64) -> int | None:
    """Index of the first of (N, 4, 4) poses whose matrix scales, shears or mirrors.

    None if all are rotations.
    """
    R = poses[:, :3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.abs(geometry.compose(R, np.swapaxes(R, 1, 2)) - np.eye(3)).max((1, 2))
        invalid = ~(error <= 0.02) | ~(np.linalg.det(R) > 0)
    return int(np.argmax(invalid)) if invalid.any() else None


def read_kitti_poses(path: str | os.PathLike[str]) -> F64:
    """Read KITTI's ``poses.txt``.

    Returns:
        (lines, 4, 4) float64, metres; T_world_camera for KITTI's own files.

    Raises:
        DataError: if the file cannot be read, or a line does not have 12 numbers or a valid
            rotation.
    """
    hint = "Each line needs 12 numbers, a 3x4 matrix of rotation and position"
    poses = np.tile(np.eye(4), (len(table := read_table(path, 12, hint)), 1, 1))
    poses[:, :3] = table.reshape(-1, 3, 4)
    if (invalid := _first_invalid_rotation(poses)) is not None:
        raise DataError(
            path, "the matrix is not a rotation", at=f"row {invalid}, counted from 0", hint=hint
        )
    return poses
