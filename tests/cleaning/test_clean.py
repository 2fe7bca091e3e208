"""From data without poses or far from zero to a clean map, its summary and its attributes."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import msgspec
import numpy as np
import pytest
from helpers.scan_folders import write_attributed_scans
from helpers.worlds import room

import dynaviz as dv
from dynaviz.arrays import F64
from dynaviz.contracts import registry
from dynaviz.engine.external import read_external
from dynaviz.errors import NoPoses, UsageError
from dynaviz.io.fields import coordinates, read_fields
from dynaviz.io.maps import DIVIDED_METADATA, DIVIDED_TILES
from dynaviz.io.pcd import write_pcd
from dynaviz.sources.odometry.estimate import estimate
from dynaviz.spatial import geometry

Command = Callable[..., tuple[int, str, str]]
METHOD, FRAMES = "octomap", 4
FAR = np.array([512_000.0, 5_403_000.0, 0.0])
SCANS = room(frames=FRAMES, rays=1500).scans


def write_scans(folder: Path, offset: np.ndarray | float | None = 0.0) -> Path:
    return write_attributed_scans(folder, SCANS, offset)


class TrueOdometry:
    """Knows the poses of the room, in the frame of the first."""

    reference: ClassVar[float] = 1.0
    package: ClassVar[str] = "numpy"
    calls: ClassVar[int] = 0

    def __init__(self, reach: float) -> None:
        assert reach > 0
        self._next = 0

    def register(self, points: F64, times: F64 | None) -> F64:
        assert times is None
        TrueOdometry.calls += 1
        self._next += 1
        first, pose = SCANS[0].T_world_sensor, SCANS[self._next - 1].T_world_sensor
        return geometry.compose(geometry.inverse(first), pose)


@pytest.fixture
def odometry(monkeypatch: pytest.MonkeyPatch) -> type[TrueOdometry]:
    """``small-gicp`` replaced by an odometry that knows the truth."""
    every = registry.handles
    target = f"{TrueOdometry.__module__}:TrueOdometry"
    handle = registry.PluginHandle("odometries", "small-gicp", target, "test", "1")
    monkeypatch.setattr(
        registry, "handles", lambda kind: [handle] if kind == "odometries" else every(kind)
    )
    monkeypatch.setattr(registry.PluginHandle, "load", _load)
    TrueOdometry.calls = 0
    return TrueOdometry


_LOAD = registry.PluginHandle.load


def _load(handle: registry.PluginHandle) -> Any:
    return TrueOdometry if handle.kind == "odometries" else _LOAD(handle)


def clean(source: Any, out: Path, **options: Any) -> Any:
    return dv.clean(source, out, method=METHOD, record="none", threads=1, **options)


def test_the_map_has_the_kept_points_with_their_attributes(tmp_path: Path) -> None:
    cleaned = clean(
        write_scans(tmp_path / "scans"), tmp_path / "map.npz", keep_dynamic=tmp_path / "removed.pcd"
    )
    labels = cleaned.result.labels
    numbers = [np.arange(len(scan)) for scan in SCANS]
    for file, kept in ((tmp_path / "map.npz", True), (tmp_path / "removed.pcd", False)):
        found = read_fields(file)
        chosen = np.concatenate([n[labels[k] != kept] for k, n in enumerate(numbers)])
        assert found["ring"].tobytes() == (chosen % 16).astype(np.uint16).tobytes()
        assert found["intensity"].tobytes() == (chosen / 7).astype(np.float32).tobytes()
    assert cleaned.maps[0].points == sum(len(scan) for scan in SCANS) - cleaned.removals.removed
    np.testing.assert_array_equal(
        cleaned.result.static_map(), coordinates(read_fields(tmp_path / "map.npz"))
    )
    assert 0 < cleaned.removals.removed < 600


@pytest.mark.parametrize("suffix", [".pcd", ".ply", ".npz"])
@pytest.mark.parametrize("points_in", ["sensor", "world"])
def test_double_coordinates_stay_double(tmp_path: Path, suffix: str, points_in: str) -> None:
    """Coordinates with more digits than float32 has, some metres from zero."""
    folder, placed = tmp_path / "scans", []
    folder.mkdir()
    for scan in SCANS:
        T = scan.T_world_sensor
        placed.append(scan.points.astype(np.float64) + 1e-9)
        xyz = (
            placed[-1] if points_in == "world" else geometry.apply(geometry.inverse(T), placed[-1])
        )
        np.save(folder / f"{scan.index:06d}.npy", xyz)
    np.savetxt(folder / "poses.txt", [scan.T_world_sensor[:3].ravel() for scan in SCANS])
    cleaned = clean(folder, tmp_path / f"map{suffix}", points_in=points_in)
    found = read_fields(tmp_path / f"map{suffix}")
    assert found["x"].dtype == np.float64
    kept = np.concatenate([xyz[~cleaned.result.labels[k]] for k, xyz in enumerate(placed)])
    np.testing.assert_allclose(
        coordinates(found), kept, rtol=0, atol=0 if points_in == "world" else 1e-14
    )
    np.testing.assert_array_equal(coordinates(found), cleaned.result.static_map())
    assert ("PCL before 1.15" in str(cleaned)) == (suffix == ".pcd")


def test_the_summary_states_what_was_removed(tmp_path: Path) -> None:
    cleaned = clean(write_scans(tmp_path / "drive"), tmp_path / "map.ply")
    page = (tmp_path / "map_run/summary.md").read_text()
    assert page == str(cleaned)
    assert page.startswith(
        f"# drive, cleaned with {METHOD}\n\nRemoved {cleaned.removals.removed:,} of 6,000 points ("
    )
    for part in (
        "with ring, intensity",
        "## Removed by reason",
        "| 0 to 10 m |",
        "## Look at these first",
    ):
        assert part in page
    names = {path.name for path in (tmp_path / "map_run").iterdir()}
    assert names == {
        "summary.md",
        "labels.npz",
        "result.json",
        "config.toml",
        "trajectory.csv",
        "map.json",
    }
    assert (
        dv.Result.load(tmp_path / "map_run/result.json").labels[2].tolist()
        == cleaned.result.labels[2].tolist()
    )


def test_the_summary_lists_failures_with_ground_truth_and_clusters_without(tmp_path: Path) -> None:
    cleaned = clean(room(FRAMES, 1500), tmp_path / "known.npz")
    first, *_ = cleaned.result.failures
    assert f"1. {first.sentence}" in str(cleaned).split("## Scores: SA ")[1]
    clusters = clean(room(FRAMES, 1500, labelled=False), tmp_path / "unknown.npz").result.clusters
    assert len(clusters) > 1
    ranked = [
        msgspec.structs.replace(clusters[0], suspicion=s, points=n)
        for s, n in ((0.5, 9), (0.5, 30), (0.7, 2))
    ]
    removals = msgspec.structs.replace(cleaned.removals, clusters=tuple(ranked))
    sections = msgspec.structs.replace(cleaned.result.sections, failures=None, removals=removals)
    result = dataclasses.replace(cleaned.result, sections=sections)
    assert [each.points for each in dataclasses.replace(cleaned, result=result).clusters] == [
        2,
        30,
        9,
    ]


def test_far_from_zero_labels_are_the_same_and_the_map_is_far(tmp_path: Path) -> None:
    near = clean(write_scans(tmp_path / "near"), tmp_path / "near.pcd")
    far = clean(write_scans(tmp_path / "far", offset=FAR), tmp_path / "far.pcd")
    assert near.result.labels_sha256 == far.result.labels_sha256
    assert near.result.sequence.digest == far.result.sequence.digest
    a, b = (coordinates(read_fields(tmp_path / f"{name}.pcd")) for name in ("near", "far"))
    np.testing.assert_array_equal(a + FAR, b)


def test_poses_are_estimated_once(tmp_path: Path, odometry: type[TrueOdometry]) -> None:
    given = clean(write_scans(tmp_path / "given"), tmp_path / "given.pcd")
    scans = write_scans(tmp_path / "none", offset=None)
    for reused in (False, True):
        cleaned = clean(scans, tmp_path / "none.pcd")
        assert cleaned.poses.reused is reused
        assert cleaned.poses.distance == pytest.approx(0.2 * (FRAMES - 1))
        assert cleaned.removals.removed == pytest.approx(given.removals.removed, rel=0.1)
    assert odometry.calls == FRAMES
    page = (tmp_path / "none_run/summary.md").read_text()
    assert "Poses were estimated with small-gicp" in page
    again = dv.open(scans, poses=tmp_path / "none_run/poses_small-gicp.csv")
    np.testing.assert_allclose(again[3].T_world_sensor[:3, 3], [0.6, 0, 0], atol=1e-12)


def test_given_poses_can_be_replaced_by_estimated_ones(
    tmp_path: Path, odometry: type[TrueOdometry]
) -> None:
    cleaned = clean(
        write_scans(tmp_path / "scans"), tmp_path / "map.pcd", poses="small-gicp", frames="0:3"
    )
    assert (cleaned.poses.frames, odometry.calls) == (3, 3)
    assert cleaned.result.sequence.frames == 3


def test_poses_that_are_all_the_identity_count_as_none(
    tmp_path: Path, odometry: type[TrueOdometry]
) -> None:
    scans = write_scans(tmp_path / "scans", offset=None)
    for scan in scans.iterdir():
        write_pcd(scan, read_fields(scan), np.eye(4))
    cleaned = clean(scans, tmp_path / "map.pcd")
    assert cleaned.poses.distance == pytest.approx(0.2 * (FRAMES - 1))


def test_another_sequence_does_not_use_the_poses_of_the_first(
    tmp_path: Path, odometry: type[TrueOdometry]
) -> None:
    estimate("small-gicp", room(frames=FRAMES), tmp_path, False)
    estimate("small-gicp", room(frames=FRAMES, seed=1), tmp_path, False)
    assert odometry.calls == 2 * FRAMES


def test_region_and_voxels_limit_the_map_only(tmp_path: Path) -> None:
    scans = write_scans(tmp_path / "scans", offset=FAR)
    corner, opposite = FAR + np.array([-2, -3, 0]), FAR + np.array([4, 2, 0])
    box = ",".join(f"{x}" for x in (*corner[:2], *opposite[:2]))
    cleaned = clean(scans, tmp_path / "map.pcd", region=box, voxel_size=0.5)
    xyz = coordinates(read_fields(tmp_path / "map.pcd"))
    assert ((xyz[:, :2] >= corner[:2]) & (xyz[:, :2] <= opposite[:2])).all()
    assert len(np.unique(np.floor(xyz / 0.5), axis=0)) == len(xyz) > 50
    assert cleaned.result.sequence.points == 6000
    (tmp_path / "corners.txt").write_text(
        "\n".join(f"{FAR[0] + x}, {FAR[1] + y}" for x, y in [(-2, 0), (2, 0), (0, 3)])
    )
    clean(scans, tmp_path / "map.pcd", region=str(tmp_path / "corners.txt"))
    x, y = (coordinates(read_fields(tmp_path / "map.pcd")) - FAR)[:, :2].T
    assert len(x) > 10
    assert ((y >= 0) & (y <= 3 - 1.5 * np.abs(x) + 1e-6)).all()


def test_a_region_without_points_is_an_error_before_the_run(tmp_path: Path) -> None:
    scans = write_scans(tmp_path / "scans", offset=FAR)
    with pytest.raises(
        UsageError, match=r'region="-4,-3,4,3": contains no point of .*Give it in the coordinates'
    ):
        clean(scans, tmp_path / "map.pcd", region="-4,-3,4,3")
    assert not (tmp_path / "map.pcd").exists()
    assert not (tmp_path / "map_run").exists()


@pytest.mark.parametrize("kind", ["poses", "share"])
@pytest.mark.filterwarnings("ignore:.*quaternion|.*inverted|.*overlap")
def test_a_doubtful_map_ends_with_a_box_and_code_3(
    run_command: Command, tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Points that are read in the wrong frame.

    And a share above the limit, which is lowered here.
    """
    scans = write_scans(tmp_path / "drive")
    words = [
        "clean",
        scans,
        "-o",
        tmp_path / "map.pcd",
        "-m",
        METHOD,
        "--record",
        "none",
        "--threads",
        1,
        "--quiet",
    ]
    if kind == "poses":
        words += ["--points-in", "world"]
        expected = "clean.*--points-in world.*--points-in sensor"
    else:
        monkeypatch.setattr("dynaviz.cleaning.doubt.MOST_REMOVED", 1.0)
        expected = "clean.*--poses small-gicp"
    code, out, err = run_command(*words)
    assert code == 3
    assert (tmp_path / "map.pcd").is_file()
    assert "Check this map before you use it" in err
    box = " ".join(out.replace("▌", " ").split())
    assert box.count("Check this map before you use it") == 1
    assert re.search(f"Likeliest cause: .*Try: .*{expected}", box)
    assert "docs/wrong_map.md" in box
    page = (tmp_path / "map_run/summary.md").read_text()
    assert page.startswith(
        f"# drive, cleaned with {METHOD}\n\n> **Check this map before you use it.**"
    )
    code, out, err = run_command(*words, "--json", "-")
    assert code == 3
    assert re.search(f"Likeliest cause: .*{expected}", " ".join(err.replace("│", " ").split()))
    code, out, err = run_command(*words, "--accept", "--json", "-")
    assert code == 0
    assert "check this map" not in err.lower()
    assert json.loads(out)["doubt"]["command"]


