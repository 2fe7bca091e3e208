"""KITTI's calibration files, ``oxts`` records of GPS and inertial unit, ``label_02`` boxes, and
tracklets.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from dynaviz.arrays import F64
from dynaviz.errors import DataError
from dynaviz.io.atomic import open_file
from dynaviz.io.text import read_table
from dynaviz.spatial import geometry

_CALIB_HINT = "Write each line as NAME: NUMBERS, with 12 numbers for a transform"


def read_calib(path: str | os.PathLike[str]) -> dict[str, F64]:
    """Read the lines ``NAME: NUMBERS`` except the date.

    The colon may be missing, as in some of KITTI's own files.

    Returns:
        float64 arrays by name: (12,), (9,) or any other length, as in the file.

    Raises:
        DataError: if the file cannot be read or a line contains anything but numbers.
    """
    rows = {}
    with open_file(path, _CALIB_HINT) as file:
        for number, line in enumerate(file, 1):
            name, *values = line.decode("latin-1").split() or [""]
            if name == "calib_time:":
                continue
            try:
                rows[name.removesuffix(":")] = np.array(values, np.float64)
            except ValueError:
                raise DataError(
                    path,
                    "contains something other than numbers",
                    at=f"line {number}",
                    hint=_CALIB_HINT,
                ) from None
    return rows


def calib_matrix(path: str | os.PathLike[str], rows: Mapping[str, F64], *names: str) -> F64:
    """The first of the named rows that exists, as (3, 4) or (3, 3) float64.

    Raises:
        DataError: if no row exists, or the row does not have 12 or 9 finite numbers.
    """
    name = next((name for name in names if name in rows), None)
    if name is None:
        raise DataError(path, f"line {' or '.join(names)} is missing", hint=_CALIB_HINT)
    if rows[name].size not in (9, 12) or not np.isfinite(rows[name]).all():
        raise DataError(path, f"line {name} must have 9 or 12 finite numbers", hint=_CALIB_HINT)
    return rows[name].reshape(3, -1)


def calib_transform(path: str | os.PathLike[str], rows: Mapping[str, F64], *names: str) -> F64:
    """``calib_matrix`` as a rigid transform, (4, 4) float64, metres.

    The rotation is orthonormalised, because the numbers in the files are rounded.

    Raises:
        DataError: as in ``calib_matrix``, and for a rotation of zeros.
    """
    matrix = calib_matrix(path, rows, *names)
    T = np.eye(4)
    try:
        T[:3, :3] = geometry.matrix(geometry.quaternion(matrix[:, :3]))
    except ValueError:
        raise DataError(
            path, f"line {' or '.join(names)} does not contain a rotation", hint=_CALIB_HINT
        ) from None
    if matrix.shape == (3, 4):
        T[:3, 3] = matrix[:, 3]
    return T


_EARTH_RADIUS = 6378137.0  # metres
_OXTS_HINT = "Each oxts line needs 30 numbers, starting with the latitude"
_LIMITS = (89.0, 360.0, 1e5, 10.0, 10.0, 10.0)  # latitude to yaw; Mercator diverges at the poles
_COLUMNS = 30  # lat lon alt roll pitch yaw, then speeds, accelerations and qualities


def read_oxts(*paths: str | os.PathLike[str]) -> F64:
    """Read poses of the IMU from one file with a line per frame, or from one file per frame.

    Latitude and longitude are projected by Mercator, scaled by the first latitude (KITTI raw
    development kit, ``latlonToMercator``).

    Args:
        paths: a single file, or files of one line each, in frame order.

    Returns:
        (lines, 4, 4) float64, metres: T_earth_imu; x east, y north, z up.

    Raises:
        DataError: if a file cannot be read, a line does not have 30 numbers, a position or angle is
            out of range, or one of several files does not have exactly one line.
    """
    tables = [read_table(path, _COLUMNS, _OXTS_HINT) for path in paths]
    for path, rows in zip(paths, tables, strict=True):
        if len(paths) > 1 and len(rows) != 1:
            raise DataError(path, f"has {len(rows)} lines, expected one per frame", hint=_OXTS_HINT)
    table = np.concatenate(tables)
    for path, rows in zip(paths, tables, strict=True):
        if (np.abs(rows[:, :6]) > _LIMITS).any():
            problem = "latitude, longitude, altitude or angle out of range"
            raise DataError(
                path,
                problem,
                hint="Give latitude and longitude in degrees, and roll, pitch and yaw in radians",
            )
    latitude = np.radians(table[:, 0])
    longitude = np.radians(table[:, 1])
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


_BOX_HINT = "Each line needs a frame, a track, a type and at least 14 numbers"
REGION = "DontCare"


@dataclass(frozen=True, slots=True)
class TrackBox:
    """An object in a frame, or an unlabelled image region (``kind`` DontCare, without a 3-D
    extent).

    Attributes:
        frame, track: as in the file; track is -1 for a region.
        kind: ``Car``, ``Pedestrian`` ...
        rectangle: left, top, right, bottom in the image of camera 2, pixels.
        size: height, width, length, metres.
        bottom: (x, y, z) of the centre of its bottom face, metres, rectified camera frame (x right,
            y down, z forward).
        yaw: rotation about the camera's y axis, radians.
    """

    frame: int
    track: int
    kind: str
    rectangle: tuple[float, float, float, float]
    size: tuple[float, float, float]
    bottom: tuple[float, float, float]
    yaw: float


def read_boxes(path: str | os.PathLike[str]) -> list[TrackBox]:
    """Read all boxes and regions of a sequence, in file order.

    Raises:
        DataError: if the file cannot be read or a line is not a valid box.
    """
    boxes = []
    with open_file(path, _BOX_HINT) as file:
        for number, line in enumerate(file, 1):
            try:
                boxes.append(_parse_box(line.decode("latin-1").split()))
            except (ValueError, OverflowError, IndexError):
                raise DataError(
                    path, "not a valid box", at=f"line {number}", hint=_BOX_HINT
                ) from None
    return boxes


def _parse_box(words: list[str]) -> TrackBox:
    frame, track = (int(np.int32(int(word))) for word in words[:2])
    numbers = [float(word) for word in words[6:17]]
    if not np.isfinite(numbers).all():
        raise ValueError("a number is not finite")
    left, top, right, bottom, height, width, length, x, y, z, yaw = numbers
    return TrackBox(
        frame, track, words[2], (left, top, right, bottom), (height, width, length), (x, y, z), yaw
    )


_XML_HINT = "Copy the file again"


@dataclass(frozen=True, slots=True, eq=False)
class Tracklet:
    """An object over time.

    Attributes:
        kind: ``Car``, ``Pedestrian`` ...
        size: height, width, length, metres.
        first: number of the first frame.
        poses: (frames, 4) float64: centre of the bottom face in metres, sensor frame, and yaw about
            z in radians.
    """

    kind: str
    size: tuple[float, float, float]
    first: int
    poses: F64


def read_tracklets(path: str | os.PathLike[str]) -> list[Tracklet]:
    """Read all tracklets of a drive.

    Raises:
        DataError: if the file cannot be read, is not XML, or contains an invalid tracklet.
    """
    with open_file(path, _XML_HINT) as file:
        try:
            root = ElementTree.parse(file).getroot()
        except ElementTree.ParseError as error:
            raise DataError(
                path, "not valid XML", at=f"line {error.position[0]}", hint=_XML_HINT
            ) from None
        except (
            LookupError,
            ValueError,
        ) as error:  # an unknown encoding, or one that the parser does not support
            raise DataError(path, f"not valid XML ({error})", at="line 1", hint=_XML_HINT) from None
    tracklets = root.find("tracklets")
    if tracklets is None:
        raise DataError(path, "the element <tracklets> is missing", hint=_XML_HINT)
    return [_tracklet(path, number, item) for number, item in enumerate(tracklets.findall("item"))]


def _tracklet(path: str | os.PathLike[str], number: int, item: ElementTree.Element) -> Tracklet:
    try:
        height, width, length = (float(item.findtext(name, "")) for name in "hwl")
        poses = [
            [float(pose.findtext(name, "")) for name in ("tx", "ty", "tz", "rz")]
            for pose in item.iterfind("poses/item")
        ]
        kind = item.findtext("objectType", "")
        first = int(item.findtext("first_frame", ""))
        if not np.isfinite([height, width, length, *(x for pose in poses for x in pose)]).all():
            raise ValueError("not finite")
    except ValueError:
        problem = (
            "a number is missing or not finite: h, w, l, first_frame, or tx, ty, tz, rz of a pose"
        )
        raise DataError(path, problem, at=f"tracklet {number}", hint=_XML_HINT) from None
    return Tracklet(
        kind, (height, width, length), first, np.array(poses, np.float64).reshape(-1, 4)
    )
