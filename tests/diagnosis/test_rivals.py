"""Mounts, delays, orders and worlds that are upside down: named rightly, or nobody can tell.

The street is written as files with one fault each; the advice of the finding is followed.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from helpers.bags import START
from helpers.pose_files import kitti, scans_to, tum
from helpers.street import HEIGHT, RATE, drive, pose, sweep_at
from scipy.spatial.transform import Rotation

import dynaviz as dv
from dynaviz.diagnosis import Confidence, doctor, quick_check
from dynaviz.sources.datasets.pose_matching import parse_extrinsic
from dynaviz.sources.origin import PoseFinding
from dynaviz.spatial import geometry

FRAMES = 36
TIMES = [START + k * 100_000_000 for k in range(FRAMES)]


def written(folder: Path) -> Path:
    """The scans of the street, with times in their names."""
    sweeps = drive(frames=FRAMES)
    scans_to(folder / "scans", [str(t) for t in TIMES], sweeps)
    return folder


def found(folder: Path, **options: str) -> PoseFinding:
    """The only finding."""
    (finding,) = quick_check(dv.open(folder, **options))
    return finding


def vehicle(mount: str) -> list[np.ndarray]:
    """Poses of a vehicle on which the lidar is mounted so."""
    T = parse_extrinsic(mount)
    assert T is not None
    return [sweep.T @ geometry.inverse(T) for sweep in drive(frames=FRAMES)]


@pytest.mark.parametrize(
    "mount",
    [
        "0,0,0,0,0,90",
        "0,0,0,0,0,2",
        "1.2,0.3,0,0,0,0",
        pytest.param("0,0,0,180,0,0", marks=pytest.mark.slow),
        pytest.param("0.5,0,0,0,15,180", marks=pytest.mark.slow),
        pytest.param("0,0,0,90,0,0", marks=pytest.mark.slow),
    ],
)
def test_a_mount_is_named_with_its_option(tmp_path: Path, mount: str) -> None:
    kitti(written(tmp_path) / "poses.txt", vehicle(mount))
    finding = found(tmp_path)
    assert finding.name == "lidar mount"
    option, text = finding.option.split()
    assert option == "--extrinsic"
    given = parse_extrinsic(mount)
    estimated = parse_extrinsic(text)
    assert given is not None
    assert estimated is not None
    turn = Rotation.from_matrix(given[:3, :3].T @ estimated[:3, :3]).magnitude()
    assert np.degrees(turn) < 0.5
    assert np.abs(given - estimated)[:2, 3].max() < 0.15
    assert quick_check(dv.open(tmp_path, extrinsic=text)) == ()


@pytest.mark.parametrize("seconds", [0.2, pytest.param(-0.5, marks=pytest.mark.slow), 18.0])
def test_a_constant_delay_is_named_with_its_seconds(tmp_path: Path, seconds: float) -> None:
    moments = np.arange(-25.0, 28.0, 0.05).tolist()
    late = [START + round((t + seconds) * 1e9) for t in moments]
    tum(written(tmp_path) / "late.tum", [pose(t) for t in moments], late)
    finding = found(tmp_path)
    assert finding.name == "poses late"
    word = "Subtract" if seconds > 0 else "Add"
    stated = re.match(rf"{word} (\d+\.\d+) s", finding.fix)
    assert stated is not None
    assert abs(float(stated[1]) - abs(seconds)) <= 0.02


@pytest.mark.parametrize("order", ["reversed", "shuffled"])
def test_poses_of_other_scans_are_not_explained(tmp_path: Path, order: str) -> None:
    own = [sweep.T for sweep in drive(frames=FRAMES)]
    rows: Sequence[int] = range(FRAMES)[::-1]
    if order == "shuffled":
        blocks = np.arange(FRAMES).reshape(-1, 6)
        rows = np.random.default_rng(0).permuted(blocks, axis=1).ravel().tolist()
    kitti(written(tmp_path) / "poses.txt", [own[k] for k in rows])
    finding = found(tmp_path)
    assert finding.name == "poses do not fit"
    assert finding.option == "--poses small-gicp"


@pytest.mark.parametrize("seconds", [0.0, 2.4], ids=["straight on", "turned round"])
def test_a_map_that_is_upside_down_has_a_finding(tmp_path: Path, seconds: float) -> None:
    """The world is turned over, also if no order of quaternions explains it."""
    over = np.diag([1.0, -1.0, -1.0, 1.0])
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("z", seconds).as_matrix()
    own = [over @ turn @ sweep.T for sweep in drive(frames=FRAMES)]
    kitti(written(tmp_path) / "poses.txt", own)
    assert found(tmp_path).name in ("world not z-up", "quaternion order")


@pytest.mark.parametrize("turned", [0.0, 3.0], ids=["along x", "backwards"])
def test_a_tum_file_may_have_w_first(tmp_path: Path, turned: float) -> None:
    world = np.eye(4)
    world[:3, :3] = Rotation.from_euler("z", turned).as_matrix()
    own = [world @ sweep.T for sweep in drive(frames=FRAMES)]
    tum(written(tmp_path) / "first.tum", own, TIMES, w_first=True)
    sequence = dv.open(tmp_path)
    for position in (0, 10, FRAMES - 1):
        found_pose = sequence[position].T_world_sensor
        np.testing.assert_allclose(found_pose[:3, :3], own[position][:3, :3], atol=1e-5)


def reordered(T: np.ndarray, order: str) -> np.ndarray:
    """The pose whose quaternion, written in this order, is read as x y z w."""
    quaternion = Rotation.from_matrix(T[:3, :3]).as_quat()
    read = T.copy()
    read[:3, :3] = Rotation.from_quat([quaternion["xyzw".index(c)] for c in order]).as_matrix()
    return read


def straight(seconds: float) -> np.ndarray:
    """T_world_sensor: along the street without a turn, facing aside."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("z", 50.0, degrees=True).as_matrix()
    T[:3, 3] = -8 + 5 * seconds, 0.5, HEIGHT
    return T


