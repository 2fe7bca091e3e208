"""Bags of every kind, written with rosbags: clouds of any layout, poses from every source."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.bags import KINDS, POSES, START, XYZ, BagWriter, N, at, columns, drive

import dynaviz as dv
from dynaviz import api
from dynaviz.contracts.scan import Sequence
from dynaviz.errors import DataError, UsageError
from dynaviz.sources.datasets.rosbag import RosBagSequence

MOUNT = at(0.5, 0.0, 1.2, np.pi / 2)  # T_base_lidar


def placed(xyz: np.ndarray, T: np.ndarray) -> np.ndarray:
    return xyz.astype(np.float64) @ T[:3, :3].T + T[:3, 3]


def assert_equal(
    sequence: Sequence, poses: np.ndarray = POSES, clouds: np.ndarray = XYZ, first: int = 0
) -> None:
    assert len(sequence) == len(poses)
    for k, T in enumerate(poses):
        scan = sequence[k]
        assert scan.index == first + k
        np.testing.assert_allclose(scan.T_world_sensor, T, atol=1e-9)
        np.testing.assert_allclose(scan.points, placed(clouds[first + k], T), atol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_bag(tmp_path: Path, kind: str) -> None:
    path = drive(tmp_path / "drive", kind)
    sequence = dv.open(path)
    assert isinstance(sequence.reader, RosBagSequence)
    assert (sequence.name, sequence.has_labels) == ("drive", False)
    assert_equal(sequence)
    assert sequence[2].stamp_ns == START + 200_000_000
    assert sequence.facts["poses"] == "/odom"
    assert sequence.facts["deskewed"] == "no, points have no times"
    for file in path.glob("*.[dm][bc]*"):  # the storage file alone
        assert_equal(dv.open(file))


def test_frames_in_any_order_and_from_other_threads(tmp_path: Path) -> None:
    sequence = dv.open(drive(tmp_path / "drive", "mcap"))
    expected = [sequence[k].points for k in range(N)]
    for k in (5, 0, 3, 3, 1, -1):
        np.testing.assert_array_equal(sequence[k].points, expected[k])
    with pytest.raises(IndexError):
        sequence[N]
    wrong: list[int] = []

    def read() -> None:
        wrong.extend(
            k
            for _ in range(5)
            for k in range(N)
            if not np.array_equal(sequence[k].points, expected[k])
        )

    threads = [threading.Thread(target=read) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_only_requested_clouds_are_in_memory(tmp_path: Path) -> None:
    """Ten clouds of 2 MB each are read one after another, and never all of them are in memory."""
    import tracemalloc

    xyz = np.ones((150_000, 3), np.float32)
    with BagWriter(tmp_path / "drive", "sqlite3") as bag:
        for k in range(10):
            bag.cloud(k / 10, columns(xyz))
            bag.odometry(k / 10, at(k))
    tracemalloc.start()
    sequence = dv.open(bag.path)
    opening = tracemalloc.get_traced_memory()
    for k in range(10):
        assert len(sequence[k]) == len(xyz)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert opening[0] < 2e6  # the index, no clouds
    assert opening[1] < 4 * xyz.nbytes
    assert peak < 12 * xyz.nbytes  # one cloud in float32 and float64


@pytest.mark.parametrize(
    ("kind", "layout"),
    [
        ("f4", {"before": 4, "gap": 3}),
        ("f8", {"gap": 1}),
        ("f4", {"order": ">"}),
        ("f8", {"order": ">", "before": 2}),
        ("f4", {"height": 4}),
        ("f4", {"height": 4, "row_gap": 24, "gap": 4}),
        ("i2", {}),
    ],
)
def test_any_layout_of_points(tmp_path: Path, kind: str, layout: dict[str, Any]) -> None:
    clouds = np.round(XYZ) if kind == "i2" else XYZ
    ring = np.arange(60, dtype="u2")
    with BagWriter(tmp_path / "drive") as bag:
        for k in range(N):
            xyz = columns(clouds[k], kind)
            bag.cloud(k / 10, {"ring": ring, "z": xyz["z"], "x": xyz["x"], "y": xyz["y"]}, **layout)
            bag.odometry(k / 10, POSES[k])
    assert_equal(dv.open(bag.path), clouds=clouds)


def test_missing_returns_become_nan(tmp_path: Path) -> None:
    xyz = XYZ[0].copy()
    xyz[3], xyz[4] = np.nan, 0
    with BagWriter(tmp_path / "drive") as bag:
        bag.cloud(0, columns(xyz))
        bag.cloud(1, columns(np.empty((0, 3))))
        bag.odometry(0, POSES[0])
        bag.odometry(1, POSES[0])
    sequence = dv.open(bag.path)
    assert np.isnan(sequence[0].points[3:5]).all()
    assert np.isfinite(np.delete(sequence[0].points, [3, 4], 0)).all()
    assert len(sequence[1]) == 0


def test_odometry_at_a_different_rate_is_interpolated(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive") as bag:
        for k in range(N):
            bag.cloud(k / 10, columns(XYZ[k]))
        for k in range(-1, 15):
            seconds = 0.04 * k
            bag.odometry(seconds, at(20 * seconds, 0, 0, 2 * seconds))
    assert_equal(dv.open(bag.path), np.array([at(2.0 * k, 0, 0, 0.2 * k) for k in range(N)]))


def test_poses_of_a_pose_topic_are_lidar_poses(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive", "sqlite3") as bag:
        for k in range(N):
            bag.cloud(k / 10, columns(XYZ[k]))
            bag.pose(k / 10, POSES[k])
    assert_equal(dv.open(bag.path))


def robot(
    path: Path, *, static: bool = True, odometry: bool = True, tf: bool = True, world: bool = False
) -> Path:
    """odom -> base_link moves, base_link -> tower -> lidar is static, and map -> odom jumps if
    ``world`` is set.
    """
    with BagWriter(path) as bag:
        if static:
            bag.transform(0, "base_link", "tower", at(0.5), static=True)
            bag.transform(0, "/tower", "/lidar", at(0, 0, 1.2, np.pi / 2), static=True)
        for k in range(N):
            if tf:
                bag.transform(k / 10, "odom", "base_link", POSES[k])
            if world:
                bag.transform(k / 10, "map", "odom", at(100, k, 0, 0.1 * k))
            if odometry:
                bag.odometry(k / 10, POSES[k], child="base_link")
            bag.cloud(k / 10, columns(XYZ[k]), frame="/lidar")
    return bag.path


@pytest.mark.parametrize(("odometry", "tf"), [(True, False), (False, True), (True, True)])
def test_the_mount_of_the_lidar_is_applied(tmp_path: Path, odometry: bool, tf: bool) -> None:
    sequence = dv.open(robot(tmp_path / "drive", odometry=odometry, tf=tf))
    assert_equal(sequence, np.array([T @ MOUNT for T in POSES]))
    assert sequence.facts["poses"] == ("TF from lidar to odom" if tf else "/odom")


def test_several_world_frames_are_reported(tmp_path: Path) -> None:
    path = robot(tmp_path / "drive", world=True)
    with pytest.raises(
        DataError, match=r"several sources of poses: odom, map\. Choose one: poses=.odom"
    ):
        dv.open(path)
    assert_equal(dv.open(path, poses="odom"), np.array([T @ MOUNT for T in POSES]))
    assert_equal(dv.open(path, poses="/odom"), np.array([T @ MOUNT for T in POSES]))
    assert_equal(
        dv.open(path, poses="map"),
        np.array([at(100, k, 0, 0.1 * k) @ T @ MOUNT for k, T in enumerate(POSES)]),
    )
    with pytest.raises(
        UsageError,
        match=r"poses=.mop.: not a file, and not .* Available: /odom, tower, base_link, odom, map",
    ):
        dv.open(path, poses="mop")


def test_frames_are_connected_through_their_common_parent(tmp_path: Path) -> None:
    imu = at(-0.3, 0.1, 0.2, 0.7)
    with BagWriter(tmp_path / "drive") as bag:
        bag.transform(0, "base_link", "imu", imu, static=True)
        bag.transform(0, "base_link", "lidar", MOUNT, static=True)
        for k in range(N):
            bag.odometry(k / 10, POSES[k], child="imu")
            bag.cloud(k / 10, columns(XYZ[k]))
    assert_equal(dv.open(bag.path), np.array([T @ np.linalg.inv(imu) @ MOUNT for T in POSES]))


def test_a_missing_transform_is_reported_with_a_hint(tmp_path: Path) -> None:
    path = robot(tmp_path / "drive", static=False, tf=False)
    with pytest.raises(
        DataError,
        match=r"/odom has poses of base_link, but there is no TF from lidar to it.*add "
        r"poses=./odom.",
    ):
        dv.open(path)
    with pytest.warns(
        UserWarning,
        match="no TF from lidar to base_link; using the poses of /odom as those of the lidar",
    ):
        assert_equal(dv.open(path, poses="/odom"))
    with pytest.raises(
        DataError, match=r"has no poses: .* no TF from lidar to a world frame.*poses=FILE"
    ):
        dv.open(robot(tmp_path / "other", static=False, odometry=False))


def test_a_static_lidar(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive") as bag:
        bag.transform(0, "map", "lidar", POSES[3], static=True)
        for k in range(N):
            bag.cloud(k / 10, columns(XYZ[k]))
    assert_equal(dv.open(bag.path), np.repeat(POSES[3:4], N, 0))


def test_several_cloud_topics_are_reported(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive", "mcap") as bag:
        for k in range(N):
            bag.cloud(k / 10, columns(XYZ[k]))
            bag.cloud(k / 10, columns(XYZ[k] + 1), topic="/rear/points")
            bag.odometry(k / 10, POSES[k])
    with pytest.raises(
        DataError,
        match=r"several PointCloud2 topics: /points, /rear/points\. Choose one: .*drive#/points",
    ):
        dv.open(bag.path)
    for prefix in ("", "rosbag:"):
        assert_equal(dv.open(f"{prefix}{bag.path}#/rear/points"), clouds=XYZ + 1)
    with pytest.raises(
        UsageError, match=r"#/points2: no such PointCloud2 topic\. Available: /points, /rear/points"
    ):
        dv.open(f"{bag.path}#/points2")


def test_a_bag_without_clouds_is_reported(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive") as bag:
        bag.odometry(0, POSES[0])
    with pytest.raises(DataError, match="has no PointCloud2 topic, only nav_msgs/msg/Odometry"):
        dv.open(bag.path)


def test_clouds_outside_the_poses_are_skipped(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive") as bag:
        for k in range(N):
            bag.cloud(k / 10, columns(XYZ[k]))
            if k in (2, 3, 4):
                bag.odometry(k / 10, POSES[k])
    with pytest.warns(
        UserWarning,
        match="3 of 6 scans are outside the time span of the poses from /odom and are skipped",
    ):
        sequence = dv.open(bag.path)
    assert_equal(sequence, POSES[2:5], first=2)


def test_clouds_without_stamp_use_the_recording_time(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive") as bag:
        for k in range(N):
            bag.cloud(None, columns(XYZ[k]), recorded=k / 10)
            bag.odometry(k / 10, POSES[k])
    with pytest.warns(
        UserWarning, match="6 messages of /points have no stamp; using their recording time"
    ):
        assert_equal(dv.open(bag.path))


def test_odometry_without_stamp_uses_the_recording_time(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive") as bag:
        for k in range(N):
            bag.cloud(k / 10, columns(XYZ[k]))
            bag.odometry(None, POSES[k], recorded=k / 10)
    with pytest.warns(
        UserWarning, match="6 messages of /odom have no stamp; using their recording time"
    ):
        assert_equal(dv.open(bag.path))


def test_a_goal_is_not_a_trajectory(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive") as bag:
        for k in range(N):
            bag.cloud(k / 10, columns(XYZ[k]))
        bag.pose(0.2, POSES[4], topic="/goal")
    with pytest.raises(DataError, match="has no poses"):
        dv.open(bag.path)
    assert_equal(dv.open(bag.path, poses="/goal"), np.repeat(POSES[4:5], N, 0))  # of a static lidar


def test_decreasing_stamps_are_reported(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive") as bag:
        for k, seconds in enumerate((0.0, 0.1, 0.2, 0.1, 0.3, 0.5)):
            bag.cloud(seconds, columns(XYZ[k]), recorded=k / 10)
            bag.odometry(k / 10, POSES[k])
    with pytest.warns(UserWarning, match="the stamps of /points decrease at cloud 3"):
        sequence = dv.open(bag.path)
    np.testing.assert_allclose(sequence[3].T_world_sensor, POSES[1], atol=1e-9)


def test_clouds_with_the_same_recording_time_are_distinguished(tmp_path: Path) -> None:
    for kind in KINDS:
        with BagWriter(tmp_path / kind, kind) as bag:
            for k in range(N):
                bag.cloud(k / 10, columns(XYZ[k]), recorded=(k // 3) / 10)
                bag.odometry(k / 10, POSES[k])
        assert_equal(dv.open(bag.path))


def test_a_pose_file(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive") as bag:
        for k in range(N):
            bag.cloud(k / 10, columns(XYZ[k]))
    poses = tmp_path / "poses.txt"
    np.savetxt(poses, POSES[:, :3].reshape(N, 12))
    assert_equal(dv.open(bag.path, poses=poses))
    np.savetxt(poses, POSES[1:, :3].reshape(N - 1, 12))
    with pytest.raises(DataError, match="has 5 poses, but there are 6 scans in"):
        dv.open(bag.path, poses=poses)
    poses.write_text("".join(f"{START / 1e9 + k / 10:.6f} {2 * k} 0 0 0 0 0 1\n" for k in (0, 4)))
    with pytest.warns(UserWarning, match="1 of 6 scans"):
        assert_equal(dv.open(bag.path, poses=poses), np.array([at(2 * k) for k in range(5)]))


def test_clouds_in_the_world_frame(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive") as bag:
        for k in range(N):
            bag.cloud(k / 10, columns(placed(XYZ[k], POSES[k])), frame="odom")
            bag.odometry(k / 10, POSES[k], child="body")
    with pytest.raises(
        DataError,
        match=r"clouds are already in the world frame odom of /odom.*Add points_in=.world. "
        r"poses=./odom.",
    ):
        dv.open(bag.path)
    assert_equal(dv.open(bag.path, points_in="world", poses="/odom"))


SWEEP = np.linspace(0, 0.0999, 60)


@pytest.mark.parametrize(
    ("field", "times"),
    [
        ("t", np.round(SWEEP * 1e9).astype("u4")),
        ("time", SWEEP.astype("f4")),
        ("timestamp", START / 1e9 + SWEEP),
        ("offset_time", np.round(SWEEP * 1e9).astype("u4")),
    ],
)
def test_sweeps_are_deskewed(tmp_path: Path, field: str, times: np.ndarray) -> None:
    """At 15 m/s points move by up to 1.5 m during a sweep.

    Each ray starts at the sensor position of its time.
    """
    with BagWriter(tmp_path / "drive") as bag:
        for k in range(N):
            more = {field: times + k / 10 if field == "timestamp" else times}
            bag.cloud(k / 10, columns(XYZ[k], **more))
        for k in range(70):
            bag.odometry(k / 100, at(15 * k / 100, 0, 0, k / 100))
    sequence = dv.open(bag.path)
    assert sequence.facts["deskewed"] == f"with the field {field}"
    scan = sequence[3]
    poses = np.array([at(15 * (0.3 + s), 0, 0, 0.3 + s) for s in SWEEP])
    expected = np.array([placed(p[None], T)[0] for p, T in zip(XYZ[3], poses, strict=True)])
    np.testing.assert_allclose(scan.points, expected, atol=1e-3)
    np.testing.assert_allclose(scan.origins, poses[:, :3, 3], atol=1e-3)
    np.testing.assert_allclose(scan.times, SWEEP, atol=1e-6)
    plain = dv.open(bag.path, deskew=False)
    np.testing.assert_allclose(plain[3].points, placed(XYZ[3], at(4.5, 0, 0, 0.3)), atol=1e-4)
    assert plain[3].origins.shape == (1, 3)
    assert plain[3].times is None
    assert np.linalg.norm(plain[3].points - scan.points, axis=1).max() > 1.0


def test_an_incomplete_sweep_does_not_change_the_unit_of_times(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive") as bag:
        for k in range(N):
            n = 60 if k else 2  # the first has two points, 1.7 ms apart
            bag.cloud(k / 10, columns(XYZ[k][:n], t=np.round(SWEEP[:n] * 1e9).astype("u4")))
        for k in range(70):
            bag.odometry(k / 100, at(15 * k / 100))
    scan = dv.open(bag.path)[0]
    np.testing.assert_allclose(scan.origins[:, 0], 15 * SWEEP[:2], atol=1e-3)


@pytest.fixture
def real_tracking(shared: Path, tmp_path: Path) -> Path:
    """The first frames of a real drive in the layout of KITTI tracking."""
    code = (
        f"import pathlib, runpy; script = runpy.run_path({str(shared / 'data/unpack.py')!r})\n"
        "script['tracking'].__globals__['range'] = lambda frames: range(min(frames, 3))  # all "
        "would take long\n"
        f"script['tracking'](pathlib.Path({str(tmp_path)!r}))\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
    return tmp_path / "kitti_tracking/training"


@pytest.mark.slow
def test_a_bag_of_real_sweeps_gives_the_same_labels_as_the_folder(
    real_tracking: Path, tmp_path: Path
) -> None:
    from dynaviz.io.velodyne import read_velodyne
    from dynaviz.sources.datasets.kitti_tracking import KittiTrackingSequence

    folder = dv.open(real_tracking)
    assert isinstance(folder.reader, KittiTrackingSequence)
    with BagWriter(tmp_path / "drive") as bag:
        for k in range(len(folder)):
            xyzi = read_velodyne(folder.reader.scans[folder[k].index])
            bag.cloud(k / 10, columns(xyzi, intensity=xyzi[:, 3]), frame="velodyne")
            bag.odometry(k / 10, folder[k].T_world_sensor, child="velodyne")
    from_bag, from_folder = (
        api.run("dufomap", sequence) for sequence in (dv.open(bag.path), folder)
    )
    assert from_bag.labels_sha256 == from_folder.labels_sha256
    assert from_bag.sequence.points > 300_000
