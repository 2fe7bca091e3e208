"""Values that a reader does not expect: each is refused with the file and the place."""

from __future__ import annotations

import contextlib
import json
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.bags import BagWriter, at, columns
from helpers.kitti_files import write_raw_drive
from helpers.nuscenes_files import write_nuscenes
from helpers.scan_folders import WRITERS, XYZ

from dynaviz.errors import DataError
from dynaviz.io.fields import read_points
from dynaviz.io.kitti import read_boxes, read_tracklets
from dynaviz.io.poses import read_poses
from dynaviz.sources.datasets import open_sequence

Command = Callable[..., tuple[int, str, str]]


@pytest.mark.parametrize("encoding", ["martian", "utf-7", "base64", "idna"])
def test_tracklets_in_an_encoding_that_xml_does_not_know(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "tracklet_labels.xml"
    path.write_text(f'<?xml version="1.0" encoding="{encoding}"?><boost><tracklets/></boost>')
    with pytest.raises(DataError, match=r"tracklet_labels\.xml, line 1: not valid XML"):
        read_tracklets(path)


def test_tracklets_with_values_that_are_not_finite(tmp_path: Path) -> None:
    write_raw_drive(tmp_path)
    path = next(tmp_path.rglob("tracklet_labels.xml"))
    content = path.read_text()
    for tag in ("rz", "tx", "h"):
        path.write_text(re.sub(rf"<{tag}>[^<]*<", f"<{tag}>nan<", content, count=1))
        with pytest.raises(DataError, match=r"tracklet 0: a number is missing or not finite"):
            open_sequence(f"kitti_raw:{path.parent}")


def test_boxes_with_values_out_of_range(tmp_path: Path) -> None:
    box = "0 1 Car 0 0 0 0 0 9 9 2 2 4 1 1.7 9 0"
    for before, after in (
        ("1 Car", "4294967296 Car"),
        ("0 1", "99999999999 1"),
        ("1.7", "nan"),
        ("2 2 4", "2 inf 4"),
    ):
        (tmp_path / "a.txt").write_text(f"{box}\n{box.replace(before, after)}\n")
        with pytest.raises(DataError, match=r"a\.txt, line 2: not a valid box"):
            read_boxes(tmp_path / "a.txt")


def test_laz_whose_decompressor_panics(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    WRITERS[".laz"](tmp_path / "a.laz", XYZ[0])
    content = bytearray((tmp_path / "a.laz").read_bytes())
    # the record of the compressor, after its header of 54 bytes
    record = content.index(b"laszip encoded") + 52
    panicked = 0
    for offset in range(0, 40, 2):
        for value in (0, 0xFFFF):
            changed = bytearray(content)
            struct.pack_into("<H", changed, record + offset, value)
            (tmp_path / "b.laz").write_bytes(changed)
            with contextlib.suppress(DataError):
                read_points(tmp_path / "b.laz")
            panicked += "panicked" in capfd.readouterr().err
    assert panicked


def change_table(root: Path, table: str, **values: Any) -> Path:
    """Change values of the last record of a table that has them."""
    path = next(root.rglob(f"{table}.json"))
    rows = json.loads(path.read_text())
    for row in rows:
        row.update(values)
    path.write_text(json.dumps(rows))
    return path


@pytest.mark.parametrize(
    ("table", "key", "value", "problem"),
    [
        ("sample_data", "timestamp", 10**40, "timestamp = 10000.* is not a time in microseconds"),
        ("sample_data", "timestamp", 1 << 62, "is not a time in microseconds"),
        ("sample_data", "timestamp", "noon", "timestamp is not a number of microseconds"),
        ("sample_data", "timestamp", 1e9, "timestamp is not a number of microseconds"),
        ("sample_data", "ego_pose_token", {"a": 1}, "ego_pose_token is not text"),
        ("sample_data", "filename", ["x"], "filename is not text"),
        ("sample_data", "filename", "x" * 5000, "does not exist"),
        ("sample_data", "filename", "x\0y", "does not exist"),
        ("sample_data", "is_key_frame", None, "is_key_frame is not true or false"),
        ("scene", "name", {}, "name is not text"),
        ("sample", "token", [1], "token is not text"),
        ("sensor", "token", {"a": []}, "token is not text"),
        ("ego_pose", "rotation", [10**400, 0, 0, 0], "no valid translation and rotation"),
        ("ego_pose", "rotation", [float("nan"), 0, 0, 0], "no valid translation and rotation"),
        ("ego_pose", "translation", [0, float("inf"), 0], "no valid translation and rotation"),
        ("ego_pose", "translation", [0, 1e200, 0], "no valid translation and rotation"),
        ("calibrated_sensor", "translation", 5, "translation is not a list of numbers"),
        ("sample_annotation", "size", [1, 10**400, 1], "no valid size"),
        ("sample_annotation", "size", [1, float("nan"), 1], "no valid size"),
        ("sample_annotation", "size", [1, 1, 1e200], "no valid size"),
        ("category", "name", None, "name is not text"),
    ],
)
def test_nuscenes_tables(tmp_path: Path, table: str, key: str, value: Any, problem: str) -> None:
    root = write_nuscenes(tmp_path)
    change_table(tmp_path, table, **{key: value})
    with pytest.raises(DataError, match=problem) as caught:
        open_sequence(f"nuscenes:{root}")
    assert "filename" in key or Path(caught.value.path).name == f"{table}.json"


@pytest.mark.parametrize("command", ["info", "doctor", "run", "report", "view", "check"])
def test_a_name_longer_than_the_system_allows(
    tmp_path: Path, run_command: Command, command: str
) -> None:
    name = tmp_path / ("x" * 5000)
    words = {"run": ["octomap", name], "check": [name, "--min", "SA=50"]}.get(command, [name])
    code, _, err = run_command(command, *words)
    assert (code, err.count("\n")) == (2, 1), err
    assert "File name too long" in err


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_bag_with_a_pose_that_is_not_finite(tmp_path: Path, value: float) -> None:
    with BagWriter(tmp_path / "drive", "mcap") as writer:
        writer.transform(0, "base", "lidar", at(0, 0, 1), static=True)
        for k in range(3):
            writer.cloud(k / 10, columns(np.zeros((5, 3))))
            writer.odometry(k / 10, at(value if k == 1 else k), child="base")
    with pytest.raises(
        DataError, match=r"drive.*, /odom: invalid pose \(position .* is not finite\)"
    ):
        open_sequence(f"rosbag:{writer.path}")


@pytest.mark.parametrize(
    ("time", "unit", "likely"),
    [
        (
            "1700000000000000000000",
            "",
            "1700000000000000000000 ns is after the year 2262; 22 digits suggest picoseconds",
        ),
        (
            "1700000000000000000",
            " [s]",
            "1700000000000000000 s is after the year 2262; 19 digits suggest nanoseconds",
        ),
        (
            "1700000000000000",
            " [ms]",
            "1700000000000000 ms is after the year 2262; 16 digits suggest microseconds",
        ),
    ],
)
def test_times_beyond_64_bits(tmp_path: Path, time: str, unit: str, likely: str) -> None:
    (tmp_path / "a.csv").write_text(f"stamp{unit},x,y,z,qx,qy,qz,qw\n{time},1,2,3,0,0,0,1\n")
    with pytest.raises(
        DataError,
        match=rf"a\.csv, line 2: not a valid time \({likely} since 1970\)\. Give times in s",
    ):
        read_poses(tmp_path / "a.csv")


def test_a_scan_named_by_a_time_beyond_64_bits(tmp_path: Path) -> None:
    for name in ("1700000000000000000000.npy", "1700000000100000000000.npy"):
        np.save(tmp_path / name, np.zeros((3, 3), np.float32))
    with pytest.raises(
        DataError, match=r"0\.npy: its name is not a valid time .* 22 digits suggest picoseconds"
    ):
        open_sequence(f"files:{tmp_path}")


@pytest.mark.parametrize("number", ["1e308", "9" * 30, "-9e18"])
def test_poses_with_scan_numbers_beyond_64_bits(tmp_path: Path, number: str) -> None:
    (tmp_path / "a.csv").write_text(
        f"index,x,y,z,qx,qy,qz,qw\n0,1,2,3,0,0,0,1\n{number},1,2,3,0,0,0,1\n"
    )
    with pytest.raises(
        DataError, match=rf"a\.csv, line 3: not a valid scan number \({re.escape(number)}\)"
    ):
        read_poses(tmp_path / "a.csv")


SIGNALLING = np.array([0x7F800001], np.uint32).view(np.float32)[
    0
]  # a NaN that raises a warning where it is converted


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("suffix", [".pcd", ".npy"])
def test_signalling_nans_become_quiet(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    WRITERS[suffix](path, np.array([[0, 0, 0], [0, 0, 7.5]], np.float32))
    content = path.read_bytes()
    assert content.endswith(struct.pack("<f", 7.5))
    path.write_bytes(content[:-4] + SIGNALLING.tobytes())
    np.testing.assert_array_equal(read_points(path).astype(np.float64)[1], [0, 0, np.nan])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [SIGNALLING, np.inf, 3e38])
def test_points_that_are_not_finite_are_in_no_box(tmp_path: Path, value: float) -> None:
    write_raw_drive(tmp_path)
    drive = next(tmp_path.rglob("tracklet_labels.xml")).parent
    for path in drive.rglob("*.bin"):
        rows = np.fromfile(path, "<f4").reshape(-1, 4)
        rows[0, 2] = value
        rows.tofile(path)
    scan = open_sequence(f"kitti_raw:{drive}")[1]
    assert scan.instances is not None
    assert scan.instances[0] == 0


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [SIGNALLING, 1e38, -1e38])
def test_points_and_times_of_a_bag_that_are_not_numbers(tmp_path: Path, value: float) -> None:
    with BagWriter(tmp_path / "drive", "mcap") as writer:
        writer.transform(0, "base", "lidar", at(0, 0, 1), static=True)
        for k in range(3):
            xyz, times = np.zeros((5, 3), np.float32), np.linspace(0, 0.1, 5, dtype=np.float32)
            xyz[0, 0] = times[1] = value if k == 2 else 0
            writer.cloud(k / 10, columns(xyz, time=times))
            writer.odometry(k / 10, at(k), child="base")
    scan = open_sequence(f"rosbag:{writer.path}")[2]
    assert scan.times is not None
    assert scan.times[1] == 0


def test_a_topic_with_messages_of_two_types(tmp_path: Path) -> None:
    """Its messages cannot be told apart by the topic."""
    with BagWriter(tmp_path / "drive", "mcap") as writer:
        writer.transform(0, "base", "lidar", at(0, 0, 1), static=True)
        writer.cloud(0, columns(np.zeros((5, 3))))
        writer.odometry(0, at(0), child="base")
    path = tmp_path / "drive/metadata.yaml"
    path.write_text(path.read_text().replace("name: /points", "name: /tf_static"))
    with pytest.raises(
        DataError,
        match=r"drive: truncated or corrupt bag \(a topic has messages of several types\)",
    ):
        open_sequence(f"rosbag:{writer.path}")
