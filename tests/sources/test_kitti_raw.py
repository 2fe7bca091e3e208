"""KITTI raw and KITTI odometry, and the variants of SemanticKITTI."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from helpers.kitti_files import write_odometry, write_oxts, write_raw_drive

from dynaviz.errors import DataError
from dynaviz.io.kitti import read_oxts
from dynaviz.sources.datasets import open_sequence
from dynaviz.sources.datasets.kitti_odometry import KittiOdometrySequence
from dynaviz.sources.datasets.kitti_raw import KittiRawSequence
from dynaviz.sources.datasets.semantickitti import SemanticKittiSequence


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    return write_raw_drive(tmp_path)


def test_tracklets_become_labels(drive: Path) -> None:
    sequence = open_sequence(str(drive))
    scan = sequence[0]
    assert scan.labels.tolist() == [1, 255, 255, 0, 0, 255]  # type: ignore[union-attr]
    assert scan.instances.tolist() == [1, 0, 0, 2, 0, 0]  # type: ignore[union-attr]
    assert [scan.class_names[kind] for kind in scan.classes[[0, 3]].tolist()] == ["car", "van"]  # type: ignore[index]
    # the car has moved on
    assert sequence[1].labels.tolist() == [0, 0, 0, 0, 0, 255]  # type: ignore[union-attr]
    assert (sequence[2].instances == 0).all()  # the van's track has ended


def test_frames_keep_their_numbers_and_stamps(drive: Path) -> None:
    sequence = open_sequence(str(drive))
    assert isinstance(sequence.reader, KittiRawSequence)
    assert (sequence.name, sequence.sensor.name) == ("kitti_raw_2011_09_26_drive_0009", "hdl64e")
    assert [sequence[k].index for k in range(len(sequence))] == [0, 1, 3]
    start = 1_317_042_145_000_000_000
    assert [sequence[k].stamp_ns for k in range(3)] == [
        start + 1,
        start + 100_000_001,
        start + 300_000_001,
    ]
    path = drive / "velodyne_points/timestamps.txt"
    path.write_text(
        "".join(path.read_text().splitlines(keepends=True)[:3])
    )  # a line per sweep instead of per frame
    assert open_sequence(str(drive))[2].stamp_ns == start + 200_000_001
    path.unlink()
    assert open_sequence(str(drive))[0].stamp_ns is None


def test_poses_of_the_imu_are_converted(drive: Path) -> None:
    write_oxts(drive / "oxts/data/0000000003.txt", yaw=np.pi)
    expected = [
        [-1, 0, 0, -2],
        [0, -1, 0, 0],
        [0, 0, 1, 0],
        [0, 0, 0, 1],
    ]  # the sensor is 1 m ahead of the IMU
    np.testing.assert_allclose(open_sequence(str(drive))[2].T_world_sensor, expected, atol=1e-9)


def test_north_is_left_of_a_car_that_heads_east(drive: Path) -> None:
    write_oxts(drive / "oxts/data/0000000003.txt", latitude=49.0 + 1e-4)
    metres = np.radians(1e-4) * 6378137
    np.testing.assert_allclose(open_sequence(str(drive))[2].position, [0, metres, 0], atol=1e-3)


def test_a_file_per_frame_equals_a_line_per_frame(drive: Path, tmp_path: Path) -> None:
    files = sorted((drive / "oxts/data").iterdir())
    for k, file in enumerate(files):
        write_oxts(file, latitude=49.0 + 1e-5 * k, yaw=0.1 * k)
    (tmp_path / "all.txt").write_text("".join(file.read_text() for file in files))
    np.testing.assert_array_equal(read_oxts(*files), read_oxts(tmp_path / "all.txt"))


def test_without_tracklets_there_are_no_labels_and_no_camera_is_needed(drive: Path) -> None:
    (drive / "tracklet_labels.xml").unlink()
    (drive.parent / "calib_cam_to_cam.txt").unlink()
    sequence = open_sequence(str(drive))
    assert not sequence.has_labels
    assert sequence[0].labels is None


@pytest.mark.parametrize("inner", ["", "velodyne_points", "velodyne_points/data", "..", "../.."])
def test_a_drive_is_found_from_related_folders(drive: Path, inner: str) -> None:
    assert isinstance(open_sequence(str(drive / inner)).reader, KittiRawSequence)


def test_several_drives_are_reported(drive: Path) -> None:
    shutil.copytree(drive, drive.parent / "2011_09_26_drive_0011_sync")
    with pytest.raises(
        DataError, match="several drives: 2011_09_26_drive_0009_sync, 2011_09_26_drive_0011_sync"
    ):
        open_sequence(str(drive.parent))


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("oxts/data/0000000001.txt", None, "oxts/data: no record for the sweep of frame 1"),
        ("oxts/data/0000000001.txt", "1 2 3\n", r"0000000001\.txt, line 1: cannot be read"),
        ("oxts/data/0000000001.txt", "", r"0000000001\.txt: has 0 lines, expected one per frame"),
        (
            "velodyne_points/timestamps.txt",
            "2011-09-26 13:02:25\n",
            r"timestamps\.txt: has only 1 lines, but there is a sweep 3",
        ),
        (
            "velodyne_points/timestamps.txt",
            "a\n\nb\nc\n",
            r"timestamps\.txt, line 1: not a valid time",
        ),
        (
            "tracklet_labels.xml",
            "<boost_serialization><tracklets>",
            r"tracklet_labels\.xml, line 1: not valid XML",
        ),
        (
            "tracklet_labels.xml",
            "<boost_serialization/>",
            r"tracklet_labels\.xml: the element <tracklets> is missing",
        ),
        (
            "tracklet_labels.xml",
            "<a><tracklets><item/></tracklets></a>",
            r"tracklet_labels\.xml, tracklet 0: a number is missing",
        ),
        (
            "../calib_imu_to_velo.txt",
            None,
            r"calib_imu_to_velo\.txt: cannot be read .*next to its drives",
        ),
        (
            "../calib_imu_to_velo.txt",
            "R: 1 0 0 0 1 0 0 0 1\n",
            r"calib_imu_to_velo\.txt: line T .*is missing",
        ),
        ("../calib_velo_to_cam.txt", "T: 1 2 3\n", r"calib_velo_to_cam\.txt: line R is missing"),
        (
            "../calib_cam_to_cam.txt",
            "R_rect_00: 1 0 0 0 1 0 0 0 1\n",
            r"calib_cam_to_cam\.txt: line S_rect_02 .*is missing",
        ),
    ],
)
def test_missing_and_corrupt_files_are_reported(
    drive: Path, name: str, content: str | None, problem: str
) -> None:
    (drive / name).unlink()
    if content is not None:
        (drive / name).write_text(content)
    with pytest.raises(DataError, match=problem):
        open_sequence(str(drive))


@pytest.mark.parametrize("inner", ["sequences/00", "sequences/00/velodyne", "sequences", ""])
def test_odometry_reads_poses_next_to_the_sequences(tmp_path: Path, inner: str) -> None:
    write_odometry(tmp_path)
    sequence = open_sequence(str(tmp_path / inner))
    assert type(sequence.reader) is KittiOdometrySequence
    assert (sequence.name, sequence.has_labels, len(sequence)) == ("kitti_odometry_00", False, 3)
    assert sequence[2].labels is None
    np.testing.assert_allclose(sequence[2].position, [2, 0, 0], atol=1e-12)
    np.testing.assert_allclose(sequence[2].points[0], [12, 0, 0], atol=1e-6)


def test_poses_in_the_folder_select_semantickitti(tmp_path: Path) -> None:
    folder = write_odometry(tmp_path)
    (folder / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 3)
    assert type(open_sequence(str(folder)).reader) is SemanticKittiSequence
    assert open_sequence(str(folder))[2].position[0] == 0
    assert open_sequence(f"kitti_odometry:{folder}")[2].position[0] == pytest.approx(2)
    (tmp_path / "poses/00.txt").unlink()
    assert open_sequence(f"kitti_odometry:{folder}")[2].position[0] == 0


def test_odometry_with_too_few_poses_is_reported(tmp_path: Path) -> None:
    folder = write_odometry(tmp_path)
    (tmp_path / "poses/00.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    with pytest.raises(
        DataError, match=r"poses/00\.txt: has only 1 lines, but there is a sweep 000002\.bin"
    ):
        open_sequence(str(folder))
    write_odometry(tmp_path, number="01")
    with pytest.raises(
        DataError, match=r"several sequences: 00, 01\. Choose one, for example sequences/00"
    ):
        open_sequence(str(tmp_path))
