"""Poses for scans from a file: matched by stamp, by number or by order, for folders of scans and for bags."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynaviz.arrays import F64, I64
from dynaviz.errors import DataError, UsageError
from dynaviz.io.poses import PoseFile, read_poses
from dynaviz.spatial.trajectory import PosesOverTime as PosePath
from dynaviz.spatial.trajectory import Trajectory

SLACK = 1_000_000  # nanoseconds by which a scan may lie outside the poses: stamps are rounded
FRAMES = ("sensor", "world")  # where points may be


@dataclass(frozen=True)
class MatchedPoses:
    """Scans that have a pose.

    Attributes:
        positions: (M,) int64: which of the scans, in their order.
        poses: (M, 4, 4) float64, metres: T_world_sensor of each.
        stamps: (M,) int64, nanoseconds, of the scans or else of their poses; None where neither has any.
        how: in a few words, for ``dynaviz info``.
        path: T_world_sensor over time, where it is known beyond the scans' own stamps.
    """

    positions: I64
    poses: F64
    stamps: I64 | None
    how: str
    path: Trajectory | None = None


def match(file: Path, where: Path, stamps: I64 | None, numbers: I64) -> MatchedPoses:
    """Find the pose of each scan.

    By stamp where scans and poses have stamps, with the pose interpolated; else by number where poses have numbers;
    else by order, for which there must be as many poses as scans. Scans without pose are left out with a warning.

    Args:
        file: of poses.
        where: the scans, for messages.
        stamps: (N,) int64, nanoseconds, of the scans; None where they have none.
        numbers: (N,) int64, of the scans.

    Raises:
        DataError: for poses that cannot be read or fit no scan.
    """
    poses = read_poses(file)
    if stamps is not None and poses.stamps is not None and (len(poses) > 1 or len(stamps) == 1):
        return _by_stamp(poses, where, stamps)
    if poses.numbers is not None:
        return _by_number(poses, where, numbers)
    if len(poses) != len(numbers):
        plural = "pose" if len(poses) == 1 else "poses"
        problem = f"has {len(poses)} {plural}, but there are {len(numbers)} scans in {where}"
        hint = "Give one pose a scan; or stamps for both (TUM, CSV), or an index (CSV), to match them by"
        raise DataError(file, problem, hint=hint)
    known = poses.stamps if stamps is None else stamps
    return MatchedPoses(np.arange(len(numbers)), poses.poses, known, f"{file.name} ({poses.kind}), by order")


def _by_stamp(poses: PoseFile, where: Path, stamps: I64) -> MatchedPoses:
    assert poses.stamps is not None
    back = np.diff(poses.stamps) < 0
    if back.any():
        problem = f"has a time in its row {int(np.argmax(back)) + 2} that lies before that of the row above"
        raise DataError(poses.path, problem, hint="Sort the poses by time, and keep one drive in a file")
    path = Trajectory.of(poses.stamps, poses.poses)
    kept = inside(path, stamps, f"{poses.path}", where)
    return MatchedPoses(kept, path.at(stamps[kept]), stamps[kept], f"{poses.path.name} ({poses.kind}), by stamp", path)


def _by_number(poses: PoseFile, where: Path, numbers: I64) -> MatchedPoses:
    assert poses.numbers is not None
    row_of = {int(number): row for row, number in enumerate(poses.numbers)}
    kept = np.array([k for k, number in enumerate(numbers.tolist()) if number in row_of], np.int64)
    if len(row_of) < len(poses):
        raise DataError(poses.path, "has two poses of the same index", hint="Give one pose a scan")
    if not len(kept):
        problem = (
            f"has poses {min(row_of)} to {max(row_of)}, but the scans in {where} are {numbers[0]} to {numbers[-1]}"
        )
        raise DataError(poses.path, problem, hint="Count both alike")
    left_out(len(numbers) - len(kept), len(numbers), f"have no pose in {poses.path}")
    rows = np.array([row_of[number] for number in numbers[kept].tolist()])
    stamps = None if poses.stamps is None else poses.stamps[rows]
    return MatchedPoses(kept, poses.poses[rows], stamps, f"{poses.path.name} ({poses.kind}), by number")


def inside(path: PosePath, stamps: I64, source: str, where: Path) -> I64:
    """Positions of the stamps at which a path is known; the others are left out with a warning.

    Raises:
        DataError: where none is left.
    """
    first, last = path.span
    kept = np.flatnonzero((stamps >= first - SLACK) & (stamps <= last + SLACK))
    if not len(kept):
        scans = f"{stamps.min() / 1e9:.3f} to {stamps.max() / 1e9:.3f} s"
        problem = (
            f"has no scan while poses are known: scans from {scans}, poses from {first / 1e9:.3f} to {last / 1e9:.3f} s"
        )
        raise DataError(where, problem, hint=f"Give poses of the same drive and clock; these are from {source}")
    left_out(len(stamps) - len(kept), len(stamps), f"lie outside the poses of {source}")
    return kept


def left_out(number: int, total: int, why: str) -> None:
    """Warn of scans that are left out, if any."""
    if number:
        warnings.warn(f"{number} of {total} scans {why} and are left out", stacklevel=3)


def frame_of(points_in: str | None) -> str:
    """``sensor`` or ``world``; sensor by default.

    Raises:
        UsageError: for anything else.
    """
    if points_in not in (None, *FRAMES):
        raise UsageError(f"--points-in {points_in}: give {' or '.join(FRAMES)}")
    return points_in or FRAMES[0]
