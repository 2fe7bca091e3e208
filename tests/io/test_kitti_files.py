"""KITTI's own formats: sweeps, labels, poses, calibration, GPS records and boxes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dynaviz.errors import DataError
from dynaviz.io.kitti import (
    TrackBox,
    calib_matrix,
    calib_transform,
    read_boxes,
    read_calib,
    read_oxts,
)
from dynaviz.io.poses import read_kitti_poses
from dynaviz.io.semantic_label import read_semantic_labels
from dynaviz.io.velodyne import read_velodyne
from dynaviz.spatial import geometry

BOX = "7 3 Car 0 0 0.1 10 20 30 40 1.5 1.6 4.0 -3.0 1.7 20.0 0.25"


def test_a_sweep_is_read(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(9, 4)).astype("<f4")
    points.tofile(tmp_path / "a.bin")
    np.testing.assert_array_equal(read_velodyne(tmp_path / "a.bin"), points)


def test_a_truncated_sweep_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.bin").write_bytes(bytes(50))
    with pytest.raises(DataError, match=r"a\.bin, byte 48: ends in the middle of a point"):
        read_velodyne(tmp_path / "a.bin")


def test_labels_are_class_and_instance(tmp_path: Path) -> None:
    np.array([252 | 7 << 16, 40, 0xFFFF << 16], "<u4").tofile(tmp_path / "a.label")
    classes, instances = read_semantic_labels(tmp_path / "a.label", 3)
    assert classes.tolist() == [252, 40, 0]
    assert instances.tolist() == [7, 0, 65535]


@pytest.mark.parametrize("points", [0, 2, 4])
def test_a_wrong_number_of_labels_is_refused(tmp_path: Path, points: int) -> None:
    np.zeros(3, "<u4").tofile(tmp_path / "a.label")
    with pytest.raises(DataError, match=f"has 12 bytes, but {points} points need {4 * points}"):
        read_semantic_labels(tmp_path / "a.label", points)


def test_kitti_poses_are_the_upper_rows(tmp_path: Path) -> None:
    poses = np.array([geometry.pose((k, 2, 3), (1, 0.1 * k, 0, 0)) for k in range(3)])
    np.savetxt(tmp_path / "poses.txt", poses[:, :3].reshape(3, 12), fmt="%.17g")
    np.testing.assert_array_equal(read_kitti_poses(tmp_path / "poses.txt"), poses)


def test_an_empty_trajectory_has_no_poses(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("\n")
    assert read_kitti_poses(tmp_path / "a.txt").shape == (0, 4, 4)


def test_calibration_rows_have_names_with_or_without_colon(tmp_path: Path) -> None:
    path = tmp_path / "calib.txt"
    path.write_text("R_rect 1 0 0 0 1 0 0 0 1\n\nTr: 0 -1 0 5 1 0 0 6 0 0 1.000001 7\n")
    rows = read_calib(path)
    np.testing.assert_array_equal(calib_matrix(path, rows, "R0_rect", "R_rect"), np.eye(3))
    T = calib_transform(path, rows, "Tr")
    np.testing.assert_allclose(
        T, [[0, -1, 0, 5], [1, 0, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]], atol=1e-6
    )
    np.testing.assert_allclose(geometry.compose(T, geometry.inverse(T)), np.eye(4), atol=1e-15)
    with pytest.raises(DataError, match="line P2 or P3 is missing"):
        calib_matrix(path, rows, "P2", "P3")


def test_oxts_of_a_short_drive_matches_a_flat_earth(tmp_path: Path) -> None:
    metre = np.degrees(1 / 6378137.0)
    still = np.array([49.0, 8.0, 100.0, *np.zeros(27)])
    north, east = still.copy(), still.copy()
    north[0] += metre
    east[1] += metre / np.cos(np.radians(49.0))
    east[5] = np.pi / 2
    np.savetxt(tmp_path / "oxts.txt", [still, north, east], fmt="%.15g")
    poses = read_oxts(tmp_path / "oxts.txt")
    np.testing.assert_allclose(poses[1, :3, 3] - poses[0, :3, 3], [0, 1, 0], atol=1e-6)
    np.testing.assert_allclose(poses[2, :3, 3] - poses[0, :3, 3], [1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(poses[2, :3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)


def test_roll_pitch_and_yaw_match_scipy(tmp_path: Path) -> None:
    from scipy.spatial.transform import Rotation

    angles = np.random.default_rng(1).uniform(-1, 1, (5, 3))
    np.savetxt(
        tmp_path / "oxts.txt",
        np.column_stack([np.zeros((5, 3)), angles, np.zeros((5, 24))]),
        fmt="%.17g",
    )
    expected = Rotation.from_euler("ZYX", angles[:, ::-1]).as_matrix()
    np.testing.assert_allclose(read_oxts(tmp_path / "oxts.txt")[:, :3, :3], expected, atol=1e-12)


def test_boxes_are_read(tmp_path: Path) -> None:
    (tmp_path / "label.txt").write_text(BOX + "\n")
    expected = TrackBox(7, 3, "Car", (10, 20, 30, 40), (1.5, 1.6, 4.0), (-3.0, 1.7, 20.0), 0.25)
    assert read_boxes(tmp_path / "label.txt") == [expected]


READERS: dict[str, tuple[Callable[[Path], Any], str]] = {
    "kitti poses": (read_kitti_poses, "1 0 0 0 0 1 0 0 0 0 1 0"),
    "oxts": (read_oxts, " ".join(["49.5"] * 30)),
    "calib": (read_calib, "Tr: 1 0 0 0 0 1 0 0 0 0 1 0"),
    "boxes": (read_boxes, BOX),
}


@pytest.mark.parametrize("name", READERS)
def test_an_invalid_word_is_reported_with_the_line(tmp_path: Path, name: str) -> None:
    read, line = READERS[name]
    path = tmp_path / "a.txt"
    path.write_text(f"{line}\n{line}\n{line.rpartition(' ')[0]} monkey\n")
    with pytest.raises(DataError, match=r"a\.txt, line 3"):
        read(path)


@pytest.mark.parametrize("name", ["kitti poses", "oxts", "boxes"])
def test_a_missing_word_is_reported_with_the_line(tmp_path: Path, name: str) -> None:
    read, line = READERS[name]
    path = tmp_path / "a.txt"
    path.write_text(f"{line}\n{line.rpartition(' ')[0]}\n")
    with pytest.raises(DataError, match=r"a\.txt, line 2"):
        read(path)


@pytest.mark.parametrize("name", ["kitti poses", "oxts"])
def test_a_number_that_is_not_finite_is_refused(tmp_path: Path, name: str) -> None:
    read, line = READERS[name]
    path = tmp_path / "a.txt"
    path.write_text(f"{line}\n{line.rpartition(' ')[0]} nan\n")
    with pytest.raises(DataError, match="row 1"):
        read(path)


@pytest.mark.parametrize("name", READERS)
def test_a_missing_file_is_reported(tmp_path: Path, name: str) -> None:
    with pytest.raises(DataError, match=r"none\.txt: cannot be read"):
        READERS[name][0](tmp_path / "none.txt")


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(sorted(READERS)), st.data())
def test_changed_text_is_read_or_refused(tmp_path: Path, name: str, draw: st.DataObject) -> None:
    read, line = READERS[name]
    content = bytearray(f"{line}\n{line}\n".encode())
    content[draw.draw(st.integers(0, len(content) - 1))] = draw.draw(st.integers(0, 255))
    path = tmp_path / "a.txt"
    path.write_bytes(content[: draw.draw(st.integers(0, len(content)))])
    try:
        read(path)
    except DataError as error:
        refused: str = error.path
    else:
        refused = str(path)
    assert refused == str(path)
