"""KITTI raw and odometry in their own layouts, and the presets of SemanticKITTI."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynaviz.datasets import open_sequence
from dynaviz.datasets.kitti_odometry import KittiOdometrySequence
from dynaviz.datasets.kitti_raw import KittiRawSequence
from dynaviz.datasets.semantickitti import SemanticKittiSequence
from dynaviz.errors import DataError
from dynaviz.io.oxts import read_oxts

DATE = "calib_time: 09-Jan-2012 13:57:47\n"
SWAP = "R: 0 -1 0 0 0 -1 1 0 0\nT: 0 0 0\n"  # camera x right, y down, z forward; sensor x forward, y left, z up
POINTS = [
    (10, 0, -1.0),  # in the moving car
    (10, 0, -1.68),  # at its feet
    (10, 1.125, -1.0),  # just beside it
    (20, 5, -1.0),  # in the parked van
    (15, 3, -1.0),  # on no object
    (-10, 0, 0.0),  # behind the camera
]


def sweep(path: Path, points: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.column_stack([np.asarray(points, float), np.zeros(len(points))]).astype("<f4").tofile(path)


def record(path: Path, latitude: float = 49.0, yaw: float = 0.0) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(" ".join([str(latitude), "8.4", "100.0", "0", "0", str(yaw), *["0"] * 24]) + "\n")


def tracklet(kind: str, first: int, places: list[tuple[float, float, float, float]]) -> str:
    """A box of 4 x 2 x 1.5 m that stands on the ground 1.7 m below the sensor."""
    poses = "".join(
        f"<item class_id='3'><tx>{x}</tx><ty>{y}</ty><tz>{z}</tz><rz>{yaw}</rz><state>2</state></item>"
        for x, y, z, yaw in places
    )
    size = "<h>1.5</h><w>2.0</w><l>4.0</l>"
    return (
        f"<item class_id='1'><objectType>{kind}</objectType>{size}<first_frame>{first}</first_frame>"
        f"<poses class_id='2'><count>{len(places)}</count><item_version>2</item_version>{poses}</poses></item>"
    )


def tracklets(*items: str) -> str:
    head = '<?xml version="1.0" encoding="UTF-8" standalone="yes" ?>\n<!DOCTYPE boost_serialization>\n'
    body = (
        f"<tracklets class_id='0'><count>{len(items)}</count><item_version>1</item_version>{''.join(items)}</tracklets>"
    )
    return f"{head}<boost_serialization signature='serialization::archive' version='9'>{body}</boost_serialization>\n"


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """Frames 0, 1 and 3 of a car that stands; frame 2 has no sweep."""
    day = tmp_path / "raw/2011_09_26"
    drive = day / "2011_09_26_drive_0009_sync"
    for frame in (0, 1, 3):
        sweep(drive / f"velodyne_points/data/{frame:010d}.bin", POINTS)
    for frame in range(4):
        record(drive / f"oxts/data/{frame:010d}.txt")
    (drive / "velodyne_points/timestamps.txt").write_text(
        "".join(f"2011-09-26 13:02:25.{frame}00000001\n" for frame in range(4))
    )
    (day / "calib_imu_to_velo.txt").write_text(DATE + "R: 1 0 0 0 1 0 0 0 1\nT: -1 0 0\n")
    (day / "calib_velo_to_cam.txt").write_text(DATE + SWAP + "delta_f: 0 0\n")
    (day / "calib_cam_to_cam.txt").write_text(
        DATE + "corner_dist: 9.950000e-02\nR_rect_00: 1 0 0 0 1 0 0 0 1\nS_rect_02: 1.242000e+03 3.750000e+02\n"
        "P_rect_02: 700 0 600 0 0 700 180 0 0 0 1 0\n"
    )
    moving = [(10 + 3 * frame, 0, -1.7, 0.0) for frame in range(4)]
    parked = [(20, 5, -1.7, np.pi / 2)] * 2
    (drive / "tracklet_labels.xml").write_text(tracklets(tracklet("Car", 0, moving), tracklet("Van", 0, parked)))
    return drive


def test_tracklets_become_labels(drive: Path) -> None:
    sequence = open_sequence(str(drive))
    scan = sequence[0]
    assert scan.labels.tolist() == [1, 255, 255, 0, 0, 255]  # type: ignore[union-attr]
    assert scan.instances.tolist() == [1, 0, 0, 2, 0, 0]  # type: ignore[union-attr]
    assert [scan.class_names[kind] for kind in scan.classes[[0, 3]].tolist()] == ["car", "van"]  # type: ignore[index]
    assert sequence[1].labels.tolist() == [0, 0, 0, 0, 0, 255]  # type: ignore[union-attr]  # the car has left this place
    assert (sequence[2].instances == 0).all()  # the van's track has ended


def test_frames_keep_their_numbers_and_stamps(drive: Path) -> None:
    sequence = open_sequence(str(drive))
    assert isinstance(sequence, KittiRawSequence)
    assert (sequence.name, sequence.sensor.name) == ("kitti_raw_2011_09_26_drive_0009", "hdl64e")
    assert [sequence[k].index for k in range(len(sequence))] == [0, 1, 3]
    start = 1_317_042_145_000_000_000
    assert [sequence[k].stamp_ns for k in range(3)] == [start + 1, start + 100_000_001, start + 300_000_001]
    path = drive / "velodyne_points/timestamps.txt"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:3]))  # a line each sweep, not each frame
    assert open_sequence(str(drive))[2].stamp_ns == start + 200_000_001
    path.unlink()
    assert open_sequence(str(drive))[0].stamp_ns is None


def test_the_imu_is_not_the_sensor(drive: Path) -> None:
    record(drive / "oxts/data/0000000003.txt", yaw=np.pi)
    expected = [[-1, 0, 0, -2], [0, -1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]  # the sensor is 1 m ahead of the unit
    np.testing.assert_allclose(open_sequence(str(drive))[2].T_world_sensor, expected, atol=1e-9)


def test_north_is_left_of_a_car_that_heads_east(drive: Path) -> None:
    record(drive / "oxts/data/0000000003.txt", latitude=49.0 + 1e-4)
    metres = np.radians(1e-4) * 6378137
    np.testing.assert_allclose(open_sequence(str(drive))[2].position, [0, metres, 0], atol=1e-3)


def test_a_file_a_frame_reads_as_a_line_a_frame(drive: Path, tmp_path: Path) -> None:
    files = sorted((drive / "oxts/data").iterdir())
    for k, file in enumerate(files):
        record(file, latitude=49.0 + 1e-5 * k, yaw=0.1 * k)
    (tmp_path / "all.txt").write_text("".join(file.read_text() for file in files))
    np.testing.assert_array_equal(read_oxts(*files), read_oxts(tmp_path / "all.txt"))


def test_without_tracklets_there_is_no_truth_and_no_camera_is_needed(drive: Path) -> None:
    (drive / "tracklet_labels.xml").unlink()
    (drive.parent / "calib_cam_to_cam.txt").unlink()
    sequence = open_sequence(str(drive))
    assert not sequence.has_labels
    assert sequence[0].labels is None


@pytest.mark.parametrize("inner", ["", "velodyne_points", "velodyne_points/data", "..", "../.."])
def test_a_drive_is_found_from_many_places(drive: Path, inner: str) -> None:
    assert isinstance(open_sequence(str(drive / inner)), KittiRawSequence)


def test_one_of_several_drives_must_be_chosen(drive: Path) -> None:
    shutil.copytree(drive, drive.parent / "2011_09_26_drive_0011_sync")
    with pytest.raises(DataError, match="several drives: 2011_09_26_drive_0009_sync, 2011_09_26_drive_0011_sync"):
        open_sequence(str(drive.parent))


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("oxts/data/0000000001.txt", None, "oxts/data: has no record of frame 1, which has a sweep"),
        ("oxts/data/0000000001.txt", "1 2 3\n", r"0000000001\.txt, line 1: cannot be read"),
        ("oxts/data/0000000001.txt", "", r"0000000001\.txt: has 0 lines, where a frame has one"),
        (
            "velodyne_points/timestamps.txt",
            "2011-09-26 13:02:25\n",
            r"timestamps\.txt: has 1 lines, but there is a sweep 3",
        ),
        ("velodyne_points/timestamps.txt", "a\n\nb\nc\n", r"timestamps\.txt, line 1: has no time"),
        ("tracklet_labels.xml", "<boost_serialization><tracklets>", r"tracklet_labels\.xml, line 1: is no whole XML"),
        ("tracklet_labels.xml", "<boost_serialization/>", r"tracklet_labels\.xml: has no tracklets"),
        ("tracklet_labels.xml", "<a><tracklets><item/></tracklets></a>", r"tracklet_labels\.xml, tracklet 0: lacks a"),
        ("../calib_imu_to_velo.txt", None, r"calib_imu_to_velo\.txt: cannot be read .*beside its drives"),
        ("../calib_imu_to_velo.txt", "R: 1 0 0 0 1 0 0 0 1\n", r"calib_imu_to_velo\.txt: has no line T"),
        ("../calib_velo_to_cam.txt", "T: 1 2 3\n", r"calib_velo_to_cam\.txt: has no line R"),
        ("../calib_cam_to_cam.txt", "R_rect_00: 1 0 0 0 1 0 0 0 1\n", r"calib_cam_to_cam\.txt: has no line S_rect_02"),
    ],
)
def test_what_is_missing_or_damaged_is_told(drive: Path, name: str, content: str | None, problem: str) -> None:
    (drive / name).unlink()
    if content is not None:
        (drive / name).write_text(content)
    with pytest.raises(DataError, match=problem):
        open_sequence(str(drive))


def odometry(root: Path, frames: range = range(3), number: str = "00", poses: bool = True) -> Path:
    """A camera that moves 1 m ahead with each frame, in the layout of KITTI odometry."""
    folder = root / "sequences" / number
    for frame in frames:
        sweep(folder / f"velodyne/{frame:06d}.bin", [(10, 0, 0), (49.9, 0, 0), (50.1, 0, 0), (-30, 0, 41)])
    (folder / "calib.txt").write_text("Tr: 0 -1 0 0.1 0 0 -1 0.2 1 0 0 0.3\n")
    if poses:
        lines = [f"1 0 0 0 0 1 0 0 0 0 1 {frame}\n" for frame in range(frames.stop)]
        (root / "poses").mkdir(exist_ok=True)
        (root / f"poses/{number}.txt").write_text("".join(lines))
    return folder


@pytest.mark.parametrize("inner", ["sequences/00", "sequences/00/velodyne", "sequences", ""])
def test_odometry_has_its_poses_beside_the_sequences(tmp_path: Path, inner: str) -> None:
    odometry(tmp_path)
    sequence = open_sequence(str(tmp_path / inner))
    assert type(sequence) is KittiOdometrySequence
    assert (sequence.name, sequence.has_labels, len(sequence)) == ("kitti_odometry_00", False, 3)
    assert sequence[2].labels is None
    np.testing.assert_allclose(sequence[2].position, [2, 0, 0], atol=1e-12)
    np.testing.assert_allclose(sequence[2].points[0], [12, 0, 0], atol=1e-6)


def test_poses_in_the_folder_are_semantickittis(tmp_path: Path) -> None:
    folder = odometry(tmp_path)
    (folder / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 3)
    assert type(open_sequence(str(folder))) is SemanticKittiSequence
    assert open_sequence(str(folder))[2].position[0] == 0
    assert open_sequence(f"kitti_odometry:{folder}")[2].position[0] == pytest.approx(2)
    (tmp_path / "poses/00.txt").unlink()
    assert open_sequence(f"kitti_odometry:{folder}")[2].position[0] == 0


def test_odometry_without_enough_poses_is_told(tmp_path: Path) -> None:
    folder = odometry(tmp_path)
    (tmp_path / "poses/00.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    with pytest.raises(DataError, match=r"poses/00\.txt: has 1 lines, but there is a sweep 000002\.bin"):
        open_sequence(str(folder))
    odometry(tmp_path, number="01")
    with pytest.raises(DataError, match=r"several sequences: 00, 01\. .* as in sequences/00"):
        open_sequence(str(tmp_path))


def semantic(root: Path, frames: range, number: str) -> Path:
    folder = odometry(root, frames, number, poses=False)
    (folder / "poses.txt").write_text("".join(f"1 0 0 0 0 1 0 0 0 0 1 {frame}\n" for frame in range(frames.stop)))
    (folder / "labels").mkdir()
    for frame in frames:
        np.array([252, 252, 40, 252 | 3 << 16], "<u4").tofile(folder / f"labels/{frame:06d}.label")
    return folder


def test_the_frames_of_the_papers(tmp_path: Path) -> None:
    folder = semantic(tmp_path, range(149, 252), "01")
    sequence = open_sequence(f"semantickitti_paper:{folder}")
    assert (sequence.name, len(sequence)) == ("semantickitti_01", 101)
    assert [sequence[0].index, sequence[100].index] == [150, 250]
    assert len(open_sequence(str(folder))) == 103
    (folder / "velodyne/000200.bin").unlink()
    with pytest.raises(DataError, match=r"velodyne: has no sweep 000200\.bin, but the papers use 150 to 250"):
        open_sequence(f"semantickitti_paper:{folder}")
    other = semantic(tmp_path, range(2), "08")
    with pytest.raises(DataError, match="08: has no frames in the papers, only sequences 00, 01, 02, 05, 07, 19"):
        open_sequence(f"semantickitti_paper:{other}")


def test_points_within_50_m(tmp_path: Path) -> None:
    folder = semantic(tmp_path, range(2), "00")
    sequence = open_sequence(f"semantickitti_50m:{folder}")
    scan, whole = sequence[1], open_sequence(str(folder))[1]
    assert sequence.name == "semantickitti_00_50m"
    np.testing.assert_array_equal(scan.points, whole.points[:2])  # the last one is 50.8 m away
    assert scan.labels.tolist() == [1, 1]  # type: ignore[union-attr]
    assert scan.classes.tolist() == [252, 252]  # type: ignore[union-attr]
    (folder / "labels/000001.label").unlink()
    assert open_sequence(f"semantickitti_50m:{folder}")[1].labels.tolist() == [255, 255]  # type: ignore[union-attr]
