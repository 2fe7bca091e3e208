"""A ROS 2 node: PointCloud2 in, the same PointCloud2 with the fields ``label`` and ``reason`` out.

    python live_node.py --ros-args -r points:=/ouster/points -p world:=odom -p method:=seethrough -p
        sensor:=os1_64

It needs the pose of the sensor: TF from the cloud's frame to ``world``, from odometry or SLAM.
Parameters: ``method``, ``sensor``, ``reach`` (metres), ``world`` (frame). The static map around the
robot is published once per second.
"""

from __future__ import annotations

import numpy as np
import rclpy
from cloud_messages import FLOAT32, points_of, pose_of, stamp_of, with_labels
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header
from tf2_ros import Buffer, TransformException, TransformListener

import dynaviz as dv

# A queue of one: a cloud that comes while another one is labelled replaces the one that waits.
LATEST = QoSProfile(
    depth=1, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT
)


class LiveNode(Node):
    """Labels clouds as they come."""

    def __init__(self) -> None:
        super().__init__("dynaviz_live")
        values = {"method": "seethrough", "sensor": "", "reach": 60.0, "world": "odom"}
        given = {name: self.declare_parameter(name, value).value for name, value in values.items()}
        self._world = given["world"]
        # compiles
        self._live = dv.live(given["method"], sensor=given["sensor"] or None, reach=given["reach"])
        self._transforms = Buffer()
        self._listener = TransformListener(self._transforms, self)
        self._labelled = self.create_publisher(PointCloud2, "labelled", LATEST)
        self._map = self.create_publisher(PointCloud2, "static_map", LATEST)
        self.create_subscription(PointCloud2, "points", self._on_cloud, LATEST)
        self.create_timer(1.0, self._on_timer)
        self.get_logger().info(f"{self._live.info.title} is ready")

    def _on_cloud(self, cloud: PointCloud2) -> None:
        try:
            found = self._transforms.lookup_transform(
                self._world, cloud.header.frame_id, Time.from_msg(cloud.header.stamp)
            ).transform
        except TransformException as error:
            self.get_logger().warning(f"cloud dropped: {error}", throttle_duration_sec=5.0)
            return
        pose = pose_of(found.translation, found.rotation)
        labels = self._live.update(points_of(cloud), pose, stamp_of(cloud.header))
        self._labelled.publish(with_labels(cloud, labels.dynamic, labels.reasons, PointField))

    def _on_timer(self) -> None:
        points = np.ascontiguousarray(self._live.map(), np.float32)
        fields = [
            PointField(name=n, offset=4 * k, datatype=FLOAT32, count=1) for k, n in enumerate("xyz")
        ]
        header = Header(frame_id=self._world, stamp=self.get_clock().now().to_msg())
        self._map.publish(
            PointCloud2(
                header=header, height=1, width=len(points), fields=fields, is_bigendian=False,
                point_step=12,
                row_step=12 * len(points), data=points.tobytes(), is_dense=True,
            )
        )  # fmt: skip


def main() -> None:
    """Run the node until it is stopped."""
    rclpy.init()
    rclpy.spin(LiveNode())


if __name__ == "__main__":
    main()
