"""Bags that are cut, damaged or absent, and messages that are none."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.bags import KINDS, POSES, XYZ, BagWriter, columns, drive

import dynaviz as dv
from dynaviz.errors import DataError, MissingDependency, UsageError


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_bags_are_told(tmp_path: Path, kind: str) -> None:
    path = drive(tmp_path / "drive", kind)
    file = path if path.is_file() else next(path.glob("*.[dm][bc]*"))
    whole = file.read_bytes()
    for share in (0.0, 0.001, 0.3, 0.7, 0.98):
        file.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(DataError, match=r"drive.*is no whole bag"):
            _ = [scan.points for scan in dv.open(path)]  # type: ignore[attr-defined]
    if path.is_dir():
        file.unlink()
        with pytest.raises(DataError, match="is no whole bag"):
            dv.open(path)


def test_random_damage_is_told_or_read(tmp_path: Path) -> None:
    random = np.random.default_rng(5)
    for kind in KINDS:
        path = drive(tmp_path / kind, kind)
        file = path if path.is_file() else next(path.glob("*.[dm][bc]*"))
        whole = np.frombuffer(file.read_bytes(), np.uint8)
        for _ in range(8):
            changed = whole.copy()
            changed[random.integers(0, len(whole), 20)] = random.integers(0, 256, 20)
            file.write_bytes(changed.tobytes())
            try:
                sequence = dv.open(path)
                for k in range(len(sequence)):
                    _ = sequence[k]
            except (DataError, UsageError):
                pass
            except UserWarning:  # warnings are errors here
                pass


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            {"cut": 5},
            r"message 0 of /points: is no cloud: 1 x 60 points of 12 bytes need 720 bytes, the message has 715",
        ),
        ({"only": "xy"}, "is no cloud: no field z, only: x y"),
    ],
)
def test_clouds_that_are_none_are_told(tmp_path: Path, change: dict[str, Any], says: str) -> None:
    only = change.pop("only", "xyz")
    with BagWriter(tmp_path / "drive") as bag:
        bag.cloud(0, {axis: column for axis, column in columns(XYZ[0]).items() if axis in only}, **change)
        bag.odometry(0, POSES[0])
    with pytest.raises(DataError, match=says):
        dv.open(bag.path)[0]


def test_a_pose_that_is_none_is_told(tmp_path: Path) -> None:
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
    with pytest.raises(DataError, match=r"drive\.bag, /pose: has a pose that is none"):
        dv.open(bag.path)


def test_without_rosbags_the_command_that_installs_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = drive(tmp_path / "drive")
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(MissingDependency, match=r"pip install 'dynaviz\[ros\]'"):
        dv.open(path)


def test_a_bag_that_is_absent(tmp_path: Path) -> None:
    for text in (tmp_path / "none.bag", f"rosbag:{tmp_path}/none"):
        with pytest.raises(DataError, match="does not exist"):
            dv.open(text)
