"""KITTI tracking and SemanticKITTI: poses, labels, gaps, and what is missing."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynaviz.datasets import open_sequence
from dynaviz.datasets.kitti_tracking import KittiTrackingSequence
from dynaviz.datasets.semantickitti import SemanticKittiSequence
from dynaviz.errors import DataError
from dynaviz.io.pcd import read_pcd
from dynaviz.scan import Sequence

FEW = 10  # frames of the real data
SWAP = "0 -1 0 {} 0 0 -1 {} 1 0 0 {}"  # camera x right, y down, z forward; sensor x forward, y left, z up
CALIB = f"P2: 700 0 600 0 0 700 180 0 0 0 1 0\nR0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: {SWAP.format(0, 0, 0)}\n"
CALIB += "Tr_imu_to_velo: 1 0 0 -1 0 1 0 0 0 0 1 0\n"


def sweep(path: Path, points: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.column_stack([np.asarray(points, float), np.zeros(len(points))]).astype("<f4").tofile(path)


def box(frame: int, track: int, kind: str, ahead: float, left: float = 0.0) -> str:
    """A box of 2 x 2 x 4 m, whose long side lies across and whose bottom is 1.7 m below the camera."""
    return f"{frame} {track} {kind} 0 0 0 0 0 9 9 2 2 4 {-left} 1.7 {ahead} 0\n"


@pytest.fixture
def training(tmp_path: Path) -> Path:
    """A car that moves ahead of a standing one, in frames 0 and 10; between them sweeps are missing."""
    root = tmp_path / "training"
    for folder in ("oxts", "calib", "label_02"):
        (root / folder).mkdir(parents=True)
    row = " ".join(["49.0", "8.4", "100.0", *["0"] * 27]) + "\n"
    (root / "oxts/0003.txt").write_text(row * 11)
    (root / "calib/0003.txt").write_text(CALIB)
    boxes = [box(0, 0, "Car", 10), box(10, 0, "Car", 20), box(0, 1, "Pedestrian", 30), box(10, 1, "Pedestrian", 30)]
    region = "0 -1 DontCare -1 -1 -10 900 0 1242 375 -1000 -1000 -1000 -10 -1 -1 -1\n"
    (root / "label_02/0003.txt").write_text("".join([*boxes, region]))
    points = [
        (10, 0, -1.0),  # in the moving car
        (10, 0, -1.68),  # at its feet
        (10, 2.1, -1.0),  # just beside it
        (30, 0, -1.0),  # in the standing pedestrian's box
        (15, 3, -1.0),  # on no object
        (-10, 0, 0.0),  # behind
        (10, -6, 0.0),  # in the region that nobody labelled
    ]
    for frame in (0, 10):
        sweep(root / f"velodyne/0003/{frame:06d}.bin", points)
    return root


def test_boxes_become_labels(training: Path) -> None:
    scan = open_sequence(str(training))[0]
    assert scan.labels.tolist() == [1, 255, 255, 0, 0, 255, 255]  # type: ignore[union-attr]
    assert scan.instances.tolist() == [1, 0, 0, 2, 0, 0, 0]  # type: ignore[union-attr]
    assert scan.classes.tolist() == [1, 0, 0, 4, 0, 0, 0]  # type: ignore[union-attr]


def test_missing_sweeps_leave_a_gap_in_the_numbers(training: Path) -> None:
    sequence = open_sequence(str(training))
    assert [sequence[k].index for k in range(len(sequence))] == [0, 10]
    assert sequence[1].labels[0] == 0  # type: ignore[index]  # the car has left this place


@pytest.mark.parametrize("inner", ["", "velodyne", "velodyne/0003", "0003", ".."])
def test_tracking_is_found_from_many_places(training: Path, inner: str) -> None:
    sequence = open_sequence(str(training / inner))
    assert isinstance(sequence, KittiTrackingSequence)
    assert (sequence.name, sequence.sensor.name, sequence.has_labels) == ("kitti_tracking_0003", "hdl64e", True)


def test_one_of_several_sequences_must_be_chosen(training: Path) -> None:
    (training / "velodyne/0004").mkdir()
    with pytest.raises(DataError, match="several sequences: 0003, 0004"):
        open_sequence(str(training))
    assert len(open_sequence(f"kitti_tracking:{training}/0003")) == 2


def test_tracking_without_boxes_has_no_truth(training: Path) -> None:
    (training / "label_02/0003.txt").unlink()
    sequence = open_sequence(str(training))
    assert not sequence.has_labels
    assert sequence[0].labels is None


def test_the_imu_is_not_the_sensor(training: Path) -> None:
    half_turn = " ".join(["49.0", "8.4", "100.0", "0", "0", str(np.pi), *["0"] * 24]) + "\n"
    path = training / "oxts/0003.txt"
    path.write_text(path.read_text().splitlines(keepends=True)[0] * 10 + half_turn)
    T_world_sensor = open_sequence(str(training))[1].T_world_sensor
    expected = [[-1, 0, 0, -2], [0, -1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]  # the sensor is 1 m ahead of the unit
    np.testing.assert_allclose(T_world_sensor, expected, atol=1e-9)


@pytest.mark.parametrize(("kind", "problem"), [("oxts", "has 5 lines, but there is a sweep"), ("calib", "no line")])
def test_tracking_files_that_are_cut_are_told(training: Path, kind: str, problem: str) -> None:
    path = training / kind / "0003.txt"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[: 5 if kind == "oxts" else 1]))
    with pytest.raises(DataError, match=f"0003.txt: .*{problem}"):
        open_sequence(str(training))


@pytest.fixture
def odometry(tmp_path: Path) -> Path:
    """Two sweeps, one metre apart along the sensor's x axis; only the first has labels."""
    root = tmp_path / "sequences/04"
    for frame in (0, 1):
        points = [(10, 0, 0), (2, 2, 0), (2, 2, 0.5), (2, 2, 0), (0, 2.999, 0), (0, 3, 0)]
        sweep(root / f"velodyne/{frame:06d}.bin", points)
    (root / "calib.txt").write_text(f"P0: 1 0 0 0 0 1 0 0 0 0 1 0\nTr: {SWAP.format(0.1, -0.2, 0.3)}\n")
    (root / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 1\n")
    (root / "labels").mkdir()
    np.array([40, 252 | 5 << 16, 259, 30, 0, 1], "<u4").tofile(root / "labels/000000.label")
    return root


def test_poses_of_the_camera_become_poses_of_the_sensor(odometry: Path) -> None:
    sequence = open_sequence(str(odometry))
    expected = np.eye(4)
    np.testing.assert_allclose(sequence[0].T_world_sensor, expected, atol=1e-12)
    expected[0, 3] = 1
    np.testing.assert_allclose(sequence[1].T_world_sensor, expected, atol=1e-12)
    np.testing.assert_allclose(sequence[1].points[0], [11, 0, 0], atol=1e-6)


def test_classes_become_labels(odometry: Path) -> None:
    scan = open_sequence(str(odometry))[0]
    assert scan.labels.tolist() == [0, 1, 1, 0, 1, 0]  # type: ignore[union-attr]  # nearer than 3 m and unsure is the car
    assert scan.classes.tolist() == [40, 252, 259, 30, 0, 1]  # type: ignore[union-attr]
    assert scan.instances.tolist() == [0, 5, 0, 0, 0, 0]  # type: ignore[union-attr]


def test_a_sweep_without_label_file_is_unlabelled(odometry: Path) -> None:
    sequence = open_sequence(str(odometry))
    assert (sequence[1].labels == 255).all()
    (odometry / "labels/000000.label").unlink()
    bare = open_sequence(str(odometry))
    assert not bare.has_labels
    assert bare[0].labels is None


@pytest.mark.parametrize("inner", ["", "velodyne", "..", "../.."])
def test_semantickitti_is_found_from_many_places(odometry: Path, inner: str) -> None:
    sequence = open_sequence(str(odometry / inner))
    assert isinstance(sequence, SemanticKittiSequence)
    assert (sequence.name, sequence.sensor.name, sequence.has_labels) == ("semantickitti_04", "hdl64e", True)


def test_times_are_stamps(odometry: Path) -> None:
    assert open_sequence(str(odometry))[1].stamp_ns is None
    (odometry / "times.txt").write_text("0.0\n1.036e-01\n")
    assert open_sequence(str(odometry))[1].stamp_ns == 103_600_000


@pytest.mark.parametrize("name", ["poses.txt", "times.txt"])
def test_too_few_lines_are_told(odometry: Path, name: str) -> None:
    (odometry / name).write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" if name == "poses.txt" else "0\n")
    with pytest.raises(DataError, match=rf"{name}: has 1 lines, but there is a sweep 000001\.bin"):
        open_sequence(str(odometry))


def test_labels_of_another_sweep_are_told(odometry: Path) -> None:
    np.zeros(5, "<u4").tofile(odometry / "labels/000000.label")
    with pytest.raises(DataError, match=r"000000\.label, byte 20: has 20 bytes, where 6 points need 24"):
        open_sequence(str(odometry))[0]


@pytest.fixture(scope="module")
def unpacked(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first frames of the real sequences in their own layout, and of one in the benchmark's."""
    out = tmp_path_factory.mktemp("real")
    code = (
        f"import pathlib, runpy; script = runpy.run_path({str(shared / 'data/unpack.py')!r})\n"
        "for name in ('tracking', 'odometry'):\n"
        f"    script[name].__globals__['range'] = lambda frames: range(min(frames, {FEW}))  # all would take long\n"
        f"    script[name](pathlib.Path({str(out)!r}))\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
    return out


def test_real_tracking_agrees_with_its_unified_form(unpacked: Path) -> None:
    sequence = open_sequence(str(unpacked / "kitti_tracking/training"))
    unified: Sequence = open_sequence(str(unpacked / "unified/kitti_tracking_0012"))
    assert len(sequence) == len(unified) == FEW
    cloud, start = read_pcd(unpacked / "unified/kitti_tracking_0012/gt_cloud.pcd"), 0
    for k in range(FEW):
        scan = sequence[k]
        rows = slice(start, start + len(scan))
        np.testing.assert_array_equal(scan.labels, cloud["intensity"][rows])  # type: ignore[arg-type]
        np.testing.assert_allclose(scan.points, cloud.xyz[rows], rtol=0, atol=1e-5)
        start += len(scan)
    assert start == len(cloud)
    assert (cloud["intensity"] == 1).sum() > 1000
    np.testing.assert_allclose(sequence[FEW - 1].T_world_sensor, unified[FEW - 1].T_world_sensor, atol=1e-5)


def test_real_semantickitti_opens(unpacked: Path) -> None:
    sequence = open_sequence(str(unpacked / "semantickitti/sequences/08"))
    assert len(sequence) == FEW
    first = sequence[0]
    moving = np.isin(first.classes, [252, 254])  # type: ignore[arg-type]
    assert moving.sum() == 1128
    assert (first.labels[moving] == 1).all()  # type: ignore[index]
    assert (sequence[FEW - 1].labels == 255).all()