def straight_drive(folder: Path) -> list[np.ndarray]:
    """The scans of a straight drive, and their poses."""
    sweeps = [sweep_at(k / RATE, 16, 240, False, straight) for k in range(14)]
    scans_to(folder / "scans", [str(t) for t in TIMES[:14]], sweeps)
    return [sweep.T for sweep in sweeps]


@pytest.mark.parametrize(
    "order",
    [
        order if order == "xzwy" else pytest.param(order, marks=pytest.mark.slow)
        for order in map("".join, permutations("xyzw"))
        if order not in ("xyzw", "yxzw")  # the second one hardly changes a sensor that stays level
    ],
)
def test_small_turns_decide_between_orders_that_fit_alike(tmp_path: Path, order: str) -> None:
    own = [sweep.T for sweep in drive(frames=FRAMES)]
    kitti(written(tmp_path) / "poses.txt", [reordered(T, order) for T in own])
    finding = found(tmp_path)
    assert finding.name == "quaternion order"
    named = re.search(r"hold (q[xyzw] q[xyzw] q[xyzw] q[xyzw])", finding.fix)
    assert named is not None
    assert named[1].replace("q", "").replace(" ", "") == order


@pytest.mark.parametrize(
    ("order", "other"),
    [
        ("zxyw", "qz qy qx qw"),
        pytest.param("xzyw", "qy qz qx qw", marks=pytest.mark.slow),
        pytest.param("wzyx", "qw qz qx qy", marks=pytest.mark.slow),
    ],
)
def test_an_order_is_simpler_than_a_mount_about_all_axes_or_of_a_vehicle_on_its_back(
    tmp_path: Path, order: str, other: str
) -> None:
    """On a straight way a mount can explain each order of quaternions, but with fitted angles.

    Nothing decides between them, so the finding is likely and states both. A sensor that stays
    level has x and y of zero, which change places unnoticed: both orders are stated, too.
    """
    kitti(tmp_path / "poses.txt", [reordered(T, order) for T in straight_drive(tmp_path)])
    finding = found(tmp_path)
    assert finding.name == "quaternion order"
    words = f"{finding.problem} {finding.fix}"
    assert " ".join(f"q{c}" for c in order) in words
    assert other in words
    assert re.search(r"lidar mount [-\d.,]+ fits alike", finding.problem)
    (stated,) = doctor(dv.open(tmp_path)).of_poses
    assert stated.confidence == Confidence.LIKELY


@pytest.mark.parametrize("yaw", [30.0, pytest.param(90.0, marks=pytest.mark.slow)])
def test_a_mount_about_one_axis_is_named_on_a_straight_way(tmp_path: Path, yaw: float) -> None:
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("z", yaw, degrees=True).as_matrix()
    own = straight_drive(tmp_path)
    kitti(tmp_path / "poses.txt", [T @ geometry.inverse(turn) for T in own])
    assert found(tmp_path).name == "lidar mount"


def test_poses_in_ned_are_named(tmp_path: Path) -> None:
    axes = np.diag([1.0, -1.0, -1.0, 1.0])
    world = np.array([[0.0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]])
    own = [world @ sweep.T @ axes for sweep in drive(frames=FRAMES)]
    kitti(written(tmp_path) / "poses.txt", own)
    assert found(tmp_path).name == "poses in NED"


def test_right_poses_have_no_finding(tmp_path: Path) -> None:
    kitti(written(tmp_path) / "poses.txt", [sweep.T for sweep in drive(frames=FRAMES)])
    assert quick_check(dv.open(tmp_path)) == ()
