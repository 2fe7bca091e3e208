"""Read poses: KITTI (12 numbers per line), TUM (time, position, quaternion), CSV with a header, PCD
of LIO-SAM, graphs of g2o, Boreas.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from dynaviz.arrays import F64, I64, Intp
from dynaviz.errors import DataError
from dynaviz.io.atomic import open_file
from dynaviz.io.pcd import read_pcd
from dynaviz.io.text import read_table
from dynaviz.spatial import geometry

_FORMATS = (
    "Write 12 numbers per line (KITTI, 3x4 matrix), 8 (TUM, time x y z qx qy qz qw) or 16 (4x4 "
    "matrix), 7 (position and quaternion) or 13 (index and 3x4 matrix), "
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
_RANKS = (
    (
        "optimized_poses.txt",
        "optimized_pose.txt",
        "optimized_poses.tum",
        "poses_optimized.*",
        "*_optimized.txt",
        "optimized_trajectory.*",
    ),
    (
        "*.tum",
        "poses.txt",
        "poses.csv",
        "pose.txt",
        "pose.csv",
        "pose.json",
        "poses.json",
        "trajectory.txt",
        "trajectory.csv",
        "traj.txt",
        "traj.csv",
        "groundtruth.txt",
        "transformations.pcd",
        "alidarPose.csv",
        "cam0_to_world.txt",
        "lidar_poses.csv",
        "applanix/lidar_poses.csv",
    ),
    ("odom_poses.txt", "odometry_poses.txt", "odom.txt", "odometry.txt", "*.g2o"),
)  # of names of pose files, the better ones first
W_LAST = "qx qy qz qw"
W_FIRST = "qw qx qy qz"
UPRIGHT = 0.5  # cosine between axes of the sensor and up, and the way ahead, at least
MOST = 0.9  # share of the poses
_TEXTS = (".txt", ".csv", ".json", ".tum", ".g2o", ".dat", ".log", ".traj")
_LARGEST_FILE = 100_000_000  # bytes
_LIMIT = 1 << 63  # nanoseconds since 1970, in the year 2262
_LARGEST_NUMBER = 1 << 53  # whole numbers up to here are exact in float64
_TIME_HINT = (
    "Give times in s, ms, us or ns since 1970; in CSV state the unit in the header, such as stamp "
    "[ns]"
)


Rows = list[tuple[int, list[str]]]


@dataclass(frozen=True, eq=False)
class PoseFile:
    """The poses of a file, in file order.

    Attributes:
        path: the file.
        kind: ``KITTI``, ``TUM``, ``4x4``, ``CSV``, ``PCD`` ...
        poses: (K, 4, 4) float64, metres.
        stamps: (K,) int64, nanoseconds; None if the file has none.
        numbers: (K,) int64, scan number of each pose; None if the file has none.
        lidar: (K,) int64, number of the lidar of each pose; None if the file has none.
        readings: (K, 4, 4) by name, if the file does not say what its numbers mean; ``poses`` is
            the first of them.
    """

    path: Path
    kind: str
    poses: F64
    stamps: I64 | None = None
    numbers: I64 | None = None
    lidar: I64 | None = None
    readings: Mapping[str, F64] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.poses)

    @property
    def lidars(self) -> dict[int, Intp]:
        """Rows of each lidar, by its number.

        All rows as those of lidar 0 if the file does not tell lidars apart.
        """
        lidar = np.zeros(len(self), np.int64) if self.lidar is None else self.lidar
        return {number: np.flatnonzero(lidar == number) for number in np.unique(lidar).tolist()}

    def most_upright(self) -> tuple[str, PoseFile]:
        """The only reading in which sensors are upright, and its name; otherwise the first one,
        without a name.
        """
        upright = {name: each for name, each in self.readings.items() if _upright(each)}
        if len(upright) != 1:
            return "", self
        name = next(iter(upright))
        return name, replace(self, poses=upright[name], readings={})


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
    if first[:1] in "[{" and first and (found := _json(path)) is not None:
        return found
    if first.startswith(("VERTEX", "EDGE", "FIX")):
        return _graph(path, lines)
    if re.search(r"[a-df-zA-DF-Z]", first) and not first.startswith("#"):
        separator = "," if "," in first else None
        return _csv(path, first, lines[1:], separator)
    titles = first.lstrip("# ")
    if "," in first and re.search(r"[a-df-zA-DF-Z]", first):
        return _csv(path, titles, lines[1:], ",")
    rows = [(n, re.split(r"[\s,;]+", line)) for n, line in lines if not line.startswith("#")]
    if not rows:
        raise DataError(path, "contains no poses", hint=_FORMATS)
    return _numbers_only(path, rows, _w_first(titles))


def _w_first(titles: str) -> bool:
    """Whether a comment that names the columns places qw before qx."""
    words = re.split(r"[\s,;]+", titles.lower())
    return "qw" in words and "qx" in words and words.index("qw") < words.index("qx")


def _numbers_only(path: Path, rows: Rows, w_first: bool) -> PoseFile:
    """Poses of a file without titles, by the number of its columns."""
    columns = len(rows[0][1])
    if columns == 8:
        order = _order(range(1, 8), w_first)
        poses = _quaternions(path, rows, order)
        readings = {}
        if not w_first and _may_be_w_first(poses):
            first = _quaternions(path, rows, _order(range(1, 8), True))
            readings = {W_LAST: poses, W_FIRST: first}
        return PoseFile(path, "TUM", poses, _stamps(path, rows, 0), readings=readings)
    if columns == 7:
        readings = {
            name: _quaternions(path, rows, _order(range(7), first))
            for name, first in ((W_LAST, False), (W_FIRST, True))
        }
        if w_first:
            readings = {W_FIRST: readings[W_FIRST]}
        return PoseFile(
            path, "position and quaternion", next(iter(readings.values())), readings=readings
        )
    if columns in (12, 16):
        return PoseFile(path, "KITTI" if columns == 12 else "4x4", _matrices(path, rows, range(12)))
    if columns in (13, 17):
        poses = _matrices(path, rows, range(1, 13))
        counted = all(word[0].lstrip("-").isdigit() and len(word[0]) < 10 for _, word in rows)
        if counted:
            return PoseFile(path, "index and matrix", poses, None, _numbers(path, rows, 0))
        return PoseFile(path, "time and matrix", poses, _stamps(path, rows, 0))
    if columns == 4 and len(rows) == 4 and _last_row(rows):
        flat = [(rows[0][0], [word for _, words in rows for word in words])]
        return PoseFile(path, "4x4", _matrices(path, flat, range(12)))
    raise DataError(
        path,
        f"unknown pose format with {columns} values per line",
        at=f"line {rows[0][0]}",
        hint=_FORMATS,
    )


def _may_be_w_first(poses: F64) -> bool:
    """Whether quaternions that were read with w last, as TUM states, may have w first.

    A sensor that is upright and looks where it goes is read rightly: with the other order, it would
    lie on its back or drive backwards.

    Args:
        poses: (N, 4, 4), metres, read with w last.
    """
    steps = np.diff(poses[:, :3, 3], axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    moving = lengths > max(0.02, 0.1 * float(np.median(lengths))) if len(lengths) else lengths > 0
    if not moving.any() or not _upright(poses):
        return True
    forwards = (steps * poses[:-1, :3, 0]).sum(1)[moving] / lengths[moving]
    return float(np.median(forwards)) < UPRIGHT


def _upright(poses: F64) -> bool:
    """Whether the z axes of nearly all poses (N, 4, 4) point up."""
    return bool((poses[:, 2, 2] > UPRIGHT).mean() >= MOST)


def _last_row(rows: Rows) -> bool:
    """Whether the fourth line is that of a matrix, 0 0 0 1."""
    try:
        return [float(word) for word in rows[3][1]] == [0.0, 0.0, 0.0, 1.0]
    except ValueError:
        return False


def _order(columns: range, w_first: bool) -> list[int]:
    """The columns x y z qx qy qz qw, if they are in this order or have qw before qx."""
    given = list(columns)
    return [*given[:3], *given[4:], given[3]] if w_first else given


def find_poses(folder: Path) -> Path | None:
    """The pose file of a folder, found by the usual names.

    Poses of a SLAM system after loop closure, ``optimized_poses.txt`` and its kin, come first, then
    ``poses.*``, ``trajectory.*``, ..., or any ``*.tum``, then those of its odometry.

    Raises:
        DataError: if there are several of the same rank.
    """
    for names in _RANKS:
        found = {path for pattern in names for path in folder.glob(pattern) if path.is_file()}
        if len(found) > 1:
            shown = ", ".join(path.name for path in sorted(found))
            raise DataError(
                folder, f"several pose files: {shown}", hint="Choose one with --poses FILE"
            )
        if found:
            return found.pop()
    return None


def pose_candidates(folder: Path, scans: int) -> list[Path]:
    """Files beside scans that may be their poses: as many as scans, or with times or numbers.

    Args:
        folder: where to look.
        scans: number of scans.
    """
    found = []
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        if path.suffix.lower() not in _TEXTS or not path.is_file():
            continue
        if path.stat().st_size > _LARGEST_FILE:
            continue
        try:
            poses = read_poses(path)
        except (DataError, KeyError, ValueError):
            continue
        matched = poses.stamps is not None or poses.numbers is not None
        if len(poses) > 1 and (len(poses) == scans or matched):
            found.append(path)
    return found


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


def _csv(path: Path, header: str, lines: list[tuple[int, str]], separator: str | None) -> PoseFile:
    """Find the columns by name, in any order; other columns are ignored."""
    titles = [name.strip().strip("\"'").lower() for name in header.split(separator)]
    names = [re.sub(r"\s*[\[(].*", "", title) for title in titles]
    rows = [
        (n, [word.strip() for word in line.split(separator)])
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

    if {"easting", "northing", "altitude", "roll", "pitch", "heading"} <= set(names):
        return _boreas(path, rows, names)
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


def _boreas(path: Path, rows: Rows, names: list[str]) -> PoseFile:
    """Boreas: easting, northing and altitude in metres; roll, pitch and heading in radians.

    The rotation from the sensor to the world is the product of the passive rotations about x by
    roll, about y by pitch and about z by heading.
    """
    from scipy.spatial.transform import Rotation

    wanted = ["easting", "northing", "altitude", "roll", "pitch", "heading"]
    table = _floats(path, rows, [names.index(name) for name in wanted])
    poses = np.tile(np.eye(4), (len(table), 1, 1))
    poses[:, :3, 3] = table[:, :3]
    turns = Rotation.from_euler("xyz", table[:, 3:]).inv()
    poses[:, :3, :3] = turns.as_matrix()
    stamps = _stamps(path, rows, names.index("gpstime")) if "gpstime" in names else None
    return PoseFile(path, "Boreas", poses, stamps)


def _graph(path: Path, lines: list[tuple[int, str]]) -> PoseFile:
    """The vertices of a graph of g2o, in the order of their numbers."""
    rows = [(n, line.split()) for n, line in lines if line.startswith("VERTEX_SE3:QUAT")]
    rows = [(n, words) for n, words in rows if len(words) >= 9]
    if not rows:
        raise DataError(path, "has no VERTEX_SE3:QUAT", hint=_FORMATS)
    rows.sort(key=lambda row: int(row[1][1]) if row[1][1].isdigit() else 0)
    poses = _quaternions(path, rows, range(2, 9))
    numbers = _numbers(path, rows, 1)
    return PoseFile(path, "g2o", poses, None, numbers)


def _json(path: Path) -> PoseFile | None:
    """Poses of a JSON file: a list of objects with position and rotation, or of matrices.

    None if it is another file.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, UnicodeDecodeError):
        return None
    rows: Rows = []
    kind = "matrix"
    for n, each in enumerate(content if isinstance(content, list) else [], 1):
        if isinstance(each, dict):
            found = _json_pose(each)
            kind = "quaternion"
        else:
            found = np.ravel(each).tolist() if isinstance(each, list) else None
        if found is None:
            return None
        rows.append((n, [str(value) for value in found]))
    if not rows or len(rows[0][1]) not in (7, 12, 16):
        return None
    if kind == "quaternion":
        return PoseFile(path, "JSON", _quaternions(path, rows, range(7)))
    return _numbers_only(path, rows, False)


def _json_pose(each: dict[str, Any]) -> list[float] | None:
    """X y z qx qy qz qw of an object such as ``{"position": {...}, "heading": {...}}``."""
    place = next((each[k] for k in ("position", "translation", "t") if k in each), None)
    turn = next((each[k] for k in ("heading", "rotation", "orientation", "q") if k in each), None)
    if not isinstance(place, dict) or not isinstance(turn, dict):
        return None
    try:
        return [*(float(place[k]) for k in "xyz"), *(float(turn[k]) for k in "xyzw")]
    except (KeyError, TypeError, ValueError):
        return None


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
