"""KITTI's ``oxts`` records of the car's GPS and inertial measurement unit."""

from __future__ import annotations

import os

import numpy as np

from dynaviz.arrays import F64
from dynaviz.errors import DataError
from dynaviz.io.text import read_table

_EARTH_RADIUS = 6378137.0  # metres
_HINT = "Each oxts line needs 30 numbers, starting with the latitude"
_LIMITS = (89.0, 360.0, 1e5, 10.0, 10.0, 10.0)  # latitude to yaw; Mercator diverges at the poles
_COLUMNS = 30  # lat lon alt roll pitch yaw, then speeds, accelerations and qualities


def read_oxts(*paths: str | os.PathLike[str]) -> F64:
    """Read poses of the IMU from one file with a line per frame, or from one file per frame.

    Latitude and longitude are projected by Mercator, scaled by the first latitude (KITTI raw development kit,
    ``latlonToMercator``).

    Args:
        paths: a single file, or files of one line each, in frame order.

    Returns:
        (lines, 4, 4) float64, metres: T_earth_imu; x east, y north, z up.

    Raises:
        DataError: if a file cannot be read, a line does not have 30 numbers, a position or angle is out of range, or
            one of several files does not have exactly one line.
    """
    tables = [read_table(path, _COLUMNS, _HINT) for path in paths]
    for path, rows in zip(paths, tables, strict=True):
        if len(paths) > 1 and len(rows) != 1:
            raise DataError(path, f"has {len(rows)} lines, expected one per frame", hint=_HINT)
    table = np.concatenate(tables)
    for path, rows in zip(paths, tables, strict=True):
        if (np.abs(rows[:, :6]) > _LIMITS).any():
            problem = "latitude, longitude, altitude or angle out of range"
            raise DataError(
                path, problem, hint="Give latitude and longitude in degrees, and roll, pitch and yaw in radians"
            )
    latitude, longitude = np.radians(table[:, 0]), np.radians(table[:, 1])
    scale = np.cos(latitude[:1]) * _EARTH_RADIUS
    poses = np.tile(np.eye(4), (len(table), 1, 1))
    poses[:, 0, 3] = scale * longitude
    poses[:, 1, 3] = scale * np.log(np.tan(np.pi / 4 + latitude / 2))
    poses[:, 2, 3] = table[:, 2]
    poses[:, :3, :3] = _rotation(*table[:, 3:6].T)
    return poses


def _rotation(roll: F64, pitch: F64, yaw: F64) -> F64:
    """(N, 3, 3) Rz(yaw) Ry(pitch) Rx(roll)."""
    (sr, cr), (sp, cp), (sy, cy) = ((np.sin(a), np.cos(a)) for a in (roll, pitch, yaw))
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.moveaxis(np.array(rows), -1, 0)
