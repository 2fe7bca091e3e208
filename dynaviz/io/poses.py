"""Text files of poses: KITTI's (12 numbers a line, three rows of a matrix) and TUM's (time, position, quaternion)."""

from __future__ import annotations

import os

import numpy as np

from dynaviz import geometry
from dynaviz.errors import DataError
from dynaviz.io.text import read_table
from dynaviz.scan import F64


def read_kitti_poses(path: str | os.PathLike[str]) -> F64:
    """Read KITTI's ``poses.txt``.

    Returns:
        (lines, 4, 4) float64, metres; T_world_camera for KITTI's own files.

    Raises:
        DataError: for a file that cannot be read, or a line without 12 numbers.
    """
    poses = np.tile(np.eye(4), (len(table := read_table(path, 12, "A line of poses has 12 numbers")), 1, 1))
    poses[:, :3] = table.reshape(-1, 3, 4)
    return poses


def read_tum_poses(path: str | os.PathLike[str]) -> tuple[F64, F64]:
    """Read a trajectory of the TUM format: ``time tx ty tz qx qy qz qw``.

    Returns:
        times: (lines,) float64, seconds.
        poses: (lines, 4, 4) float64, metres.

    Raises:
        DataError: for a file that cannot be read, or a line that is no pose.
    """
    table = read_table(path, 8, "A line has time tx ty tz qx qy qz qw")
    quaternions = table[:, [7, 4, 5, 6]]
    if not (zero := np.abs(quaternions).max(1, initial=0) < 1e-6).any():
        poses = [geometry.pose(row[1:4], quaternion) for row, quaternion in zip(table, quaternions, strict=True)]
        return table[:, 0], np.array(poses).reshape(-1, 4, 4)
    problem = f"has a quaternion of length zero in row {int(np.argmax(zero))}, counted from 0"
    raise DataError(path, problem, hint="A line has time tx ty tz qx qy qz qw")
