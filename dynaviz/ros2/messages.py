"""Messages of ROS 2: read points and poses, and write the same cloud with labels.

Works with any class of messages, such as those of a bag.
"""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F64, I64
from dynaviz.io.pointcloud2 import cloud_rows, cloud_xyz
from dynaviz.spatial import geometry
from dynaviz.spatial.trajectory import FIELDS, point_times, unit_of

# datatypes of sensor_msgs/PointField
FLOAT32 = 7
UINT8 = 2


def points_of(message: Any) -> NDArray[np.float32]:
    """(N, 3) float32, metres: x, y and z of a PointCloud2, row by row.

    Raises:
        ValueError: for a cloud without x, y and z, or whose data do not fit its fields.
    """
    return cloud_xyz(cloud_rows(message))


def with_labels(
    message: Any, dynamic: NDArray[np.bool_], reasons: NDArray[np.uint8], field_type: type[Any]
) -> Any:
    """Add the fields ``label`` (0 static, 1 dynamic) and ``reason`` (its code) to a PointCloud2, in
    place.

    Args:
        message: the cloud, of height * width points.
        dynamic, reasons: (height * width,), as ``LiveSession.update`` returns them.
        field_type: the class PointField of the same kind of messages.

    Returns:
        The message, with two bytes more per point.
    """
    rows = _bytes(message)
    more = np.stack([dynamic.astype(np.uint8), reasons], -1).reshape(*rows.shape[:2], 2)
    fields = [
        field_type(name=name, offset=rows.shape[2] + n, datatype=UINT8, count=1)
        for n, name in enumerate(("label", "reason"))
    ]
    data = np.concatenate([rows, more], 2)
    message.fields = [*message.fields, *fields]
    message.point_step = data.shape[2]
    message.row_step = data.shape[1] * data.shape[2]
    flat = data.ravel()
    # ROS checks anything but its own type byte by byte
    message.data = array("B", flat.tobytes()) if isinstance(message.data, array) else flat
    return message


def times_of(rows: NDArray[Any], stamp: int) -> I64 | None:
    """(N,) int64, nanoseconds: when each point was measured; None if no field says so.

    Args:
        rows: (N,) points with all fields, of ``dynaviz.io.pointcloud2.cloud_rows``.
        stamp: of the cloud, nanoseconds.
    """
    for name in FIELDS:
        if name in (rows.dtype.names or ()) and not rows.dtype[name].shape:
            unit = unit_of(rows[name])
            return None if unit is None else point_times(rows[name], unit, stamp)
    return None


def pose_of(translation: Any, rotation: Any) -> F64:
    """(4, 4) float64: the pose of a geometry_msgs Vector3 or Point, metres, and Quaternion."""
    position = (translation.x, translation.y, translation.z)
    return geometry.pose(position, (rotation.w, rotation.x, rotation.y, rotation.z))


def stamp_of(header: Any) -> int:
    """Nanoseconds."""
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


def _bytes(message: Any) -> NDArray[np.uint8]:
    """(height, width, point_step) uint8: the bytes of the points, without padding between rows."""
    data = np.frombuffer(memoryview(message.data), np.uint8).reshape(
        message.height, message.row_step
    )
    return data[:, : message.width * message.point_step].reshape(
        message.height, message.width, message.point_step
    )
