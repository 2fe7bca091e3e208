"""PointCloud2 messages: read x, y and z, and write the same cloud with labels.

Works with any class of messages.

Nothing here imports ROS, so it is tested where ROS is not installed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz.io.pointcloud2 import cloud_rows, cloud_xyz

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
    message.data = data.ravel()
    return message


def pose_of(translation: Any, rotation: Any) -> NDArray[np.float64]:
    """(4, 4) float64: the pose of a geometry_msgs Vector3 or Point, metres, and Quaternion."""
    x, y, z, w = np.array([rotation.x, rotation.y, rotation.z, rotation.w]) / np.linalg.norm(
        [rotation.x, rotation.y, rotation.z, rotation.w]
    )
    T = np.eye(4)
    T[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    T[:3, 3] = translation.x, translation.y, translation.z
    return T


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
