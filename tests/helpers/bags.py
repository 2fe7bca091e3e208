"""Write bags with rosbags: clouds of any layout, odometry, poses, transforms."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

START = 1_700_000_000_000_000_000  # ns
KINDS = ("ros1", "sqlite3", "mcap")
DATATYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}


class BagWriter:
    """Writes a bag. Times are in seconds since ``START``; None writes a stamp of zero."""

    def __init__(self, path: Path, kind: str = "ros1") -> None:
        self.ros1 = kind == "ros1"
        self.path = path.with_suffix(".bag") if self.ros1 else path
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        if "tf2_msgs/msg/TFMessage" not in self.store.types:
            text = "geometry_msgs/msg/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))
        plugin = {
            "sqlite3": StoragePlugin.SQLITE3,
            "mcap": StoragePlugin.MCAP,
            "ros1": StoragePlugin.SQLITE3,
        }[kind]
        self.writer: Any = (
            Writer1(self.path) if self.ros1 else Writer2(path, version=9, storage_plugin=plugin)
        )
        self.connections: dict[str, Any] = {}

    def __enter__(self) -> Self:
        self.writer.open()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.writer.close()

    def make(self, kind: str, **values: Any) -> Any:
        return self.store.types[kind](**values)

    def header(self, seconds: float | None, frame: str) -> Any:
        ns = 0 if seconds is None else START + round(seconds * 1e9)
        stamp = self.make("builtin_interfaces/msg/Time", sec=ns // 10**9, nanosec=ns % 10**9)
        more = {"seq": 0} if self.ros1 else {}
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **more)

    def write(self, topic: str, seconds: float, message: Any) -> None:
        kind = message.__msgtype__
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        raw = (self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr)(message, kind)
        self.writer.write(self.connections[topic], START + round(seconds * 1e9), raw)

    def cloud(
        self,
        seconds: float | None,
        columns: Mapping[str, np.ndarray],
        *,
        topic: str = "/points",
        frame: str = "lidar",
        recorded: float | None = None,
        order: str = "<",
        before: int = 0,
        gap: int = 0,
        height: int = 1,
        row_gap: int = 0,
        cut: int = 0,
    ) -> None:
        """Write a cloud.

        Args:
            seconds: stamp.
            columns: fields by name, (N,) each.
            topic, frame: names.
            recorded: recording time; default: the stamp.
            order: byte order, ``<`` or ``>``.
            before, gap: bytes of padding before the first field and after each field.
            height: number of rows of an organised cloud.
            row_gap: bytes of padding after each row.
            cut: bytes missing at the end of the data.
        """
        offset, offsets = before, []
        for column in columns.values():
            offsets.append(offset)
            offset += column.dtype.itemsize + gap
        formats = [column.dtype.newbyteorder(order) for column in columns.values()]
        layout = {
            "names": list(columns),
            "formats": formats,
            "offsets": offsets,
            "itemsize": offset,
        }
        rows = np.zeros(len(next(iter(columns.values()))), np.dtype(layout))  # type: ignore[call-overload]
        for name, column in columns.items():
            rows[name] = column
        body = rows.view(np.uint8).reshape(height, -1)
        body = np.pad(body, ((0, 0), (0, row_gap)), constant_values=255)
        fields = [
            self.make(
                "sensor_msgs/msg/PointField",
                name=name,
                offset=at,
                datatype=DATATYPES[c.dtype.str[1:]],
                count=1,
            )
            for (name, c), at in zip(columns.items(), offsets, strict=True)
        ]
        message = self.make(
            "sensor_msgs/msg/PointCloud2",
            header=self.header(seconds, frame),
            height=height,
            width=len(rows) // height,
            fields=fields,
            is_bigendian=order == ">",
            point_step=offset,
            row_step=body.shape[1],
            data=body.reshape(-1)[: body.size - cut],
            is_dense=False,
        )
        self.write(topic, recorded if recorded is not None else seconds or 0.0, message)

    def _parts(self, T: np.ndarray) -> tuple[dict[str, float], Any]:
        x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
        return dict(zip("xyz", T[:3, 3].tolist(), strict=True)), self.make(
            "geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w
        )

    def _pose(self, T: np.ndarray) -> Any:
        xyz, rotation = self._parts(T)
        return self.make(
            "geometry_msgs/msg/Pose",
            position=self.make("geometry_msgs/msg/Point", **xyz),
            orientation=rotation,
        )

    def odometry(
        self,
        seconds: float | None,
        T: np.ndarray,
        *,
        topic: str = "/odom",
        world: str = "odom",
        child: str = "lidar",
        recorded: float | None = None,
    ) -> None:
        zero = self.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        twist = self.make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
        message = self.make(
            "nav_msgs/msg/Odometry",
            header=self.header(seconds, world),
            child_frame_id=child,
            pose=self.make(
                "geometry_msgs/msg/PoseWithCovariance", pose=self._pose(T), covariance=np.zeros(36)
            ),
            twist=self.make(
                "geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)
            ),
        )
        self.write(topic, recorded if recorded is not None else seconds or 0.0, message)

    def pose(
        self, seconds: float, T: np.ndarray, *, topic: str = "/pose", world: str = "map"
    ) -> None:
        header = self.header(seconds, world)
        self.write(
            topic,
            seconds,
            self.make("geometry_msgs/msg/PoseStamped", header=header, pose=self._pose(T)),
        )

    def transform(
        self, seconds: float, parent: str, child: str, T: np.ndarray, *, static: bool = False
    ) -> None:
        xyz, rotation = self._parts(T)
        link = self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(seconds, parent),
            child_frame_id=child,
            transform=self.make(
                "geometry_msgs/msg/Transform",
                translation=self.make("geometry_msgs/msg/Vector3", **xyz),
                rotation=rotation,
            ),
        )
        self.write(
            "/tf_static" if static else "/tf",
            seconds,
            self.make("tf2_msgs/msg/TFMessage", transforms=[link]),
        )


def columns(xyz: np.ndarray, kind: str = "f4", **more: np.ndarray) -> dict[str, np.ndarray]:
    return {**{axis: xyz[:, k].astype(kind) for k, axis in enumerate("xyz")}, **more}


def at(x: float, y: float = 0.0, z: float = 0.0, yaw: float = 0.0) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("z", yaw).as_matrix()
    T[:3, 3] = x, y, z
    return T


N = 6
XYZ = np.random.default_rng(0).uniform(-20, 20, (N, 60, 3)).astype(np.float32)
POSES = np.array([at(2.0 * k, -0.5 * k, 1.5, 0.2 * k) for k in range(N)])


def drive(path: Path, kind: str = "ros1", **cloud: Any) -> Path:
    """A bag with a cloud and odometry every 0.1 s; ``cloud`` is passed to ``BagWriter.cloud``."""
    with BagWriter(path, kind) as bag:
        for k in range(N):
            bag.cloud(k / 10, columns(XYZ[k]), **cloud)
            bag.odometry(k / 10, POSES[k])
    return bag.path
