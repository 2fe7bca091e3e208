"""KITTI tracking and SemanticKITTI: poses, labels, missing frames and missing files."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.kitti_files import write_semantickitti, write_tracking

from dynaviz.contracts.scan import Sequence
from dynaviz.errors import DataError
from dynaviz.io.pcd import read_pcd
from dynaviz.sources.datasets import open_sequence
from dynaviz.sources.datasets.kitti_tracking import KittiTrackingSequence
from dynaviz.sources.datasets.semantickitti import SemanticKittiSequence

FRAMES = 10  # of the real data


@pytest.fixture
def training(tmp_path: Path) -> Path:
    return write_tracking(tmp_path)


def test_boxes_become_labels(training: Path) -> None:
    scan = open_sequence(str(training))[0]
    assert scan.labels.tolist() == [1, 255, 255, 0, 0, 255, 255]  # type: ignore[union-attr]
    assert scan.instances.tolist() == [1, 0, 0, 2, 0, 0, 0]  # type: ignore[union-attr]
    assert scan.classes.tolist() == [1, 0, 0, 4, 0, 0, 0]  # type: ignore[union-attr]


def test_missing_sweeps_leave_a_gap_in_the_numbers(training: Path) -> None:
    sequence = open_sequence(str(training))
    assert [sequence[k].index for k in range(len(sequence))] == [0, 10]
    assert sequence[1].labels[0] == 0  # type: ignore[index]  # the car has moved on


@pytest.mark.parametrize("inner", ["", "velodyne", "velodyne/0003", "0003", ".."])
def test_tracking_is_found_from_related_folders(training: Path, inner: str) -> None:
    sequence = open_sequence(str(training / inner))
    assert isinstance(sequence.reader, KittiTrackingSequence)
    assert (sequence.name, sequence.sensor.name, sequence.has_labels) == (
        "kitti_tracking_0003",
        "hdl64e",
        True,
    )


def test_several_sequences_are_reported(training: Path) -> None:
    (training / "velodyne/0004").mkdir()
    with pytest.raises(DataError, match="several sequences: 0003, 0004"):
        open_sequence(str(training))
    assert len(open_sequence(f"kitti_tracking:{training}/0003")) == 2


def test_tracking_without_boxes_has_no_labels(training: Path) -> None:
    (training / "label_02/0003.txt").unlink()
    sequence = open_sequence(str(training))
    assert not sequence.has_labels
    assert sequence[0].labels is None


def test_poses_of_the_imu_are_converted(training: Path) -> None:
    half_turn = " ".join(["49.0", "8.4", "100.0", "0", "0", str(np.pi), *["0"] * 24]) + "\n"
    path = training / "oxts/0003.txt"
    path.write_text(path.read_text().splitlines(keepends=True)[0] * 10 + half_turn)
    T_world_sensor = open_sequence(str(training))[1].T_world_sensor
    expected = [
        [-1, 0, 0, -2],
        [0, -1, 0, 0],
        [0, 0, 1, 0],
        [0, 0, 0, 1],
    ]  # the sensor is 1 m ahead of the IMU
    np.testing.assert_allclose(T_world_sensor, expected, atol=1e-9)


@pytest.mark.parametrize(
    ("kind", "problem"),
    [("oxts", "has only 5 lines, but there is a sweep"), ("calib", "is missing")],
)
def test_truncated_tracking_files_are_reported(training: Path, kind: str, problem: str) -> None:
    path = training / kind / "0003.txt"
    path.write_text(
        "".join(path.read_text().splitlines(keepends=True)[: 5 if kind == "oxts" else 1])
    )
    with pytest.raises(DataError, match=f"0003.txt: .*{problem}"):
        open_sequence(str(training))


@pytest.fixture
def sequence_folder(tmp_path: Path) -> Path:
    return write_semantickitti(tmp_path)


def test_camera_poses_are_converted_to_sensor_poses(sequence_folder: Path) -> None:
    sequence = open_sequence(str(sequence_folder))
    expected = np.eye(4)
    np.testing.assert_allclose(sequence[0].T_world_sensor, expected, atol=1e-12)
    expected[0, 3] = 1
    np.testing.assert_allclose(sequence[1].T_world_sensor, expected, atol=1e-12)
    np.testing.assert_allclose(sequence[1].points[0], [11, 0, 0], atol=1e-6)


def test_classes_become_labels(sequence_folder: Path) -> None:
    scan = open_sequence(str(sequence_folder))[0]
    # unlabelled within 3 m: the car
    assert scan.labels.tolist() == [0, 1, 1, 0, 1, 0]  # type: ignore[union-attr]
    assert scan.classes.tolist() == [40, 252, 259, 30, 0, 1]  # type: ignore[union-attr]
    assert scan.instances.tolist() == [0, 5, 0, 0, 0, 0]  # type: ignore[union-attr]


def test_a_sweep_without_label_file_is_unlabelled(sequence_folder: Path) -> None:
    sequence = open_sequence(str(sequence_folder))
    assert (sequence[1].labels == 255).all()
    (sequence_folder / "labels/000000.label").unlink()
    bare = open_sequence(str(sequence_folder))
    assert not bare.has_labels
    assert bare[0].labels is None


@pytest.mark.parametrize("inner", ["", "velodyne", "..", "../.."])
def test_semantickitti_is_found_from_related_folders(sequence_folder: Path, inner: str) -> None:
    sequence = open_sequence(str(sequence_folder / inner))
    assert isinstance(sequence.reader, SemanticKittiSequence)
    assert (sequence.name, sequence.sensor.name, sequence.has_labels) == (
        "semantickitti_04",
        "hdl64e",
        True,
    )


def test_times_are_stamps(sequence_folder: Path) -> None:
    assert open_sequence(str(sequence_folder))[1].stamp_ns is None
    (sequence_folder / "times.txt").write_text("0.0\n1.036e-01\n")
    assert open_sequence(str(sequence_folder))[1].stamp_ns == 103_600_000


@pytest.mark.parametrize("name", ["poses.txt", "times.txt"])
def test_too_few_lines_are_reported(sequence_folder: Path, name: str) -> None:
    (sequence_folder / name).write_text(
        "1 0 0 0 0 1 0 0 0 0 1 0\n" if name == "poses.txt" else "0\n"
    )
    with pytest.raises(
        DataError, match=rf"{name}: has only 1 lines, but there is a sweep 000001\.bin"
    ):
        open_sequence(str(sequence_folder))


def test_a_wrong_number_of_labels_is_reported(sequence_folder: Path) -> None:
    np.zeros(5, "<u4").tofile(sequence_folder / "labels/000000.label")
    with pytest.raises(
        DataError, match=r"000000\.label, byte 20: has 20 bytes, but 6 points need 24"
    ):
        open_sequence(str(sequence_folder))[0]


@pytest.fixture(scope="module")
def unpacked(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first frames of the real sequences in their native layout, and of one in the benchmark's
    layout.
    """
    out = tmp_path_factory.mktemp("real")
    code = (
        f"import pathlib, runpy; script = runpy.run_path({str(shared / 'data/unpack.py')!r})\n"
        "for name in ('tracking', 'odometry'):\n"
        f"    script[name].__globals__['range'] = lambda frames: range(min(frames, {FRAMES}))  # "
        "all would take long\n"
        f"    script[name](pathlib.Path({str(out)!r}))\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
    return out


def test_real_tracking_agrees_with_its_conversion_to_the_benchmark_layout(unpacked: Path) -> None:
    sequence = open_sequence(str(unpacked / "kitti_tracking/training"))
    converted: Sequence = open_sequence(str(unpacked / "unified/kitti_tracking_0012"))
    assert len(sequence) == len(converted) == FRAMES
    cloud, start = read_pcd(unpacked / "unified/kitti_tracking_0012/gt_cloud.pcd"), 0
    for k in range(FRAMES):
        scan = sequence[k]
        rows = slice(start, start + len(scan))
        np.testing.assert_array_equal(scan.labels, cloud["intensity"][rows])  # type: ignore[arg-type]
        np.testing.assert_allclose(scan.points, cloud.xyz[rows], rtol=0, atol=1e-5)
        start += len(scan)
    assert start == len(cloud)
    assert (cloud["intensity"] == 1).sum() > 1000
    np.testing.assert_allclose(
        sequence[FRAMES - 1].T_world_sensor, converted[FRAMES - 1].T_world_sensor, atol=1e-5
    )


def test_real_semantickitti_opens(unpacked: Path) -> None:
    sequence = open_sequence(str(unpacked / "semantickitti/sequences/08"))
    assert len(sequence) == FRAMES
    first = sequence[0]
    moving = np.isin(first.classes, [252, 254])  # type: ignore[arg-type]
    assert moving.sum() == 1128
    assert (first.labels[moving] == 1).all()  # type: ignore[index]
    assert (sequence[FRAMES - 1].labels == 255).all()
