"""Every point of a source is in the account of the map.

Kept, removed, without a pose, not finite or outside.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.argoverse2_files import write_log
from helpers.bags import KINDS, START, BagWriter
from helpers.kitti_files import write_odometry, write_raw_drive, write_semantickitti
from helpers.nuscenes_files import write_nuscenes
from helpers.scan_folders import write_tum_poses
from helpers.worlds import room

import dynaviz as dv
from dynaviz.engine.region import Region
from dynaviz.io.fields import coordinates, read_fields
from dynaviz.io.maps import open_map
from dynaviz.io.pcd import write_pcd
from dynaviz.scores.account import PointAccount
from dynaviz.spatial import geometry

FRAMES, POINTS = 6, 1500
SCANS = room(frames=FRAMES, rays=POINTS).scans
POSES = np.array([scan.T_world_sensor for scan in SCANS])
LOCAL = [geometry.transform(geometry.inverse(scan.T_world_sensor), scan.points) for scan in SCANS]
UTM = np.array([512_000.0, 5_403_000.0, 380.0])
UNPOSED = 2 * POINTS  # of two scans, in sources whose poses do not cover them


def columns(xyz: np.ndarray) -> dict[str, np.ndarray]:
    return {axis: xyz[:, k].astype(np.float32) for k, axis in enumerate("xyz")}


def bag(
    folder: Path,
    kind: str = "ros1",
    posed: int = FRAMES,
    lidars: tuple[str, ...] = ("/points",),
    world: bool = False,
) -> Path:
    with BagWriter(folder / "drive", kind) as writer:
        for k in range(FRAMES):
            for topic in lidars:
                writer.cloud(k / 10, columns(SCANS[k].points if world else LOCAL[k]), topic=topic)
            if k < posed:
                writer.odometry(k / 10, POSES[k])
    return writer.path


def folder(
    at_: Path, suffix: str = ".pcd", *, offset: Any = 0.0, world: bool = False, posed: int = FRAMES
) -> Path:
    at_.mkdir()
    for k, scan in enumerate(SCANS):
        xyz = scan.points + np.asarray(offset) if world else LOCAL[k]
        if suffix == ".pcd":
            write_pcd(
                at_ / f"{k:06d}.pcd",
                columns(xyz) if not world else dict(zip("xyz", xyz.T, strict=True)),
            )
        elif suffix == ".npy":
            np.save(at_ / f"{k:06d}.npy", xyz)
        else:
            with open_map(at_ / f"{k:06d}{suffix}", {}, np.zeros(3)) as append:
                append(xyz.astype(np.float64), {})
    T = POSES.copy()
    T[:, :3, 3] += offset
    rows = "\n".join(f"{k},{','.join(map(repr, T[k, :3].ravel().tolist()))}" for k in range(posed))
    names = ",".join(f"T{row}{column}" for row in range(3) for column in range(4))
    (at_ / "poses.csv").write_text(f"index,{names}\n{rows}\n")
    return at_


def merged(at_: Path, suffix: str, offset: Any = 0.0) -> tuple[Path, Path]:
    """A map whose last two scans have times after the trajectory."""
    at_.mkdir()
    path = at_ / f"survey{suffix}"
    fields = {"gps_time": np.dtype("f8"), "intensity": np.dtype("u2")}
    with open_map(path, fields, np.asarray(offset) + np.zeros(3)) as append:
        for k, scan in enumerate(SCANS):
            seconds = START / 1e9 + 0.1 * k + np.linspace(0.001, 0.09, POINTS)
            append(
                scan.points + np.asarray(offset),
                {"gps_time": seconds, "intensity": np.arange(POINTS).astype("u2")},
            )
    T = POSES[: FRAMES - 1].copy()
    T[:, :3, 3] += offset
    return path, write_tum_poses(
        at_ / "t.tum", [START + k * 100_000_000 for k in range(FRAMES - 1)], T
    )


def arrays(nan: int = 0, empty: bool = False) -> list[tuple[np.ndarray, np.ndarray]]:
    clouds = [xyz.copy() for xyz in LOCAL]
    clouds[2][:nan] = np.nan
    if empty:
        clouds[3] = np.empty((0, 3), np.float32)
    return list(zip(clouds, POSES, strict=True))


Made = tuple[Any, dict[str, Any], dict[str, int]]
WHOLE = {"points": FRAMES * POINTS}
SHORT = {"unposed_left_out": UNPOSED}
SOURCES: dict[str, Callable[[Path], Made]] = {
    **{f"bag {kind}": lambda p, kind=kind: (bag(p, kind), {}, {}) for kind in KINDS},
    "bag with clouds after the poses": lambda p: (bag(p, posed=FRAMES - 2), {}, SHORT),
    "bag in the world, after the poses": lambda p: (
        bag(p, posed=FRAMES - 2, world=True), {"points_in": "world", "poses": "/odom"},
        {"unposed_kept": UNPOSED}),
    "bag of two lidars": lambda p: (
        f"{bag(p, lidars=('/a', '/b'))}#/a,/b", {}, {"points": 2 * FRAMES * POINTS}),
    "folder pcd": lambda p: (folder(p / "s"), {}, {}),
    "folder npy": lambda p: (folder(p / "s", ".npy"), {}, {}),
    "folder laz": lambda p: (folder(p / "s", ".laz"), {}, {}),
    "folder with fewer poses": lambda p: (folder(p / "s", posed=FRAMES - 2), {}, SHORT),
    "folder in the world, with fewer poses": lambda p: (
        folder(p / "s", world=True, posed=FRAMES - 2), {"points_in": "world"},
        {"unposed_kept": UNPOSED}),
    "folder in UTM": lambda p: (folder(p / "s", offset=UTM), {}, {}),
    "folder in UTM, in the "
    "world": lambda p: (folder(p / "s", offset=UTM, world=True), {"points_in": "world"}, {}),
    **{
        f"merged {suffix}": lambda p, suffix=suffix: (
            *with_poses(merged(p / "m", suffix, UTM)), {"unposed_kept": UNPOSED})
        for suffix in (".laz", ".las", ".pcd", ".ply")
    },
    "merged, outside dropped": lambda p: (
        *with_poses(merged(p / "m", ".laz"), drop_unposed=True), SHORT),
    "arrays": lambda p: (arrays(), {}, {}),
    "arrays with NaN": lambda p: (arrays(nan=40), {}, {"not_finite": 40}),
    "arrays with an empty "
    "scan": lambda p: (arrays(empty=True), {}, {"points": (FRAMES - 1) * POINTS}),
    "region": lambda p: (arrays(), {"region": "-2,-2,2,2"}, {}),
    "voxels": lambda p: (arrays(), {"voxel_size": 0.5}, {}),
    "marked": lambda p: (arrays(nan=40), {"mark": True}, {"not_finite": 40}),
}  # fmt: skip


def with_poses(files: tuple[Path, Path], **more: Any) -> tuple[Path, dict[str, Any]]:
    return files[0], {"poses": files[1], **more}


def added(account: PointAccount) -> int:
    return sum(getattr(account, name) for name in account.__struct_fields__ if name != "points")


@pytest.mark.filterwarnings("ignore:.*are skipped", "ignore:.*no TF from")
@pytest.mark.parametrize("kind", SOURCES)
def test_the_account_adds_up(tmp_path: Path, kind: str) -> None:
    source, options, expected = SOURCES[kind](tmp_path)
    out = tmp_path / "map.pcd"
    with np.errstate(invalid="ignore"):
        cleaned = dv.clean(source, out, method="octomap", record="none", threads=1, **options)
    account, xyz = cleaned.account, coordinates(read_fields(out))
    for name, count in {
        **WHOLE,
        "not_finite": 0,
        "unposed_kept": 0,
        "unposed_left_out": 0,
        **expected,
    }.items():
        assert getattr(account, name) == count, name
    assert added(account) == account.points
    marked = account.removed if options.get("mark") else 0
    assert len(xyz) == cleaned.maps[0].points == account.kept + account.unposed_kept + marked
    assert 0 < account.removed < account.kept
    assert account.removed == cleaned.removals.removed
    assert f"{account.points:,} in = {account.kept:,} kept" in str(cleaned)
    if "region" in options:
        inside = Region.parse(options["region"]).contains
        assert inside(xyz).all()
        whole = np.concatenate([scan.points for scan in SCANS]).astype(np.float64)
        assert account.kept < inside(whole).sum() < account.kept + account.removed


@pytest.mark.parametrize(
    "write",
    [write_raw_drive, write_odometry, write_semantickitti, write_nuscenes, write_log],
    ids=lambda f: f.__name__,
)
def test_data_sets(tmp_path: Path, write: Callable[[Path], Path | None]) -> None:
    """A few points per scan, so nothing needs to be removed."""
    sequence = dv.open(write(tmp_path / "data") or tmp_path / "data")
    raw = [sequence[k].points for k in range(len(sequence))]
    cleaned = dv.clean(sequence, tmp_path / "map.ply", method="octomap", record="none", threads=1)
    assert added(cleaned.account) == cleaned.account.points == sum(map(len, raw))
    assert len(read_fields(tmp_path / "map.ply")["x"]) == cleaned.account.kept
    assert cleaned.account.not_finite == sum(
        int((~np.isfinite(points).all(1)).sum()) for points in raw
    )


def test_a_run_has_an_account_too(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="2 of 6 scans"):
        result = dv.run(
            "octomap",
            bag(tmp_path, posed=FRAMES - 2),
            out=tmp_path / "run",
            record="none",
            threads=1,
        )
    assert result.account is not None
    assert (result.account.points, result.account.unposed_left_out) == (FRAMES * POINTS, UNPOSED)
    assert added(result.account) == result.account.points
    assert len(result.static_map()) == result.account.kept


def test_marked_points_are_those_that_would_be_removed(tmp_path: Path) -> None:
    path, poses = merged(tmp_path / "m", ".laz", UTM)
    options = {"method": "octomap", "record": "none", "threads": 1, "poses": poses}
    removed = dv.clean(path, tmp_path / "a.laz", keep_dynamic=tmp_path / "removed.laz", **options)
    for suffix in (".laz", ".pcd", ".ply", ".npz"):
        marked = dv.clean(path, tmp_path / f"b{suffix}", mark=True, **options)
        fields = read_fields(tmp_path / f"b{suffix}")
        assert len(fields["x"]) == FRAMES * POINTS == marked.account.points
        dynamic = fields["dynamic"] == 1
        apart = read_fields(tmp_path / "removed.laz")
        np.testing.assert_array_equal(fields["gps_time"][dynamic], apart["gps_time"])
        assert dynamic.sum() == removed.account.removed > 0
        assert (fields["dynamic"] == 2).sum() == UNPOSED == (fields["reason"] == 255).sum()
        names = marked.to_dict()["reason_names"]
        codes, counts = np.unique(fields["reason"][dynamic], return_counts=True)
        assert {
            names[code]: n for code, n in zip(codes.tolist(), counts.tolist(), strict=True)
        } == marked.removals.reasons


def test_the_terminal_shows_the_account_once(
    run_command: Callable[..., tuple[int, str, str]], tmp_path: Path
) -> None:
    source = folder(tmp_path / "s", posed=FRAMES)
    words = ("-m", "octomap", "--record", "none", "--threads", 1, "--quiet")
    code, out, _ = run_command("clean", source, "-o", tmp_path / "map.pcd", *words)
    assert code == 0
    assert " ".join(out.split()).count(f"Points: {FRAMES * POINTS:,} in = ") == 1
    code, out, _ = run_command("clean", source, "-o", tmp_path / "map.pcd", *words, "--json", "-")
    found = json.loads(out)["account"]
    assert found.pop("points") == sum(found.values()) == FRAMES * POINTS
