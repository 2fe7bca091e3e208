"""The ROS 2 node, with messages of rosbags, a clock of our own, and classes that stand for ROS."""

from __future__ import annotations

import importlib
import sys
import threading
from array import array
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
from helpers.bags import BagWriter
from scipy.spatial.transform import Rotation

import dynaviz as dv
from dynaviz.arrays import F64
from dynaviz.ros2 import messages
from dynaviz.ros2.waiting import MOMENTS, CloudQueue
from dynaviz.spatial.trajectory import Trajectory
from dynaviz.testing import crossing

SWEEP = 100_000_000  # nanoseconds


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
    tmp_path: Path, order: str, height: int, row_gap: int
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


def test_poses_and_stamps(tmp_path: Path) -> None:
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


def message_of(points: np.ndarray, stamp: int, times: np.ndarray | None = None) -> Any:
    """A PointCloud2 of points in the sensor frame, with times in seconds after the stamp."""
    names = ["x", "y", "z", *([] if times is None else ["time"])]
    columns = [points, *([] if times is None else [times[:, None]])]
    data = np.hstack(columns).astype(np.float32)
    fields = [
        SimpleNamespace(name=name, offset=4 * k, datatype=7, count=1)
        for k, name in enumerate(names)
    ]
    seconds, nanoseconds = divmod(stamp, 10**9)
    header = SimpleNamespace(
        stamp=SimpleNamespace(sec=seconds, nanosec=nanoseconds), frame_id="lidar"
    )
    return SimpleNamespace(
        header=header,
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=4 * len(names),
        row_step=4 * len(names) * len(points),
        data=array("B", data.tobytes()),
    )


def along_x(moment: int) -> F64:
    """A sensor that drives 10 m/s along x, and turns."""
    seconds = moment * 1e-9
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("z", 0.5 * seconds).as_matrix()
    T[0, 3] = 10.0 * seconds
    return T


class KnownUntil:
    """TF that knows the pose of the sensor up to a time."""

    def __init__(self) -> None:
        self.moment = -1
        self.asked: list[int] = []

    def __call__(self, frame: str, moment: int) -> F64 | str:
        assert frame == "lidar"
        self.asked.append(moment)
        return along_x(moment) if moment <= self.moment else "extrapolation into the future"


POINTS = np.array([[1.0, 2.0, 3.0], [4.0, -5.0, 6.0], [7.0, 8.0, -9.0]])


def test_a_cloud_waits_until_its_pose_is_known_and_keeps_its_place() -> None:
    known = KnownUntil()
    waiting = CloudQueue(known, timeout=0.5, room=3, deskew=True)
    for k in range(3):
        waiting.add(message_of(POINTS + k, k * SWEEP), now=0.1 * k)
    assert waiting.take(0.2) is None
    known.moment = SWEEP
    for k in range(2):
        ready = waiting.take(0.3)
        assert ready is not None
        np.testing.assert_array_equal(ready.points, POINTS + k)
        np.testing.assert_allclose(ready.T_world_sensor, along_x(k * SWEEP))
        assert ready.times is None
        assert ready.path is None
    assert waiting.take(0.3) is None
    assert len(waiting) == 1
    assert waiting.dropped == []


def test_a_cloud_without_transform_is_dropped_in_time_and_the_reason_is_said() -> None:
    known = KnownUntil()
    waiting = CloudQueue(known, timeout=0.5, room=3, deskew=True)
    waiting.add(message_of(POINTS, 0), now=7.0)
    assert waiting.take(7.4) is None
    assert len(waiting) == 1
    assert waiting.take(7.5) is None
    assert len(waiting) == 0
    assert waiting.dropped == ["no transform within 0.5 s: extrapolation into the future"]


def test_no_more_clouds_wait_than_there_is_room_for() -> None:
    known = KnownUntil()
    waiting = CloudQueue(known, timeout=9.0, room=2, deskew=True)
    for k in range(3):
        waiting.add(message_of(POINTS + k, k * SWEEP), now=0.0)
    known.moment = 3 * SWEEP
    ready = waiting.take(0.1)
    assert ready is not None
    np.testing.assert_array_equal(ready.points, POINTS + 1)
    assert waiting.dropped == ["more than 2 clouds wait for their transform"]


def test_a_sweep_with_times_waits_for_its_end_and_is_placed_point_by_point() -> None:
    known = KnownUntil()
    times = np.linspace(0, 0.1, 41)
    points = np.random.default_rng(3).normal(size=(41, 3)) * 20
    waiting = CloudQueue(known, timeout=0.5, room=3, deskew=True)
    waiting.add(message_of(points, SWEEP, times), now=0.0)
    known.moment = SWEEP
    assert waiting.take(0.1) is None
    known.moment = 2 * SWEEP + 1_000  # times of points are float32
    ready = waiting.take(0.2)
    assert ready is not None
    assert ready.path is not None
    assert ready.times is not None
    assert len(ready.path.times) == MOMENTS
    live = dv.live("octomap", sensor="vlp16", reach=30.0, threads=1)
    live.update(ready.points, ready.T_world_sensor, ready.stamp, times=ready.times, path=ready.path)
    placed = live._kept[-1]
    expected = [
        (along_x(SWEEP + round(t * 1e9)) @ [*point, 1.0])[:3]
        for t, point in zip(times, points, strict=True)
    ]
    np.testing.assert_allclose(placed.points, expected, atol=2e-3)
    np.testing.assert_allclose(placed.origins[:, 0], 10 * (0.1 + times), atol=2e-3)