def test_a_divided_map(tmp_path: Path) -> None:
    cleaned = clean(write_scans(tmp_path / "scans"), tmp_path / "map", tiles="autoware")
    tiles = list((tmp_path / "map" / DIVIDED_TILES).glob("*.pcd"))
    assert len(tiles) == 4
    assert sum(len(read_fields(tile)["ring"]) for tile in tiles) == cleaned.maps[0].points


def test_a_run_on_tiles_writes_a_file_for_each_and_an_index(tmp_path: Path) -> None:
    scans = write_scans(tmp_path / "scans")
    clean(scans, tmp_path / "whole.pcd")
    cleaned = clean(scans, tmp_path / "city.pcd", tiles="10")
    folder, whole = tmp_path / "city", read_fields(tmp_path / "whole.pcd")
    assert cleaned.maps[0].path == folder
    index = json.loads((folder / "tiles.json").read_text())
    assert {tile["file"] for tile in index["tiles"]} == {path.name for path in folder.glob("*.pcd")}
    rows = []
    for tile in index["tiles"]:
        fields = read_fields(folder / tile["file"])
        xyz = coordinates(fields)
        assert (np.floor(xyz[:, :2] / 10) == [tile["column"], tile["row"]]).all()
        assert len(xyz) == tile["points"]
        rows += zip(*xyz.T.tolist(), fields["ring"].tolist(), strict=True)
    assert len(index["tiles"]) > 1
    assert sorted(rows) == sorted(
        zip(*coordinates(whole).T.tolist(), whole["ring"].tolist(), strict=True)
    )


