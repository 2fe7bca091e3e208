"""Pose files in every format, compared with scipy; an invalid line is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dynaviz.errors import DataError
from dynaviz.io.pcd import write_pcd
from dynaviz.io.poses import find_poses, nanoseconds, read_poses

RANDOM = np.random.default_rng(3)
TURNS, XYZ = Rotation.random(6, rng=RANDOM), RANDOM.normal(scale=40, size=(6, 3))
T = np.tile(np.eye(4), (6, 1, 1))
T[:, :3, :3], T[:, :3, 3] = TURNS.as_matrix(), XYZ
QUATERNIONS = TURNS.as_quat()  # x y z w
STAMPS = 1_700_000_000_000_000_000 + np.arange(6) * 100_000_001
SECONDS = [f"{stamp // 10**9}.{stamp % 10**9:09d}" for stamp in STAMPS.tolist()]


def lines(*columns: object) -> str:
    return "".join(" ".join(map(str, row)) + "\n" for row in zip(*columns, strict=True))


def table(*columns: object) -> str:
    return lines(*columns).replace(" ", ",")


def test_kitti(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "poses.txt", T[:, :3].reshape(6, 12))
    found = read_poses(tmp_path / "poses.txt")
    assert (found.kind, found.stamps, found.numbers, len(found)) == ("KITTI", None, None, 6)
    np.testing.assert_allclose(found.poses, T, atol=1e-12)


def test_4x4_matrices(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "poses.csv", T.reshape(6, 16), delimiter=",")
    found = read_poses(tmp_path / "poses.csv")
    assert found.kind == "4x4"
    np.testing.assert_allclose(found.poses, T, atol=1e-12)


def test_tum_keeps_every_nanosecond(tmp_path: Path) -> None:
    path = tmp_path / "a.tum"
    path.write_text("# time x y z qx qy qz qw\n\n" + lines(SECONDS, *XYZ.T, *QUATERNIONS.T))
    found = read_poses(path)
    assert found.kind == "TUM"
    np.testing.assert_array_equal(found.stamps, STAMPS)  # type: ignore[arg-type]
    np.testing.assert_allclose(found.poses, T, atol=1e-12)


@pytest.mark.parametrize(
    ("header", "columns", "stamps", "numbers"),
    [
        ("timestamp,x,y,z,qx,qy,qz,qw", (STAMPS, *XYZ.T, *QUATERNIONS.T), True, False),
        (
            "stamp_ns,frame,tx,ty,tz,qx,qy,qz,qw",
            (STAMPS, range(6), *XYZ.T, *QUATERNIONS.T),
            True,
            True,
        ),
        (
            "index,qw,qx,qy,qz,pos_x,pos_y,pos_z",
            (range(6), *np.roll(QUATERNIONS, 1, 1).T, *XYZ.T),
            False,
            True,
        ),
        (
            "#timestamp [ns], p_x [m], p_y [m], p_z [m], q_w [], q_x [], q_y [], q_z []",
            (STAMPS, *XYZ.T, *np.roll(QUATERNIONS, 1, 1).T),
            True,
            False,
        ),
        (
            "time "
            "[s],comment,position.x,position.y,position.z,orientation.x,orientation.y,orientation.z,orientation.w",
            (SECONDS, ["good"] * 6, *XYZ.T, *QUATERNIONS.T),
            True,
            False,
        ),
        (
            "id," + ",".join(f"T{row}{column}" for row in range(4) for column in range(4)),
            (range(6), *T.reshape(6, 16).T),
            False,
            True,
        ),
    ],
)
def test_csv_columns_are_found_by_name(
    tmp_path: Path, header: str, columns: tuple[object, ...], stamps: bool, numbers: bool
) -> None:
    path = tmp_path / "a.csv"
    path.write_text(header + "\n" + table(*columns))
    found = read_poses(path)
    assert found.kind == "CSV"
    np.testing.assert_allclose(found.poses, T, atol=1e-12)
    assert (found.stamps is not None, found.numbers is not None) == (stamps, numbers)
    if found.stamps is not None:
        np.testing.assert_array_equal(found.stamps, STAMPS)
    if found.numbers is not None:
        np.testing.assert_array_equal(found.numbers, np.arange(6))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0.1", 100_000_000),
        ("1305031102.175304", 1_305_031_102_175_304_000),
        ("1.7e9", 17 * 10**17),
        ("1700000000123", 1_700_000_000_123_000_000),
        ("1700000000123456", 1_700_000_000_123_456_000),
        ("1700000000123456789", 1_700_000_000_123_456_789),
        ("-5", -5 * 10**9),
    ],
)
def test_times_are_parsed(text: str, expected: int) -> None:
    assert nanoseconds(text) == expected


@pytest.mark.parametrize("text", ["", "noon", "nan", "inf", "1e999999999"])
def test_invalid_times_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="is not a time"):
        nanoseconds(text)


GOOD = "1 0 0 0 0 1 0 0 0 0 1 0\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "contains no poses"),
        ("# only a remark\n", "contains no poses"),
        ("1 2 3\n", "line 1: unknown pose format with 3 values"),
        (GOOD + "\n1 0 0 0 0 1 0 0 0 0 1\n", r"line 3: not a valid pose \(11 values"),
        (GOOD + GOOD.replace("1 0 0 0 0", "1 0 x 0 0"), "line 2: not a valid pose"),
        (GOOD + GOOD.replace("1 0 0 0 0", "1 0 nan 0 0"), "line 2: not a valid pose.*not finite"),
        (GOOD + "0 " * 12, "line 2: the matrix is not a rotation"),
        (GOOD + "1 0 0 0 0 1 0 0 0 0 -1 0\n", "line 2: the matrix mirrors"),  # a reflection
        ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 0\n", "line 2: not a valid pose.*quaternion"),
        ("1 0 0 0 0 0 0 1\nnoon 0 0 0 0 0 0 1\n", "line 2: not a valid time"),
        ("time,x,y,z\n1,0,0,0\n", "line 1: the header has no pose columns: time,x,y,z"),
        (
            "time,x,y,z,qx,qy,qz,qw\n1,0,0,0,0,0,0\n",
            "line 2: 7 values, but the header has 8 columns",
        ),
        ("time,x,y,z,qx,qy,qz,qw\n", "contains no poses"),
    ],
)
def test_an_invalid_pose_is_reported(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "poses.txt").write_text(text)
    with pytest.raises(DataError, match=rf"poses\.txt.*{message}"):
        read_poses(tmp_path / "poses.txt")


def test_a_missing_file_is_reported(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"a\.tum: cannot be read"):
        read_poses(tmp_path / "a.tum")


def test_usual_names_are_found(tmp_path: Path) -> None:
    assert find_poses(tmp_path) is None
    (tmp_path / "drive.tum").write_text("")
    assert find_poses(tmp_path) == tmp_path / "drive.tum"
    (tmp_path / "poses.txt").write_text("")
    with pytest.raises(DataError, match=r"several pose files: drive\.tum, poses\.txt.*poses=FILE"):
        find_poses(tmp_path)


def test_keyframes_of_lio_sam(tmp_path: Path) -> None:
    path = tmp_path / "transformations.pcd"
    angles = TURNS.as_euler("xyz")
    axes = dict(
        zip(("x", "y", "z", "roll", "pitch", "yaw"), np.hstack([XYZ, angles]).T, strict=True)
    )
    fields = {name: column.astype(np.float32) for name, column in axes.items()}
    write_pcd(path, {**fields, "time": STAMPS / 1e9})
    found = read_poses(path)
    assert found.kind == "PCD"
    np.testing.assert_allclose(found.poses, T, atol=1e-5)
    assert found.stamps is not None
    assert np.abs(found.stamps - STAMPS).max() < 1000
    write_pcd(path, fields)
    assert read_poses(path).stamps is None
    write_pcd(path, {name: column for name, column in fields.items() if name != "yaw"})
    with pytest.raises(DataError, match="field 'yaw' is missing"):
        read_poses(path)
    write_pcd(path, {name: column[:0] for name, column in fields.items()})
    with pytest.raises(DataError, match="contains no poses"):
        read_poses(path)
