"""Checks of arrays that users give, in one place.

Each error names the scan and the field, and says what to give.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynaviz.arrays import F64
from dynaviz.errors import UsageError
from dynaviz.spatial import geometry

SCANS = (
    "Give a list of (points, pose) or (points, pose, stamp): (N, 3 or more) metres in the sensor "
    "frame, (4, 4), ns"
)
_POINTS = "Give (N, 3 or more) numbers, metres"
_POSE = "Give T_world_sensor: (4, 4), metres, a rotation and a position, with the last row 0 0 0 1"


def given_points(points: ArrayLike, scan: int) -> NDArray[Any]:
    """The points of a scan: (N, 3 or more) numbers, metres; they may contain NaN.

    Raises:
        UsageError: for another shape or type.
    """
    array = np.asarray(points)
    found = f"scan {scan}, points: {array.shape} of {array.dtype}"
    if (
        array.ndim == 2
        and array.shape[0] in (3, 4)
        and array.shape[1] > 4
        and array.dtype.kind in "fiu"
    ):
        raise UsageError(f"{found}. {_POINTS}: points.T")
    if array.ndim != 2 or array.shape[1] < 3 or array.dtype.kind not in "fiu":
        raise UsageError(f"{found}. {_POINTS}")
    return array


def given_pose(pose: ArrayLike, scan: int) -> F64:
    """The pose of a scan: (4, 4) float64, metres, rigid.

    Raises:
        UsageError: for another shape, NaN, or a matrix that is not a rotation and a position.
    """
    where = f"scan {scan}, pose"
    try:
        T = np.array(pose, np.float64)
    except (TypeError, ValueError):
        raise UsageError(f"{where}: {type(pose).__name__} is not a matrix. {_POSE}") from None
    if T.shape != (4, 4):
        raise UsageError(f"{where}: {T.shape}. {_POSE}")
    if not np.isfinite(T).all():
        raise UsageError(f"{where}: has NaN or infinite numbers. Leave out scans without a pose")
    if not np.allclose(T[3], [0, 0, 0, 1], atol=1e-6):
        turned = (
            ". The matrix may be transposed: pose.T"
            if np.allclose(T[:, 3], [0, 0, 0, 1], atol=1e-6)
            else ""
        )
        raise UsageError(
            f"{where}: the last row is {' '.join(f'{x:g}' for x in T[3])}{turned}. {_POSE}"
        )
    if (problem := geometry.rotation_problem(T[:3, :3])) is not None:
        raise UsageError(f"{where}: {problem}. {_POSE}")
    return T


def given_poses(poses: ArrayLike, scans: int) -> list[F64]:
    """A pose for each scan.

    Raises:
        UsageError: for another number of poses, or as ``given_pose``.
    """
    found = list(np.asarray(poses)) if not isinstance(poses, list | tuple) else poses
    if len(found) != scans:
        raise UsageError(f"poses: {len(found)} for {scans} scans. Give one for each scan")
    return [given_pose(pose, k) for k, pose in enumerate(found)]