def test_tiles_without_a_suffix_are_the_divided_map_of_autoware(tmp_path: Path) -> None:
    scans = write_scans(tmp_path / "scans")
    cleaned = clean(scans, tmp_path / "map", tiles=10)
    assert cleaned.result.sections.tiling
    assert (tmp_path / "map" / DIVIDED_METADATA).is_file()


def test_arrays_and_settings_from_python(tmp_path: Path) -> None:
    scans = [
        (geometry.apply(geometry.inverse(scan.T_world_sensor), scan.points), scan.T_world_sensor)
        for scan in SCANS
    ]
    result = dv.run(METHOD, scans, settings={"resolution": 0.3}, threads=1)
    assert result.parameters["resolution"] == 0.3
    assert [len(labels) for labels in result.labels] == [1500] * FRAMES
    assert sum(int(labels.sum()) for labels in result.labels) == 6000 - len(result.static_map())
    with pytest.raises(
        UsageError, match=r"scan 1, points: \(3,\) of float64\. Give \(N, 3 or more\)"
    ):
        dv.open([scans[0], (np.zeros(3), np.eye(4))])


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        ("-o map.xyz", "unknown map format"),
        ("-o map.pcd --region 1,2,3", "has 3 numbers"),
        ("-o map.pcd --voxel-size 0", "at least 0.001"),
        ("-o map.pcd --keep-dynamic map.pcd", "is the map itself"),
        ("-o map.pcd --tiles autoware", "a divided map is a folder"),
        ("-o map --tiles 20m", "from 10 to 1000; or autoware"),
    ],
)
def test_mistakes_are_found_before_anything_is_read(
    run_command: Command, typed: str, message: str
) -> None:
    code, _, err = run_command("clean", "absent", *typed.split())
    assert (code, err.count("\n")) == (2, 1)
    assert message in err


