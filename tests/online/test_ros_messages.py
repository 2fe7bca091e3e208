"""The message code of the ROS 2 example, with the types of rosbags."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from helpers.bags import BagWriter
from scipy.spatial.transform import Rotation

from dynaviz.contracts import registry
from dynaviz.online.session import LiveSession, Settings
from dynaviz.testing.world import SENSOR

EXAMPLE = Path(__file__).parents[2] / "examples" / "ros2_live"


@pytest.fixture(scope="module")
def messages() -> ModuleType:
    spec = importlib.util.spec_from_file_location("cloud_messages", EXAMPLE / "cloud_messages.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def cloud(
    tmp_path: Path, order: str, height: int = 1, row_gap: int = 0
) -> tuple[object, np.ndarray, BagWriter]:
    """A cloud message of ten points with intensities, as a bag returns it."""
    xyz = np.random.default_rng(0).normal(size=(10, 3)).astype(np.float32)
    columns = {
        "intensity": np.arange(10, dtype=np.uint16),
        **{n: xyz[:, k] for k, n in enumerate("xyz")},
    }
    with BagWriter(tmp_path / "bag", "mcap") as bag:
        bag.cloud(0.0, columns, order=order, before=4, gap=2, height=height, row_gap=row_gap)
    from rosbags.highlevel import AnyReader

    with AnyReader([tmp_path / "bag"], default_typestore=bag.store) as reader:
        connection, _, raw = next(iter(reader.messages()))
        return reader.deserialize(raw, connection.msgtype), xyz, bag


@pytest.mark.parametrize(("order", "height", "row_gap"), [("<", 1, 0), (">", 1, 0), ("<", 2, 8)])
def test_points_are_read_and_labels_are_added(
    tmp_path: Path, messages: ModuleType, order: str, height: int, row_gap: int
) -> None:
    message, xyz, bag = cloud(tmp_path, order, height, row_gap)
    np.testing.assert_array_equal(messages.points_of(message), xyz)
    dynamic, reasons = np.arange(10) % 3 == 0, np.arange(10, dtype=np.uint8)
    field = bag.store.types["sensor_msgs/msg/PointField"]
    labelled = messages.with_labels(message, dynamic, reasons, field)
    raw = bag.store.serialize_cdr(labelled, labelled.__msgtype__)
    back = bag.store.deserialize_cdr(raw, labelled.__msgtype__)
    np.testing.assert_array_equal(messages.points_of(back), xyz)
    offsets = {each.name: each.offset for each in back.fields}
    rows = back.data.reshape(-1, back.point_step)
    np.testing.assert_array_equal(rows[:, offsets["label"]], dynamic)
    np.testing.assert_array_equal(rows[:, offsets["reason"]], reasons)
    assert back.row_step * back.height == len(back.data)


def test_poses_and_stamps(messages: ModuleType, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", "mcap") as bag:
        quaternion = Rotation.from_euler("xyz", [0.1, -0.4, 2.0]).as_quat()
        rotation = bag.make(
            "geometry_msgs/msg/Quaternion", **dict(zip("xyzw", 2 * quaternion, strict=True))
        )
        translation = bag.make("geometry_msgs/msg/Vector3", x=1.0, y=2.0, z=3.0)
        T = messages.pose_of(translation, rotation)
        np.testing.assert_allclose(
            T[:3, :3], Rotation.from_quat(quaternion).as_matrix(), atol=1e-12
        )
        assert T[:3, 3].tolist() == [1, 2, 3]
        assert messages.stamp_of(bag.header(1.5, "lidar")) == 1_700_000_001_500_000_000


class Stub(ModuleType):
    """A module whose attributes are all a class that accepts anything."""

    def __getattr__(self, name: str) -> type:
        if name.startswith("__"):
            raise AttributeError(name)
        return Anything


class Anything:
    """Stands for a class of ROS."""

    KEEP_LAST = BEST_EFFORT = value = None
    from_msg = staticmethod(lambda stamp: stamp)

    def __init__(self, *values: object, **named: object) -> None:
        self.published: list[object] = []

    def __call__(self, *values: object, **named: object) -> Anything:
        return self

    def __getattr__(self, name: str) -> Anything:
        return Anything()

    def publish(self, message: object) -> None:
        self.published.append(message)


def test_the_node_labels_a_cloud(
    tmp_path: Path, messages: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    message, xyz, bag = cloud(tmp_path, "<")
    for name in (
        "rclpy",
        "rclpy.node",
        "rclpy.qos",
        "rclpy.time",
        "sensor_msgs.msg",
        "std_msgs.msg",
        "tf2_ros",
    ):
        monkeypatch.setitem(sys.modules, name, Stub(name))
    monkeypatch.setattr(sys.modules["tf2_ros"], "TransformException", ValueError, raising=False)
    monkeypatch.setattr(
        sys.modules["sensor_msgs.msg"], "PointField", bag.store.types["sensor_msgs/msg/PointField"]
    )
    monkeypatch.setitem(sys.modules, "cloud_messages", messages)
    spec = importlib.util.spec_from_file_location("live_node", EXAMPLE / "live_node.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    kind = registry.load("methods", "dufomap")
    node = module.LiveNode.__new__(module.LiveNode)
    node._world, node._live = "odom", LiveSession(kind(kind.Params()), SENSOR, Settings(20.0))
    node._labelled = Anything()
    still = SimpleNamespace(x=0.0, y=0.0, z=0.0), SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    transform = SimpleNamespace(transform=SimpleNamespace(translation=still[0], rotation=still[1]))
    node._transforms = SimpleNamespace(lookup_transform=lambda *names: transform)
    node._on_cloud(message)
    (labelled,) = node._labelled.published
    assert [field.name for field in labelled.fields][-2:] == ["label", "reason"]
    assert len(node._live) == 1
    np.testing.assert_array_equal(messages.points_of(labelled), xyz)
