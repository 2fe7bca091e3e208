"""Truncated, corrupt and missing bags, and invalid messages.

Each kind of damage has one expected outcome.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.bags import KINDS, POSES, XYZ, BagWriter, N, columns, drive
from scipy.spatial.transform import Rotation

import dynaviz as dv
from dynaviz.errors import DataError, MissingDependency

CORRUPT = "truncated or corrupt bag"


def storage(path: Path) -> Path:
    """The file with the messages of a bag."""
    return path if path.is_file() else next(path.glob("*.[dm][bc]*"))


def read_all(path: Path) -> np.ndarray:
    """(N, 60, 3): the points of all scans."""
    sequence = dv.open(path)
    return np.array([sequence[k].points for k in range(len(sequence))])


@pytest.mark.parametrize("kind", KINDS)
def test_truncated_bags_are_refused(tmp_path: Path, kind: str) -> None:
    path = drive(tmp_path / "drive", kind)
    file = storage(path)
    content = file.read_bytes()
    for share in (0.0, 0.001, 0.3, 0.7, 0.98):
        file.write_bytes(content[: int(share * len(content))])
        with pytest.raises(DataError, match=rf"drive.*{CORRUPT}"):
            read_all(path)


@pytest.mark.parametrize("kind", ["sqlite3", "mcap"])
def test_a_bag_without_its_storage_is_refused(tmp_path: Path, kind: str) -> None:
    path = drive(tmp_path / "drive", kind)
    storage(path).unlink()
    with pytest.raises(DataError, match=CORRUPT):
        dv.open(path)


def replace(old: bytes, new: bytes) -> Callable[[bytes], bytes]:
    """Replace all occurrences, of which there must be at least one."""

    def change(content: bytes) -> bytes:
        assert old in content
        return content.replace(old, new)

    return change


def overwrite(share: float, new: bytes) -> Callable[[bytes], bytes]:
    """Overwrite bytes that begin at a share of the file.

    Negative shares count from the end of the file.
    """

    def change(content: bytes) -> bytes:
        start = int(share * len(content)) if share >= 0 else len(content) - len(new)
        return content[:start] + new + content[start + len(new) :]

    return change


@dataclass(frozen=True)
class Damage:
    """A change of the stored bytes and its outcome.

    Attributes:
        change: gives the damaged content.
        error: text of the expected DataError by kind of bag; kinds without an entry are read.
        point: the changed point, (scan, row, x, y, z), for bags that are read; None if all scans
            are unchanged.
    """

    change: Callable[[bytes], bytes]
    error: dict[str, str]
    point: tuple[int, int, float, float, float] | None = None


def every_kind(error: str) -> dict[str, str]:
    return dict.fromkeys(KINDS, error)


QUATERNION = Rotation.from_matrix(POSES[3][:3, :3]).as_quat().astype("<f8").tobytes()
DAMAGES = {
    "changed point": Damage(
        replace(XYZ[2, 7].astype("<f4").tobytes(), np.array([1, 2, 3], "<f4").tobytes()),
        {},
        (2, 7, 1.0, 2.0, 3.0),
    ),
    "zero quaternion": Damage(
        replace(QUATERNION, bytes(32)), every_kind("/odom: invalid pose .*quaternion")
    ),
    "renamed frame": Damage(replace(b"lidar", b"laser"), {}),
    # ROS 2 bags also have the types in metadata.yaml, which then names a topic without messages.
    "unknown type": Damage(
        replace(b"PointCloud2", b"PointCloud9"),
        {
            "ros1": "has no PointCloud2 topic, only nav_msgs/msg/Odometry, "
            "sensor_msgs/msg/PointCloud9",
            "sqlite3": "no TF from the clouds to it",
            "mcap": "no TF from the clouds to it",
        },
    ),
    "overwritten start": Damage(overwrite(0.0, bytes(13)), every_kind(CORRUPT)),
    "overwritten middle": Damage(overwrite(0.5, b"\xff" * 4096), every_kind(CORRUPT)),
    "overwritten end": Damage(overwrite(-1, bytes(4096)), every_kind(CORRUPT)),
    "appended bytes": Damage(lambda content: content + b"garbage" * 10, {"mcap": CORRUPT}),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", DAMAGES)
def test_each_kind_of_damage_has_its_outcome(tmp_path: Path, name: str, kind: str) -> None:
    damage = DAMAGES[name]
    path = drive(tmp_path / "drive", kind)
    expected, file = read_all(path), storage(path)
    assert expected.shape == (N, 60, 3)
    file.write_bytes(damage.change(file.read_bytes()))
    if kind in damage.error:
        with pytest.raises(DataError, match=damage.error[kind]):
            read_all(path)
        return
    if damage.point:
        scan, row, *xyz = damage.point
        expected[scan, row] = POSES[scan][:3, :3] @ xyz + POSES[scan][:3, 3]
    np.testing.assert_allclose(read_all(path), expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"cut": 5},
            r"message 0 of /points: invalid cloud: 1 x 60 points of 12 bytes need 720 bytes, the "
            r"message has 715",
        ),
        ({"only": "xy"}, r"invalid cloud: field z is missing \(found: x y\)"),
    ],
)
def test_invalid_clouds_are_reported(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    only = change.pop("only", "xyz")
    with BagWriter(tmp_path / "drive") as bag:
        bag.cloud(
            0, {axis: column for axis, column in columns(XYZ[0]).items() if axis in only}, **change
        )
        bag.odometry(0, POSES[0])
    with pytest.raises(DataError, match=message):
        dv.open(bag.path)[0]


def test_an_invalid_pose_is_reported(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive") as bag:
        bag.cloud(0, columns(XYZ[0]))
        header = bag.header(0, "map")
        zero = bag.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=0.0)
        pose = bag.make(
            "geometry_msgs/msg/Pose",
            position=bag.make("geometry_msgs/msg/Point", x=0.0, y=0.0, z=0.0),
            orientation=zero,
        )
        bag.write("/pose", 0, bag.make("geometry_msgs/msg/PoseStamped", header=header, pose=pose))
    with pytest.raises(DataError, match=r"drive\.bag, /pose: invalid pose"):
        dv.open(bag.path)


def test_without_rosbags_the_error_names_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = drive(tmp_path / "drive")
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(MissingDependency, match="pip install rosbags"):
        dv.open(path)


def test_a_missing_bag_is_reported(tmp_path: Path) -> None:
    for text in (tmp_path / "none.bag", f"rosbag:{tmp_path}/none"):
        with pytest.raises(DataError, match="does not exist"):
            dv.open(text)