def test_the_command_prints_json(run_command: Command, tmp_path: Path) -> None:
    scans = write_scans(tmp_path / "scans")
    options = ("-m", METHOD, "--record", "none", "--threads", 1, "--quiet", "--json", "-")
    code, out, err = run_command("clean", scans, "-o", tmp_path / "map.pcd", *options)
    assert (code, err) == (0, "")
    found = json.loads(out)
    assert found["points"] == 6000
    assert found["maps"][0]["attributes"] == ["ring", "intensity"]


def test_a_run_far_from_zero_writes_far_maps_that_can_be_scored(tmp_path: Path) -> None:
    scans = write_scans(tmp_path / "scans", offset=FAR)
    result = dv.run(METHOD, scans, out=tmp_path / "run", record="none", threads=1)
    xyz = coordinates(read_fields(tmp_path / "run/static_map.pcd"))
    np.testing.assert_array_equal(xyz, result.static_map())
    np.testing.assert_array_equal(dv.Result.load(tmp_path / "run/result.json").static_map(), xyz)
    assert (xyz.min(0) > FAR - 50).all()
    external = read_external(tmp_path / "run/static_map.pcd", dv.open(scans))
    assert np.abs(external.points).max() < 50


def in_sensor_frames() -> list[np.ndarray]:
    return [geometry.apply(geometry.inverse(scan.T_world_sensor), scan.points) for scan in SCANS]


