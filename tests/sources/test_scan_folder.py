"""Folders of scans in every format, with poses in every format, matched by stamp,
number or order.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.bags import START, at
from helpers.scan_folders import (
    POSES,
    STAMPS,
    WRITERS,
    XYZ,
    N,
    write_kitti_poses,
    write_scans,
    write_tum_poses,
)

import dynaviz as dv
from dynaviz import api
from dynaviz.cli import main
from dynaviz.contracts.scan import Sequence
from dynaviz.errors import DataError, UsageError
from dynaviz.io.pcd import write_pcd
from dynaviz.sources.datasets.benchmark import BenchmarkSequence
from dynaviz.sources.datasets.scan_folder import ScanFolderSequence

WORLD = np.array([xyz @ T[:3, :3].T + T[:3, 3] for xyz, T in zip(XYZ, POSES, strict=True)])


def assert_equal(sequence: Sequence, world: np.ndarray = WORLD, poses: np.ndarray = POSES) -> None:
    assert len(sequence) == len(world)
    for k in range(len(world)):
        np.testing.assert_allclose(sequence[k].points, world[k], atol=2e-4)
        np.testing.assert_allclose(sequence[k].T_world_sensor, poses[k], atol=1e-6)


@pytest.mark.parametrize("suffix", WRITERS)
def test_every_format_of_scans(tmp_path: Path, suffix: str) -> None:
    write_kitti_poses(write_scans(tmp_path, suffix) / "poses.txt")
    sequence = dv.open(tmp_path)
    assert isinstance(sequence.reader, ScanFolderSequence)
    assert_equal(sequence)
    assert [sequence[k].index for k in range(N)] == list(range(N))
    facts = sequence.facts
    assert facts["poses"] == "poses.txt (KITTI), by order"
    assert facts["points in"] == "sensor frame"
    assert facts["names"].startswith("frame numbers, 000000")


@pytest.mark.parametrize("inner", ["", "clouds"])
def test_poses_are_found_next_to_the_scans_or_their_folder(tmp_path: Path, inner: str) -> None:
    write_scans(tmp_path / "drive/clouds", ".ply")
    write_kitti_poses(tmp_path / "drive" / inner / "poses.txt")
    for path in (tmp_path / "drive", tmp_path / "drive/clouds"):
        sequence = dv.open(path)
        assert_equal(sequence)
        assert sequence.name == "drive"


def test_points_in_the_world_frame(tmp_path: Path) -> None:
    write_kitti_poses(write_scans(tmp_path, clouds=WORLD) / "poses.txt")
    assert_equal(dv.open(tmp_path, points_in="world"))
    with pytest.raises(UsageError, match=r"points_in=.camera.: give sensor or world"):
        dv.open(tmp_path, points_in="camera")


NAMES = [f"cloud_{stamp // 10**9}.{stamp % 10**9:09d}" for stamp in STAMPS]


@pytest.mark.parametrize("names", [NAMES, [str(stamp) for stamp in STAMPS]])
def test_by_stamp_with_interpolation(tmp_path: Path, names: list[str]) -> None:
    """Poses at twice the rate of the scans, shifted so that each scan lies halfway between two
    poses.
    """
    write_scans(tmp_path, ".ply", names)
    between = [START - 25_000_000 + k * 50_000_000 for k in range(2 * N)]
    fine = np.array([at(k / 2 - 0.25, 0, 0, 0.1 * (k / 2 - 0.25)) for k in range(2 * N)])
    write_tum_poses(tmp_path / "drive.tum", between, fine)
    sequence = dv.open(tmp_path)
    assert sequence.facts["poses"] == "drive.tum (TUM), by stamp"
    for k in range(N):
        assert sequence[k].stamp_ns == STAMPS[k]
        assert sequence[k].index == k
        np.testing.assert_allclose(sequence[k].T_world_sensor, at(k, 0, 0, 0.1 * k), atol=2e-4)


def test_a_pose_at_the_stamp_of_a_scan_is_used_unchanged(tmp_path: Path) -> None:
    write_tum_poses(write_scans(tmp_path, ".ply", NAMES) / "trajectory.txt", STAMPS, POSES)
    assert_equal(dv.open(tmp_path))


def test_scans_outside_the_poses_are_skipped_with_a_warning(tmp_path: Path) -> None:
    write_scans(tmp_path, ".ply", NAMES)
    write_tum_poses(tmp_path / "drive.tum", STAMPS[1:4], POSES[1:4])
    with pytest.warns(
        UserWarning,
        match=r"2 of 5 scans are outside the time span of the poses from .*drive\.tum and are "
        r"skipped",
    ):
        sequence = dv.open(tmp_path)
    assert_equal(sequence, WORLD[1:4], POSES[1:4])
    assert [sequence[k].index for k in range(3)] == [1, 2, 3]


def test_a_different_clock_is_reported(tmp_path: Path) -> None:
    write_scans(tmp_path, ".ply", NAMES)
    write_tum_poses(tmp_path / "drive.tum", [k * 100_000_000 for k in range(N)], POSES)
    with pytest.raises(
        DataError,
        match=r"scans and poses do not overlap in time: scans from 1700000000\.000 to .*poses from "
        r"0",
    ):
        dv.open(tmp_path)


def test_one_pose_for_many_scans_is_reported(tmp_path: Path) -> None:
    write_tum_poses(write_scans(tmp_path, ".ply", NAMES) / "drive.tum", STAMPS[2:3], POSES[2:3])
    with pytest.raises(DataError, match=r"drive\.tum: has 1 pose, but there are 5 scans"):
        dv.open(tmp_path)


def test_decreasing_times_are_reported(tmp_path: Path) -> None:
    write_scans(tmp_path, ".ply", NAMES)
    write_tum_poses(tmp_path / "drive.tum", [STAMPS[k] for k in (0, 1, 3, 2, 4)], POSES)
    with pytest.raises(DataError, match=r"drive\.tum: times are not increasing: row 4 is before"):
        dv.open(tmp_path)


def test_tum_and_numbered_scans_are_matched_by_order(tmp_path: Path) -> None:
    write_tum_poses(write_scans(tmp_path) / "poses.tum", STAMPS, POSES)
    sequence = dv.open(tmp_path)
    assert_equal(sequence)
    assert sequence.facts["poses"].endswith("by order")
    assert [sequence[k].stamp_ns for k in range(N)] == STAMPS


def test_poses_with_an_index_are_matched_by_number(tmp_path: Path) -> None:
    write_scans(tmp_path / "scans", names=[f"scan_{k}" for k in (8, 9, 10, 11, 12)])
    rows = [f"{k + 8},{','.join(map(str, POSES[k].ravel()))}" for k in (4, 2, 1, 0)]
    header = "index," + ",".join(f"m{row}{column}" for row in range(4) for column in range(4))
    file = tmp_path / "elsewhere.csv"
    file.write_text("\n".join([header, *rows]))
    with pytest.warns(UserWarning, match="1 of 5 scans have no pose"):
        sequence = dv.open(tmp_path / "scans", poses=file)
    kept = [0, 1, 2, 4]
    assert_equal(sequence, WORLD[kept], POSES[kept])
    assert [sequence[k].index for k in range(4)] == [
        8,
        9,
        10,
        12,
    ]  # sorted by number, not alphabetically
    file.write_text("\n".join([header, rows[0].replace("12,", "99,", 1)]))
    with pytest.raises(DataError, match=r"poses 99 to 99 match none of the scans 8 to 12 in"):
        dv.open(tmp_path / "scans", poses=file)


def test_a_wrong_number_of_poses_is_reported(tmp_path: Path) -> None:
    write_kitti_poses(write_scans(tmp_path) / "poses.txt", POSES[:4])
    with pytest.raises(DataError, match=r"poses\.txt: has 4 poses, but there are 5 scans in "):
        dv.open(tmp_path)


def test_missing_poses_are_reported_with_the_flag(tmp_path: Path) -> None:
    for suffix in (".bin", ".ply"):
        with pytest.raises(
            DataError, match=r"has no poses\. Estimate them with poses=.small-gicp., or give"
        ):
            dv.open(write_scans(tmp_path / suffix, suffix))
    with pytest.raises(DataError, match=r"nowhere\.txt: cannot be read"):
        dv.open(tmp_path / ".bin", poses=tmp_path / "nowhere.txt")


def test_viewpoints_are_poses(tmp_path: Path) -> None:
    for k in range(N):
        fields = dict(zip("xyz", XYZ[k].T, strict=True))
        write_pcd(tmp_path / f"{k:03d}.pcd", fields, POSES[k])
    sequence = dv.open(f"files:{tmp_path}")
    assert_equal(sequence)
    assert sequence.facts["poses"] == "VIEWPOINT of each PCD"
    assert isinstance(
        dv.open(tmp_path).reader, BenchmarkSequence
    )  # whose points are in the world frame
    write_scans(tmp_path, ".pcd", [f"{k:03d}" for k in range(N)])
    with pytest.raises(DataError, match=r"VIEWPOINT is the identity in every scan.*poses"):
        dv.open(f"files:{tmp_path}")


def test_a_pose_file_rules_out_the_benchmark_layout(tmp_path: Path) -> None:
    write_kitti_poses(write_scans(tmp_path, ".pcd") / "poses.txt")
    assert_equal(dv.open(tmp_path))
    (tmp_path / "poses.txt").rename(tmp_path.parent / "other.txt")
    assert_equal(dv.open(tmp_path, poses=tmp_path.parent / "other.txt"))


def test_formats_with_their_own_poses_refuse_a_pose_file(tmp_path: Path) -> None:
    write_pcd(tmp_path / "pcd/000000.pcd", dict(zip("xyz", XYZ[0].T, strict=True)), POSES[0])
    file = write_kitti_poses(tmp_path / "other.txt", POSES[:1])
    with pytest.raises(UsageError, match="poses: not supported by the format benchmark"):
        dv.open(f"benchmark:{tmp_path}", poses=file)
    assert_equal(
        dv.open(tmp_path, poses=file), WORLD[:1], POSES[:1]
    )  # the option rules out the detected format


def test_labels_next_to_the_scans(tmp_path: Path) -> None:
    write_kitti_poses(write_scans(tmp_path / "scans") / "poses.txt")
    bare = dv.open(tmp_path / "scans")
    assert not bare.has_labels
    assert bare[0].labels is None
    (tmp_path / "labels").mkdir()
    classes = np.array([40, 252, 0, 259 | 7 << 16, *[50] * 36], "<u4")
    classes.tofile(tmp_path / "labels/000000.label")
    np.save(tmp_path / "labels/000001.npy", np.arange(40) % 2)
    sequence = dv.open(tmp_path)
    assert sequence.has_labels
    first = sequence[0]
    assert first.labels.tolist() == [0, 1, 255, 1, *[0] * 36]  # type: ignore[union-attr]
    assert first.instances[3] == 7  # type: ignore[index]
    assert first.class_names[252] == "moving car"
    assert sequence[1].labels.tolist() == [0, 1] * 20  # type: ignore[union-attr]
    assert (sequence[2].labels == 255).all()


@pytest.mark.parametrize(
    ("labels", "problem"),
    [
        (np.zeros(39, int), r"contains \(39,\) for 40 points"),
        (np.full(40, 2), "2 is not a label"),
        (np.zeros(40), r"contains \(40,\) for 40 points"),
        (np.zeros((40, 1), int), r"contains \(40, 1\) for 40 points"),
    ],
)
def test_invalid_labels_are_reported(tmp_path: Path, labels: np.ndarray, problem: str) -> None:
    write_kitti_poses(write_scans(tmp_path) / "poses.txt")
    (tmp_path / "labels").mkdir()
    np.save(tmp_path / "labels/000003.npy", labels)
    with pytest.raises(
        DataError, match=rf"000003\.npy: {problem}.*0 static, 1 dynamic, 255 unlabelled"
    ):
        dv.open(tmp_path)[3]


def test_folders_without_scans_are_reported(tmp_path: Path) -> None:
    (tmp_path / "000000.pts").write_text("")
    with pytest.raises(
        DataError, match=r"contains no scans, only \.pts\. Scans end in \.bin, \.e57, \.las"
    ):
        dv.open(f"files:{tmp_path}")
    with pytest.raises(DataError, match="is not a recognised sequence"):
        dv.open(tmp_path)
    write_kitti_poses(write_scans(tmp_path) / "poses.txt")
    write_scans(tmp_path, ".ply", clouds=XYZ[:2])
    with pytest.raises(DataError, match=r"several formats: \.bin \(5\), \.ply \(2\)"):
        dv.open(tmp_path)


def test_an_unreadable_subfolder_is_ignored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "lost+found").mkdir()
    listed = Path.iterdir

    def iterdir(folder: Path) -> Any:
        if folder.name == "lost+found":
            raise PermissionError(13, "Permission denied")
        return listed(folder)

    monkeypatch.setattr(Path, "iterdir", iterdir)
    with pytest.raises(DataError, match="is not a recognised sequence"):
        dv.open(tmp_path)


def test_duplicate_numbers_are_reported(tmp_path: Path) -> None:
    write_kitti_poses(write_scans(tmp_path, names=["1", "01", "2", "3", "4"]) / "poses.txt")
    with pytest.raises(DataError, match="has the same number as"):
        dv.open(tmp_path)


def test_the_folder_of_a_run_is_not_a_sequence(tmp_path: Path) -> None:
    write_pcd(tmp_path / "static_map.pcd", dict(zip("xyz", XYZ[0].T, strict=True)))
    np.savez(tmp_path / "labels.npz", a=1)
    with pytest.raises(DataError, match="is not a recognised sequence"):
        dv.open(tmp_path)


@pytest.mark.parametrize("damage", ["cut", "no array", "text"])
def test_corrupt_npz_is_reported(tmp_path: Path, damage: str) -> None:
    write_kitti_poses(write_scans(tmp_path, ".npz") / "poses.txt")
    path = tmp_path / "000002.npz"
    if damage == "cut":
        path.write_bytes(path.read_bytes()[:100])
    elif damage == "no array":
        np.savez(path, a=np.zeros(3))
    else:
        path.write_text("not an archive")
    with pytest.raises(DataError, match=r"000002\.npz"):
        dv.open(tmp_path)[2]


def test_info_accepts_poses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_scans(tmp_path / "scans", names=NAMES, clouds=WORLD)
    file = write_tum_poses(tmp_path / "drive.tum", STAMPS[:4], POSES[:4])
    words = ["info", str(tmp_path / "scans"), "--poses", str(file), "--points-in", "world"]
    monkeypatch.setattr(sys, "argv", ["dynaviz", *words])
    with pytest.raises(SystemExit) as end:
        main()
    out, err = capsys.readouterr()
    assert not end.value.code
    assert "drive.tum (TUM), by stamp" in out
    assert "world frame" in out
    assert err.startswith(
        f"dynaviz: warning: 1 of 5 scans are outside the time span of the poses from {file} and "
        "are skipped.\n"
    )


def test_a_run_on_a_folder_of_scans(tmp_path: Path) -> None:
    write_kitti_poses(write_scans(tmp_path) / "poses.txt")
    assert api.run("octomap", tmp_path).sequence.frames == N