def test_times_are_ignored_for_clouds_that_are_deskewed_already() -> None:
    known = KnownUntil()
    known.moment = 0
    waiting = CloudQueue(known, timeout=0.5, room=3, deskew=False)
    waiting.add(message_of(POINTS, 0, np.array([0.0, 0.05, 0.1])), now=0.0)
    ready = waiting.take(0.0)
    assert ready is not None
    assert ready.times is None


def test_a_damaged_cloud_is_dropped_and_named() -> None:
    broken = message_of(POINTS, 0)
    broken.data = broken.data[:-1]
    waiting = CloudQueue(KnownUntil(), timeout=0.5, room=3, deskew=True)
    waiting.add(broken, now=0.0)
    assert len(waiting) == 0
    assert "a cloud cannot be read: 1 x 3 points of 12 bytes need 36 bytes" in waiting.dropped[0]


@pytest.mark.parametrize("wrong", ["alone", "world", "short"])
def test_times_and_path_belong_together(wrong: str) -> None:
    live = dv.live("octomap", sensor="vlp16", reach=30.0, threads=1)
    path = Trajectory.of([0, SWEEP], [along_x(0), along_x(SWEEP)])
    times = np.zeros(3 if wrong != "short" else 2, np.int64)
    with pytest.raises(dv.UsageError, match="times"):
        live.update(
            POINTS,
            np.eye(4),
            times=times,
            path=None if wrong == "alone" else path,
            points_in="world" if wrong == "world" else "sensor",
        )


def test_the_map_is_built_while_scans_are_labelled() -> None:
    """In one thread or in two, the last map is the same."""
    scans = crossing(8)
    alone = dv.live("octomap", reach=30.0, threads=1)
    shared = dv.live("octomap", reach=30.0, threads=1)
    for scan in scans:
        alone.update(scan.points, scan.T_world_sensor, points_in="world")
    ended = threading.Event()
    sizes: list[int] = []

    def build() -> None:
        while not ended.is_set():
            sizes.append(len(shared.map()))

    thread = threading.Thread(target=build)
    thread.start()
    for scan in scans:
        shared.update(scan.points, scan.T_world_sensor, points_in="world")
    ended.set()
    thread.join()
    assert sizes
    np.testing.assert_array_equal(np.sort(shared.map(), 0), np.sort(alone.map(), 0))


class FakeNode:
    """Stands for rclpy's Node: a clock that is set by hand, and publishers that remember."""

    given: ClassVar[dict[str, Any]] = {}

    def __init__(self, name: str) -> None:
        self.now = 0
        self.said: list[str] = []
        self.topics: dict[str, list[Any]] = {}
        self.handlers: list[Callable[..., None]] = []

    def declare_parameter(self, name: str, default: Any) -> Any:
        return SimpleNamespace(value=self.given.get(name, default))

    def create_publisher(self, kind: type, topic: str, profile: object) -> Any:
        sent: list[Any] = self.topics.setdefault(topic, [])
        return SimpleNamespace(publish=sent.append)

    def create_subscription(
        self, kind: type, topic: str, call: Callable[..., None], profile: object
    ) -> None:
        self.handlers.append(call)

    def create_timer(self, period: float, call: Callable[[], None]) -> None:
        self.handlers.append(call)

    def get_clock(self) -> Any:
        stamp = SimpleNamespace(nanoseconds=self.now, to_msg=lambda: self.now)
        return SimpleNamespace(now=lambda: stamp)

    def get_logger(self) -> Any:
        def say(text: str, **more: object) -> None:
            self.said.append(text)

        return SimpleNamespace(info=say, warning=say, error=say, fatal=say)


class TransformError(Exception):
    """Stands for tf2_ros.TransformException."""


