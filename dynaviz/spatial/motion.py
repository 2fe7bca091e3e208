"""Motion of the sensor between and during sweeps, from the poses of the sweeps."""

from __future__ import annotations

import numpy as np

from dynaviz.arrays import F64, I64
from dynaviz.spatial import geometry
from dynaviz.spatial.trajectory import Trajectory, deskew

PARTS = (
    4  # of the way from one sweep to the next; poses are interpolated along a line within a part
)


def smoothed(times: I64, poses: F64) -> Trajectory:
    """A trajectory through poses whose velocity and turn rate are continuous.

    A sensor on a rough road pitches to and fro within a few sweeps. Straight lines between the
    poses of sweeps would displace points at 20 m by several centimetres.

    Args:
        times: (K,) int64, nanoseconds; of several poses at the same time, the last one is used.
        poses: (K, 4, 4) float64, metres.
    """
    from scipy.interpolate import CubicSpline
    from scipy.spatial.transform import Rotation, RotationSpline

    given = Trajectory.of(times, poses)
    if len(given.times) < 3:
        return given
    seconds = (given.times - given.times[0]) / 1e9
    steps = np.diff(given.times)
    between = np.concatenate([given.times[:-1] + steps * part // PARTS for part in range(1, PARTS)])
    moments = (between - given.times[0]) / 1e9
    fine: F64 = np.tile(np.eye(4), (len(between), 1, 1))
    fine[:, :3, :3] = RotationSpline(seconds, Rotation.from_matrix(given.poses[:, :3, :3]))(
        moments
    ).as_matrix()
    fine[:, :3, 3] = CubicSpline(seconds, given.poses[:, :3, 3])(moments)
    return Trajectory.of(
        np.concatenate([given.times, between]), np.concatenate([given.poses, fine])
    )


def deskewed_along(points: F64, moments: I64, path: Trajectory, moment: int) -> F64:
    """Points as the sensor sees them at one moment.

    Args:
        points: (N, 3) float64, metres, sensor frame, each at its own time.
        moments: (N,) int64, nanoseconds: when each point was measured.
        path: T_world_sensor over time.
        moment: nanoseconds.

    Returns:
        (N, 3) float64, metres.
    """
    to_sensor = geometry.inverse(path.at([moment])[0])
    local = Trajectory(path.times, geometry.compose(to_sensor, path.poses))
    return deskew(points, moments, local)[0].astype(np.float64)


def deskewed_to_middle(points: F64, times: F64, motion: F64) -> F64:
    """Points as the sensor in the middle of the sweep sees them, at constant velocity.

    Args:
        points: (N, 3) float64, metres, sensor frame, each at its own time.
        times: (N,) float64, seconds.
        motion: (4, 4) float64, metres: pose of the sensor at the last time in its frame at the
            first.

    Returns:
        (N, 3) float64, metres.
    """
    moments = np.round((times - times.min()) * 1e9).astype(np.int64)
    last = int(moments.max())
    return (
        deskewed_along(points, moments, Trajectory.of([0, last], [np.eye(4), motion]), last // 2)
        if last
        else points
    )
