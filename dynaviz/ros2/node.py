"""A ROS 2 node: PointCloud2 in, the same PointCloud2 with the fields ``label`` and ``reason`` out.

    ros2 launch dynaviz live.launch.py points:=/ouster/points sensor:=os1_64 world:=odom

``docs/live.md`` lists topics and parameters.
"""

from __future__ import annotations

import queue
import threading
from array import array
from typing import Any

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header
from tf2_ros import Buffer, TransformException, TransformListener

import dynaviz as dv
from dynaviz.arrays import F64
from dynaviz.contracts.registry import BEST
from dynaviz.ros2.messages import FLOAT32, pose_of, with_labels
from dynaviz.ros2.waiting import CloudQueue, ReadyCloud

POLL = 0.01  # seconds between two looks for clouds whose transform has come
QUIET = 5.0  # seconds between two warnings of the same kind
PARAMETERS: dict[str, Any] = {
    "method": BEST,
    "sensor": "",
    "reach": 60.0,
    "world": "odom",
    "deskew": True,
    "timeout": 0.5,
    "map_period": 1.0,
}
LATEST = QoSProfile(
    depth=1, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT
)


class LiveNode(Node):  # type: ignore[misc]  # ROS has no types
    """Labels clouds as they come.

    Three threads: that of ROS receives clouds and transforms, one labels, one builds the map. A
    cloud that comes while another one is labelled replaces the one that waits for it.
    """

    def __init__(self) -> None:
        super().__init__("dynaviz")
        given = {name: self.declare_parameter(name, d).value for name, d in PARAMETERS.items()}
        self._world = given["world"]
        self._period = max(given["map_period"], POLL)
        # compiles
        self._live = dv.live(given["method"], sensor=given["sensor"] or None, reach=given["reach"])
        self._transforms = Buffer()
        self._listener = TransformListener(self._transforms, self)
        self._waiting = CloudQueue(self._pose, given["timeout"], room=10, deskew=given["deskew"])
        self._next: queue.Queue[ReadyCloud] = queue.Queue(1)
        self._ended = threading.Event()
        self._labelled = self.create_publisher(PointCloud2, "labelled", LATEST)
        self._map = self.create_publisher(PointCloud2, "static_map", LATEST)
        self.create_subscription(PointCloud2, "points", self.on_cloud, LATEST)
        self.create_timer(POLL, self.on_timer)
        for work in (self._label_clouds, self._build_maps):
            threading.Thread(target=work, daemon=True).start()
        self.get_logger().info(f"{self._live.info.title} is ready")

    def on_cloud(self, cloud: PointCloud2) -> None:
        """Let a cloud wait for its transform."""
        self._waiting.add(cloud, self._seconds())
        self.on_timer()

    def on_timer(self) -> None:
        """Hand over the clouds whose transform has come."""
        while (ready := self._waiting.take(self._seconds())) is not None:
            try:
                self._next.put_nowait(ready)
            except queue.Full:
                self._replace(ready)
        for reason in self._waiting.dropped:
            self.get_logger().warning(f"cloud dropped: {reason}", throttle_duration_sec=QUIET)
        self._waiting.dropped.clear()

    def label(self, cloud: ReadyCloud) -> None:
        """Label a cloud and publish it."""
        labels = self._live.update(
            cloud.points,
            cloud.T_world_sensor,
            cloud.stamp,
            times=cloud.times,
            path=cloud.path,
        )
        message = with_labels(cloud.message, labels.dynamic, labels.reasons, PointField)
        self._labelled.publish(message)

    def publish_map(self) -> None:
        """Publish the static map around the sensor."""
        points = np.ascontiguousarray(self._live.map(), np.float32)
        fields = [
            PointField(name=name, offset=4 * axis, datatype=FLOAT32, count=1)
            for axis, name in enumerate("xyz")
        ]
        header = Header(frame_id=self._world, stamp=self.get_clock().now().to_msg())
        self._map.publish(
            PointCloud2(
                header=header,
                height=1,
                width=len(points),
                fields=fields,
                is_bigendian=False,
                point_step=12,
                row_step=12 * len(points),
                data=array("B", points.tobytes()),
                is_dense=True,
            )
        )

    def close(self) -> None:
        """End the threads."""
        self._ended.set()

    def _pose(self, frame: str, moment: int) -> F64 | str:
        try:
            found = self._transforms.lookup_transform(self._world, frame, Time(nanoseconds=moment))
        except TransformException as error:
            return str(error)
        return pose_of(found.transform.translation, found.transform.rotation)

    def _replace(self, ready: ReadyCloud) -> None:
        """Drop the cloud that waits to be labelled, and let this one wait."""
        try:
            self._next.get_nowait()
            self._waiting.dropped.append("the method is slower than the sensor")
        except queue.Empty:
            pass  # it was taken meanwhile
        self._next.put(ready)

    def _label_clouds(self) -> None:
        while not self._ended.is_set():
            try:
                cloud = self._next.get(timeout=QUIET)
            except queue.Empty:
                continue
            try:
                self.label(cloud)
            except dv.UsageError as error:
                self.get_logger().error(f"cloud not labelled: {error}", throttle_duration_sec=QUIET)
            except Exception as error:  # without this thread, the node would receive and never send
                self.get_logger().fatal(f"the node ends: {error!r}")
                rclpy.try_shutdown()
                raise

    def _build_maps(self) -> None:
        while not self._ended.wait(self._period):
            if len(self._live):
                self.publish_map()

    def _seconds(self) -> float:
        return float(self.get_clock().now().nanoseconds) * 1e-9


def main() -> None:
    """Run the node until it is stopped."""
    rclpy.init()
    node = LiveNode()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.close()
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