class FakeBuffer:
    """TF with the pose of the sensor up to a time."""

    known = KnownUntil()

    def lookup_transform(self, world: str, frame: str, time: Any) -> Any:
        T = self.known(frame, time.nanoseconds)
        if isinstance(T, str):
            raise TransformError(T)
        x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
        names = SimpleNamespace
        return names(
            transform=names(
                translation=names(x=T[0, 3], y=T[1, 3], z=T[2, 3]),
                rotation=names(x=x, y=y, z=z, w=w),
            )
        )


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The node of the package, with classes that stand for those of ROS."""

    def module(name: str, **content: object) -> None:
        made = ModuleType(name)
        made.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, made)

    value = SimpleNamespace
    module("rclpy", try_shutdown=lambda: None)
    module("rclpy.node", Node=FakeNode)
    module(
        "rclpy.qos",
        QoSProfile=value,
        HistoryPolicy=value(KEEP_LAST=1),
        ReliabilityPolicy=value(BEST_EFFORT=1),
    )
    module("rclpy.time", Time=value)
    module("sensor_msgs")
    module("sensor_msgs.msg", PointCloud2=value, PointField=value)
    module("std_msgs")
    module("std_msgs.msg", Header=value)
    module(
        "tf2_ros",
        Buffer=FakeBuffer,
        TransformException=TransformError,
        TransformListener=lambda buffer, node: None,
    )
    monkeypatch.delitem(sys.modules, "dynaviz.ros2.node", raising=False)
    monkeypatch.setattr(FakeBuffer, "known", KnownUntil())
    monkeypatch.setattr(FakeNode, "given", {"method": "octomap", "sensor": "vlp16", "reach": 30.0})
    made = importlib.import_module("dynaviz.ros2.node").LiveNode()
    yield made
    made.close()
    sys.modules.pop("dynaviz.ros2.node", None)


def wait_for(found: Callable[[], bool]) -> None:
    """Wait at most 60 s for another thread."""
    ended = threading.Event()
    for _ in range(1200):
        if found():
            return
        ended.wait(0.05)
    raise AssertionError("another thread did not do its work")


def test_the_node_waits_labels_and_maps(node: Any) -> None:
    times = np.linspace(0, 0.1, 900)
    points = np.random.default_rng(0).normal(size=(900, 3)) * 5 + 8
    node.on_cloud(message_of(points, 0, times))
    assert len(node._waiting) == 1
    FakeBuffer.known.moment = SWEEP + 1_000
    node.on_timer()
    wait_for(lambda: len(node.topics["labelled"]) == 1)
    (labelled,) = node.topics["labelled"]
    assert [field.name for field in labelled.fields][-2:] == ["label", "reason"]
    assert labelled.width == 900
    assert isinstance(labelled.data, array)
    wait_for(lambda: len(node.topics["static_map"]) > 0)
    sent = node.topics["static_map"][-1]
    assert sent.header.frame_id == "odom"
    assert sent.width == len(node._live.map()) > 0
    placed = messages.points_of(sent)
    assert placed.shape == (sent.width, 3)


def test_the_node_says_why_it_dropped_a_cloud(node: Any) -> None:
    node.on_cloud(message_of(POINTS, 5 * SWEEP))
    node.now = 600_000_000
    node.on_timer()
    assert "cloud dropped: no transform within 0.5 s: extrapolation into the future" in node.said


def test_of_two_clouds_that_wait_to_be_labelled_the_later_one_is(node: Any) -> None:
    """A method that is slower than the sensor."""
    FakeBuffer.known.moment = 9 * SWEEP
    busy = threading.Event()
    labelled: list[int] = []

    def slowly(ready: Any) -> None:
        busy.wait(60)
        labelled.append(ready.stamp)

    node.label = slowly
    node.on_cloud(message_of(POINTS, 0))
    wait_for(lambda: node._next.empty())
    for k in (1, 2, 3):
        node.on_cloud(message_of(POINTS, k * SWEEP))
    busy.set()
    wait_for(lambda: len(labelled) == 2)
    assert labelled == [0, 3 * SWEEP]
    node.on_timer()
    assert any("the method is slower than the sensor" in text for text in node.said)


def test_the_launch_file_names_the_parameters_of_the_node(
    node: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its defaults are those of the node, and the page lists both."""
    root = Path(__file__).parents[2]
    for name, content in {
        "launch": {"LaunchDescription": list},
        "launch.actions": {"DeclareLaunchArgument": lambda name, **more: (name, more)},
        "launch.substitutions": {"LaunchConfiguration": str},
        "launch_ros": {},
        "launch_ros.actions": {"Node": lambda **more: more},
        "launch_ros.parameter_descriptions": {"ParameterValue": lambda value, value_type: value},
    }.items():
        made = ModuleType(name)
        made.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, made)
    space: dict[str, Any] = {"__name__": "live_launch"}
    text = (root / "examples/ros2/live.launch.py").read_text()
    exec(compile(text, "live.launch.py", "exec"), space)
    arguments = space["ARGUMENTS"]
    known = importlib.import_module("dynaviz.ros2.node").PARAMETERS
    assert arguments.keys() == known.keys()
    for name, (default, kind, _) in arguments.items():
        read = default == "true" if kind is bool else kind(default)
        assert read == known[name]
    *_, started = space["generate_launch_description"]()
    assert (started["package"], started["executable"]) == ("dynaviz", "live")
    page = (root / "docs/live.md").read_text()
    for name, (_, _, meaning) in arguments.items():
        assert f"| `{name}` |" in page, name
        assert meaning