def test_arrays_without_poses_are_registered(tmp_path: Path, odometry: type[TrueOdometry]) -> None:
    given = clean(
        list(zip(in_sensor_frames(), (s.T_world_sensor for s in SCANS), strict=True)),
        tmp_path / "given.pcd",
    )
    estimated = clean(in_sensor_frames(), tmp_path / "map.pcd")
    assert estimated.poses.distance == pytest.approx(0.2 * (FRAMES - 1))
    assert estimated.removals.removed == pytest.approx(given.removals.removed, rel=0.1)
    assert odometry.calls == FRAMES
    with pytest.raises(
        NoPoses, match=r"arrays: have no poses\. Estimate them with poses=.small-gicp."
    ):
        dv.open(in_sensor_frames())


def test_poses_may_be_an_array(tmp_path: Path) -> None:
    poses = np.array([scan.T_world_sensor for scan in SCANS])
    paired = clean(list(zip(in_sensor_frames(), poses, strict=True)), tmp_path / "a.pcd")
    apart = clean(in_sensor_frames(), tmp_path / "b.pcd", poses=poses)
    assert apart.result.labels_sha256 == paired.result.labels_sha256
    with pytest.raises(UsageError, match=r"poses: 3 for 4 scans\. Give one for each scan"):
        dv.open(in_sensor_frames(), poses=poses[:3])
    poses[2, 0, 3] = np.nan
    with pytest.raises(UsageError, match="scan 2, pose: has NaN"):
        dv.open(in_sensor_frames(), poses=poses)
