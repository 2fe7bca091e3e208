"""The pose of a lidar on a vehicle, for trajectories of the vehicle (``--extrinsic``)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from dynaviz.arrays import F64
from dynaviz.errors import UsageError
from dynaviz.io.poses import read_poses

_HINT = "Give X,Y,Z,ROLL,PITCH,YAW in metres and degrees, or a file with one pose (12 numbers, or 4x4)"


def parse_extrinsic(text: str | None) -> F64 | None:
    """T_vehicle_lidar from ``X,Y,Z,ROLL,PITCH,YAW``, metres and degrees, or from a file with one pose.

    The rotation is yaw about z, then pitch about the new y, then roll about the new x, as in URDF.

    Returns:
        (4, 4) float64, metres; None for None.

    Raises:
        UsageError: for anything else.
        DataError: for a file that is not a pose.
    """
    if text is None:
        return None
    if Path(text).is_file():
        poses = read_poses(text).poses
        if len(poses) != 1:
            raise UsageError(f"--extrinsic {text}: has {len(poses)} poses. {_HINT}")
        pose: F64 = poses[0]
        return pose
    try:
        numbers = np.array([float(word) for word in re.split(r"[,\s]+", text.strip())])
    except ValueError:
        raise UsageError(f"--extrinsic {text}: neither numbers nor a file. {_HINT}") from None
    if len(numbers) != 6 or not np.isfinite(numbers).all():
        raise UsageError(f"--extrinsic {text}: has {len(numbers)} numbers. {_HINT}")
    from scipy.spatial.transform import Rotation

    T = np.eye(4)
    T[:3, 3] = numbers[:3]
    T[:3, :3] = Rotation.from_euler("ZYX", numbers[:2:-1], degrees=True).as_matrix()
    return T
