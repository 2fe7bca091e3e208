"""Attributes and far coordinates of folders of scans, bags and benchmarks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.bags import START, BagWriter, at
from helpers.scan_folders import write_kitti_poses
from helpers.street import drive

import dynaviz as dv
from dynaviz.contracts.attributes import far_origin
from dynaviz.errors import UsageError
from dynaviz.io.pcd import write_pcd
from dynaviz.io.velodyne import detect_columns

FRAMES, POINTS = 4, 400
UTM = np.array([512_000.25, 5_403_000.5, 380.0])
RANDOM = np.random.default_rng(0)
LOCAL = (RANDOM.uniform(-20, 20, (FRAMES, POINTS, 3)) * 1024).round().astype(
    np.float32
) / 1024  # exact in sums
RINGS = RANDOM.integers(0, 64, (FRAMES, POINTS)).astype(np.uint16)
INTENSITY = RANDOM.random((FRAMES, POINTS)).astype(np.float32)


def poses(offset: np.ndarray) -> np.ndarray:
    T = np.tile(np.eye(4), (FRAMES, 1, 1))
    T[:, :3, 3] = np.arange(FRAMES)[:, None] * [0.5, 0.25, 0] + offset
    return T


def write_scans(folder: Path, offset: np.ndarray, *, world: bool = False) -> Path:
    folder.mkdir(parents=True)
    for k, T in enumerate(poses(offset)):
        xyz = LOCAL[k] + (T[:3, 3] if world else 0)
        fields = {axis: xyz[:, n] for n, axis in enumerate("xyz")} | {
            "ring": RINGS[k],
            "intensity": INTENSITY[k],
        }
        write_pcd(folder / f"{k:06d}.pcd", fields)
    np.savetxt(folder / "poses.txt", poses(offset)[:, :3].reshape(FRAMES, 12), fmt="%.17g")
    return folder


def test_attributes_follow_the_points(tmp_path: Path) -> None:
    sequence = dv.open(write_scans(tmp_path / "scans", np.zeros(3))).select("1:", 2)
    for position, frame in enumerate((1, 3)):
        found = sequence.attributes(position)
        assert found["ring"].tobytes() == RINGS[frame].tobytes()
        assert found["intensity"].tobytes() == INTENSITY[frame].tobytes()
    assert found.keys() == {"ring", "intensity"}


@pytest.mark.parametrize("world", [False, True])
def test_a_far_sequence_is_the_same_as_one_near_zero(tmp_path: Path, world: bool) -> None:
    points_in = "world" if world else None
    near = dv.open(
        write_scans(tmp_path / "near", np.array([0.25, 0.5, 380.0]), world=world),
        points_in=points_in,
    )
    far = dv.open(write_scans(tmp_path / "far", UTM, world=world), points_in=points_in)
    np.testing.assert_array_equal(far.origin, [512_000, 5_403_000, 0])
    assert not near.origin.any()
    for a, b in zip((near[k] for k in range(FRAMES)), (far[k] for k in range(FRAMES)), strict=True):
        np.testing.assert_array_equal(a.points, b.points)
        np.testing.assert_array_equal(a.T_world_sensor, b.T_world_sensor)


def test_the_origin_is_a_whole_kilometre_beyond_10_km() -> None:
    assert far_origin(np.array([9_999.0, -9_999.0, 0])).tolist() == [0, 0, 0]
    assert far_origin(np.array([10_499.0, -10_501.0, 20.0])).tolist() == [10_000, -11_000, 0]


def test_bags_keep_all_fields_and_shift_far_poses(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive") as bag:
        for k in range(FRAMES):
            columns = {axis: LOCAL[k][:, n] for n, axis in enumerate("xyz")}
            bag.cloud(0.1 * k, columns | {"ring": RINGS[k], "intensity": INTENSITY[k]})
            bag.odometry(0.1 * k, at(*(UTM + np.array([k, 0, 0])), 0.0))
    sequence = dv.open(bag.path)
    np.testing.assert_array_equal(sequence.origin, [512_000, 5_403_000, 0])
    np.testing.assert_allclose(sequence[1].T_world_sensor[:3, 3], [1.25, 0.5, 380.0], atol=1e-6)
    np.testing.assert_allclose(sequence[1].points, LOCAL[1] + [1.25, 0.5, 380.0], atol=1e-4)
    found = sequence.attributes(2)
    assert found.keys() == {"ring", "intensity"}
    assert found["intensity"].tobytes() == INTENSITY[2].tobytes()
    assert sequence[2].stamp_ns == START + 200_000_000


@pytest.mark.parametrize(
    ("columns", "names"),
    [
        (3, "x y z"),
        (4, "x y z intensity"),
        (5, "x y z intensity ring"),
        (6, "x y z intensity ring time"),
    ],
)
def test_columns_of_bin_files_are_detected(tmp_path: Path, columns: int, names: str) -> None:
    angle = np.linspace(0, 40 * np.pi, 1200)
    ring = np.repeat(np.arange(20), 60)
    table = np.column_stack(
        [
            20 * np.cos(angle),
            15 * np.sin(angle),
            0.1 * ring - 1,
            RANDOM.random(1200),
            ring,
            np.linspace(0, 0.1, 1200),
        ]
    ).astype("<f4")
    for k in range(2):
        table[:, :columns].tofile(tmp_path / f"{k:06d}.bin")
    write_kitti_poses(tmp_path / "poses.txt", poses(np.zeros(3))[:2])
    assert " ".join(detect_columns(tmp_path / "000000.bin")) == names
    sequence = dv.open(tmp_path)
    np.testing.assert_array_equal(sequence[0].points, table[:, :3])
    assert list(sequence.attributes(0)) == names.split()[3:]


@pytest.mark.parametrize("columns", [3, 4, 5, 6])
@pytest.mark.parametrize("missing", [0, 1, 2])
def test_columns_of_shuffled_points_are_detected(
    tmp_path: Path, columns: int, missing: int
) -> None:
    points = drive()[3].points
    n = len(points)
    table = np.column_stack([points, RANDOM.random(n), np.arange(n) % 16, np.linspace(0, 0.1, n)])
    rows = RANDOM.permutation(table)[: n - missing, :columns]
    rows.astype("<f4").tofile(tmp_path / "000000.pcd.bin")
    assert len(detect_columns(tmp_path / "000000.pcd.bin")) == columns


def test_an_extrinsic_turns_poses_of_a_vehicle_into_those_of_its_lidar(tmp_path: Path) -> None:
    folder = write_scans(tmp_path / "scans", np.zeros(3))
    (tmp_path / "mount.txt").write_text("0 -1 0 1.5  1 0 0 0  0 0 1 2")
    for extrinsic in ("1.5,0,2,0,0,90", str(tmp_path / "mount.txt")):
        scan = dv.open(folder, extrinsic=extrinsic)[2]
        np.testing.assert_allclose(scan.T_world_sensor[:3, 3], [2.5, 0.5, 2.0], atol=1e-12)
        x, y, z = LOCAL[2].T
        np.testing.assert_allclose(
            scan.points, np.column_stack([2.5 - y, 0.5 + x, 2 + z]), atol=1e-4
        )
    (tmp_path / "two.txt").write_text("0 -1 0 1.5  1 0 0 0  0 0 1 2\n" * 2)
    wrong = {
        "1,2,3": "has 3 numbers",
        "a,b": "neither numbers nor a file",
        str(tmp_path / "two.txt"): "has 2 poses",
    }
    for extrinsic, problem in wrong.items():
        with pytest.raises(UsageError, match=f"extrinsic=.*: {problem}"):
            dv.open(folder, extrinsic=extrinsic)
