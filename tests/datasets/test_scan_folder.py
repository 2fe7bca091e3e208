"""A plain folder of scans in every format, with poses of every format, matched by stamp, number or order."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.bags import START, at
from scipy.spatial.transform import Rotation

import dynaviz as dv
from dynaviz import api
from dynaviz.cli import main
from dynaviz.datasets.benchmark import BenchmarkSequence
from dynaviz.datasets.scan_folder import ScanFolderSequence
from dynaviz.errors import DataError, UsageError
from dynaviz.io.pcd import write_pcd
from dynaviz.scan import Sequence

N = 5
XYZ = np.random.default_rng(0).uniform(-20, 20, (N, 40, 3)).astype(np.float32)
POSES = np.array([at(2.0 * k, -0.5 * k, 1.5, 0.2 * k) for k in range(N)])
WORLD = np.array([xyz @ T[:3, :3].T + T[:3, 3] for xyz, T in zip(XYZ, POSES, strict=True)])


def _open3d(path: Path, xyz: np.ndarray) -> None:
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(xyz.astype(np.float64)))
    o3d.io.write_point_cloud(str(path), cloud)


def _las(path: Path, xyz: np.ndarray) -> None:
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales = [1e-4] * 3
    las = laspy.LasData(header)
    las.x, las.y, las.z = xyz.T.astype(np.float64)
    las.write(path)


WRITERS: dict[str, Callable[[Path, np.ndarray], None]] = {
    ".bin": lambda path, xyz: np.column_stack([xyz, np.ones(len(xyz))]).astype("<f4").tofile(path),
    ".npy": np.save,
    ".npz": lambda path, xyz: np.savez(path, points=xyz, intensity=np.ones(len(xyz))),
    ".pcd": _open3d,
    ".ply": _open3d,
    ".las": _las,
    ".laz": _las,
}


def scans(folder: Path, suffix: str = ".bin", names: list[str] | None = None, clouds: np.ndarray = XYZ) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for k, xyz in enumerate(clouds):
        WRITERS[suffix](folder / f"{names[k] if names else f'{k:06d}'}{suffix}", xyz)
    return folder


def kitti(path: Path, poses: np.ndarray = POSES) -> Path:
    np.savetxt(path, poses[:, :3].reshape(len(poses), 12))
    return path


def tum(path: Path, stamps: list[int], poses: np.ndarray) -> Path:
    turns = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    rows = zip(stamps, poses[:, :3, 3], turns, strict=True)
    path.write_text(
        "".join(f"{t // 10**9}.{t % 10**9:09d} {' '.join(map(repr, [*p.tolist(), *q.tolist()]))}\n" for t, p, q in rows)
    )
    return path


def agrees(sequence: Sequence, world: np.ndarray = WORLD, poses: np.ndarray = POSES) -> None:
    assert len(sequence) == len(world)
    for k in range(len(world)):
        np.testing.assert_allclose(sequence[k].points, world[k], atol=2e-4)
        np.testing.assert_allclose(sequence[k].T_world_sensor, poses[k], atol=1e-6)


@pytest.mark.parametrize("suffix", WRITERS)
def test_every_format_of_scans(tmp_path: Path, suffix: str) -> None:
    kitti(scans(tmp_path, suffix) / "poses.txt")
    sequence = dv.open(tmp_path)
    assert isinstance(sequence, ScanFolderSequence)
    agrees(sequence)
    assert [sequence[k].index for k in range(N)] == list(range(N))
    assert sequence.facts == {"poses": "poses.txt (KITTI), by order", "points in": "sensor frame"}


@pytest.mark.parametrize("inner", ["", "clouds"])
def test_scans_in_a_folder_of_their_own_with_poses_above_or_beside(tmp_path: Path, inner: str) -> None:
    scans(tmp_path / "drive/clouds", ".ply")
    kitti(tmp_path / "drive" / inner / "poses.txt")
    for path in (tmp_path / "drive", tmp_path / "drive/clouds"):
        sequence = dv.open(path)
        agrees(sequence)
        assert sequence.name == "drive"


def test_points_that_are_in_the_world_already(tmp_path: Path) -> None:
    kitti(scans(tmp_path, clouds=WORLD) / "poses.txt")
    agrees(dv.open(tmp_path, points_in="world"))
    with pytest.raises(UsageError, match="--points-in camera: give sensor or world"):
        dv.open(tmp_path, points_in="camera")


STAMPS = [START + k * 100_000_000 for k in range(N)]
NAMES = [f"cloud_{stamp // 10**9}.{stamp % 10**9:09d}" for stamp in STAMPS]


@pytest.mark.parametrize("names", [NAMES, [str(stamp) for stamp in STAMPS]])
def test_by_stamp_with_interpolation(tmp_path: Path, names: list[str]) -> None:
    """Poses at twice the rate of the scans, half a period off: each scan lies in the middle of two poses."""
    scans(tmp_path, ".ply", names)
    between = [START - 25_000_000 + k * 50_000_000 for k in range(2 * N)]
    fine = np.array([at(k / 2 - 0.25, 0, 0, 0.1 * (k / 2 - 0.25)) for k in range(2 * N)])
    tum(tmp_path / "drive.tum", between, fine)
    sequence = dv.open(tmp_path)
    assert sequence.facts["poses"] == "drive.tum (TUM), by stamp"  # type: ignore[attr-defined]
    for k in range(N):
        assert sequence[k].stamp_ns == STAMPS[k]
        assert sequence[k].index == k
        np.testing.assert_allclose(sequence[k].T_world_sensor, at(k, 0, 0, 0.1 * k), atol=2e-4)


def test_at_its_own_stamp_a_pose_is_taken_as_it_is(tmp_path: Path) -> None:
    tum(scans(tmp_path, ".ply", NAMES) / "trajectory.txt", STAMPS, POSES)
    agrees(dv.open(tmp_path))


def test_scans_outside_the_poses_are_left_out_with_a_warning(tmp_path: Path) -> None:
    scans(tmp_path, ".ply", NAMES)
    tum(tmp_path / "drive.tum", STAMPS[1:4], POSES[1:4])
    with pytest.warns(UserWarning, match=r"2 of 5 scans lie outside the poses of .*drive\.tum and are left out"):
        sequence = dv.open(tmp_path)
    agrees(sequence, WORLD[1:4], POSES[1:4])
    assert [sequence[k].index for k in range(3)] == [1, 2, 3]


def test_another_clock_is_told(tmp_path: Path) -> None:
    scans(tmp_path, ".ply", NAMES)
    tum(tmp_path / "drive.tum", [k * 100_000_000 for k in range(N)], POSES)
    with pytest.raises(DataError, match=r"no scan while poses are known: scans from 1700000000\.000 to .*poses from 0"):
        dv.open(tmp_path)


def test_one_pose_for_many_scans_is_told(tmp_path: Path) -> None:
    tum(scans(tmp_path, ".ply", NAMES) / "drive.tum", STAMPS[2:3], POSES[2:3])
    with pytest.raises(DataError, match=r"drive\.tum: has 1 pose, but there are 5 scans"):
        dv.open(tmp_path)


def test_time_going_backwards_is_told(tmp_path: Path) -> None:
    scans(tmp_path, ".ply", NAMES)
    tum(tmp_path / "drive.tum", [STAMPS[k] for k in (0, 1, 3, 2, 4)], POSES)
    with pytest.raises(DataError, match=r"drive\.tum: has a time in its row 4 that lies before"):
        dv.open(tmp_path)


def test_tum_and_numbered_scans_go_by_order_and_give_stamps(tmp_path: Path) -> None:
    tum(scans(tmp_path) / "poses.tum", STAMPS, POSES)
    sequence = dv.open(tmp_path)
    agrees(sequence)
    assert sequence.facts["poses"].endswith("by order")  # type: ignore[attr-defined]
    assert [sequence[k].stamp_ns for k in range(N)] == STAMPS


def test_an_index_matches_numbers(tmp_path: Path) -> None:
    scans(tmp_path / "scans", names=[f"scan_{k}" for k in (8, 9, 10, 11, 12)])
    rows = [f"{k + 8},{','.join(map(str, POSES[k].ravel()))}" for k in (4, 2, 1, 0)]
    header = "index," + ",".join(f"m{row}{column}" for row in range(4) for column in range(4))
    file = tmp_path / "elsewhere.csv"
    file.write_text("\n".join([header, *rows]))
    with pytest.warns(UserWarning, match="1 of 5 scans have no pose"):
        sequence = dv.open(tmp_path / "scans", poses=file)
    kept = [0, 1, 2, 4]
    agrees(sequence, WORLD[kept], POSES[kept])
    assert [sequence[k].index for k in range(4)] == [8, 9, 10, 12]  # by number, not by letters
    file.write_text("\n".join([header, rows[0].replace("12,", "99,", 1)]))
    with pytest.raises(DataError, match=r"has poses 99 to 99, but the scans in .* are 8 to 12"):
        dv.open(tmp_path / "scans", poses=file)


def test_another_number_of_poses_is_told_with_both(tmp_path: Path) -> None:
    kitti(scans(tmp_path) / "poses.txt", POSES[:4])
    with pytest.raises(DataError, match=r"poses\.txt: has 4 poses, but there are 5 scans in "):
        dv.open(tmp_path)


def test_no_poses_names_the_flag(tmp_path: Path) -> None:
    for suffix in (".bin", ".ply"):
        with pytest.raises(DataError, match=r"has no poses\. Give them with --poses FILE"):
            dv.open(scans(tmp_path / suffix, suffix))
    with pytest.raises(DataError, match=r"nowhere\.txt: cannot be read"):
        dv.open(tmp_path / ".bin", poses=tmp_path / "nowhere.txt")


def test_viewpoints_are_poses(tmp_path: Path) -> None:
    for k in range(N):
        fields = dict(zip("xyz", XYZ[k].T, strict=True))
        write_pcd(tmp_path / f"{k:03d}.pcd", fields, POSES[k])
    sequence = dv.open(f"files:{tmp_path}")
    agrees(sequence)
    assert sequence.facts["poses"] == "VIEWPOINT of each PCD"  # type: ignore[attr-defined]
    assert isinstance(dv.open(tmp_path), BenchmarkSequence)  # which takes such points as they are
    scans(tmp_path, ".pcd", [f"{k:03d}" for k in range(N)])
    with pytest.raises(DataError, match=r"VIEWPOINT is the identity in every scan.*--poses"):
        dv.open(f"files:{tmp_path}")


def test_a_file_of_poses_speaks_against_the_benchmarks_layout(tmp_path: Path) -> None:
    kitti(scans(tmp_path, ".pcd") / "poses.txt")
    agrees(dv.open(tmp_path))
    (tmp_path / "poses.txt").rename(tmp_path.parent / "other.txt")
    agrees(dv.open(tmp_path, poses=tmp_path.parent / "other.txt"))


def test_formats_that_know_their_poses_take_none(tmp_path: Path) -> None:
    write_pcd(tmp_path / "pcd/000000.pcd", dict(zip("xyz", XYZ[0].T, strict=True)), POSES[0])
    file = kitti(tmp_path / "other.txt", POSES[:1])
    with pytest.raises(UsageError, match="--poses: BenchmarkSequence tells that itself"):
        dv.open(f"benchmark:{tmp_path}", poses=file)
    agrees(dv.open(tmp_path, poses=file), WORLD[:1], POSES[:1])  # what was said counts more than a guess


def test_labels_beside(tmp_path: Path) -> None:
    kitti(scans(tmp_path / "scans") / "poses.txt")
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


@pytest.mark.parametrize("labels", [np.zeros(39, int), np.full(40, 2), np.zeros(40), np.zeros((40, 1), int)])
def test_labels_that_do_not_fit_are_told(tmp_path: Path, labels: np.ndarray) -> None:
    kitti(scans(tmp_path) / "poses.txt")
    (tmp_path / "labels").mkdir()
    np.save(tmp_path / "labels/000003.npy", labels)
    with pytest.raises(DataError, match=r"000003\.npy: holds .*0 static, 1 dynamic, 255 unlabelled"):
        dv.open(tmp_path)[3]


def test_folders_that_cannot_be_read_are_told(tmp_path: Path) -> None:
    (tmp_path / "000000.pts").write_text("")
    with pytest.raises(DataError, match=r"holds no scans but \.pts\. Scans end in \.bin, \.las"):
        dv.open(f"files:{tmp_path}")
    with pytest.raises(DataError, match="is no sequence that is known"):
        dv.open(tmp_path)
    kitti(scans(tmp_path) / "poses.txt")
    scans(tmp_path, ".ply", clouds=XYZ[:2])
    with pytest.raises(DataError, match=r"several kinds: \.bin \(5\), \.ply \(2\)"):
        dv.open(tmp_path)


def test_a_folder_that_may_not_be_listed_is_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "lost+found").mkdir()
    listed = Path.iterdir

    def iterdir(folder: Path) -> Any:
        if folder.name == "lost+found":
            raise PermissionError(13, "Permission denied")
        return listed(folder)

    monkeypatch.setattr(Path, "iterdir", iterdir)
    with pytest.raises(DataError, match="is no sequence that is known"):
        dv.open(tmp_path)


def test_two_scans_of_one_number_are_told(tmp_path: Path) -> None:
    kitti(scans(tmp_path, names=["1", "01", "2", "3", "4"]) / "poses.txt")
    with pytest.raises(DataError, match="has the same number as"):
        dv.open(tmp_path)


def test_a_run_is_no_sequence(tmp_path: Path) -> None:
    write_pcd(tmp_path / "static_map.pcd", dict(zip("xyz", XYZ[0].T, strict=True)))
    np.savez(tmp_path / "labels.npz", a=1)
    with pytest.raises(DataError, match="is no sequence that is known"):
        dv.open(tmp_path)


@pytest.mark.parametrize("damage", ["cut", "no array", "text"])
def test_damaged_npz_is_told(tmp_path: Path, damage: str) -> None:
    kitti(scans(tmp_path, ".npz") / "poses.txt")
    path = tmp_path / "000002.npz"
    if damage == "cut":
        path.write_bytes(path.read_bytes()[:100])
    elif damage == "no array":
        np.savez(path, a=np.zeros(3))
    else:
        path.write_text("no archive")
    with pytest.raises(DataError, match=r"000002\.npz"):
        dv.open(tmp_path)[2]


def test_the_command_line_takes_poses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    scans(tmp_path / "scans", names=NAMES, clouds=WORLD)
    file = tum(tmp_path / "drive.tum", STAMPS[:4], POSES[:4])
    words = ["info", str(tmp_path / "scans"), "--poses", str(file), "--points-in", "world"]
    monkeypatch.setattr(sys, "argv", ["dynaviz", *words])
    with pytest.raises(SystemExit) as end:
        main()
    out, err = capsys.readouterr()
    assert not end.value.code
    assert "drive.tum (TUM), by stamp" in out
    assert "world frame" in out
    assert err.startswith(f"dynaviz: warning: 1 of 5 scans lie outside the poses of {file} and are left out.\n")


def test_a_run_on_such_a_folder(tmp_path: Path) -> None:
    kitti(scans(tmp_path) / "poses.txt")
    assert api.run("octomap", tmp_path).sequence["frames"] == N
