"""dynaviz score, as a user types it."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.worlds import room

from dynaviz.io.pcd import write_pcd

Command = Callable[..., tuple[int, str, str]]


@pytest.fixture
def score(run_command: Command) -> Command:
    """Run ``dynaviz score``."""
    return functools.partial(run_command, "score")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A labelled sequence, the same sequence without labels, and maps of it."""
    path = tmp_path_factory.mktemp("data")
    scans = room(frames=4, rays=1500).scans
    points, labels = (
        np.concatenate([getattr(scan, name) for scan in scans]) for name in ("points", "labels")
    )
    for scan in scans:
        for name in ("room", "bare"):
            xyz = dict(zip("xyz", scan.points.T, strict=True))
            write_pcd(path / f"{name}/pcd/{scan.index:06d}.pcd", xyz, scan.T_world_sensor)
    xyz = dict(zip("xyz", points.T, strict=True))
    write_pcd(path / "room/gt_cloud.pcd", {**xyz, "intensity": labels.astype(np.float32)})
    maps = {"clean": points[labels == 0], "empty": points[:0], "away": points + np.float32(900)}
    for name, kept in maps.items():
        write_pcd(path / f"{name}.pcd", dict(zip("xyz", kept.T, strict=True)))
    for name, rays in (("labels", 1500), ("short", 9)):
        (path / name).mkdir()
        for scan in scans:
            scan.labels[:rays].astype("<u4").tofile(path / f"{name}/{scan.index:06d}.label")
    (path / "cut.pcd").write_bytes((path / "clean.pcd").read_bytes()[:-7])
    (path / "notes.txt").write_text("hello")
    return path


def test_a_map_is_scored_with_all_files(
    score: Command, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = score(folder / "clean.pcd", folder / "room")
    assert code == 0, err
    assert "clean" in out
    assert "100.00" in out
    assert "scoring: nn" in out
    assert "warning" not in err
    files = {path.name for path in (tmp_path / "recordings/room/clean").iterdir()}
    assert files == {"run.rrd", "result.json", "labels.npz", "static_map.pcd", "dynamic_points.pcd"}


def test_labels_of_each_scan_are_scored(score: Command, folder: Path, tmp_path: Path) -> None:
    (folder / "labels/000012.label").unlink()
    code, out, err = score(
        folder / "labels", folder / "room", "-o", tmp_path, "--name", "network", "--record", "none"
    )
    assert code == 0, err
    assert "scoring: mask" in out
    assert (
        err.count(
            "warning: labels: has no labels for 1 of 4 frames (12); their points are not scored"
        )
        == 1
    )
    result = json.loads((tmp_path / "result.json").read_text())
    assert (result["method"], result["metrics"]["AA"], result["counts"]["unlabelled"]) == (
        "network",
        100,
        1500,
    )


def test_options(score: Command, folder: Path, tmp_path: Path) -> None:
    code, out, _ = score(
        folder / "clean.pcd",
        folder / "room",
        "-o",
        tmp_path,
        "--radius",
        0.3,
        "--name",
        "mine",
        "--frames",
        "1:3",
        "--record",
        "none",
        "--threads",
        1,
    )
    assert code == 0
    assert "mine" in out
    result = json.loads((tmp_path / "result.json").read_text())
    assert (result["method"], result["parameters"]["radius"]) == ("mine", 0.3)
    assert (result["sequence"]["frames"], result["recording_sha256"]) == (2, None)


def test_labels_of_every_other_frame(run_command: Command, folder: Path, tmp_path: Path) -> None:
    code, _, err = run_command(
        "run", "octomap", folder / "room", "--stride", 2, "-o", tmp_path / "a b", "--record", "none"
    )
    assert code == 0, err
    code, _, err = run_command(
        "score",
        tmp_path / "a b/labels.npz",
        folder / "room",
        "--stride",
        2,
        "-o",
        tmp_path / "again",
    )
    assert code == 0, err
    first, again = (
        json.loads((tmp_path / name / "result.json").read_text()) for name in ("a b", "again")
    )
    assert first["labels_sha256"] == again["labels_sha256"]


def test_a_run_without_ground_truth_shows_what_it_removed(
    run_command: Command, folder: Path, tmp_path: Path
) -> None:
    code, out, err = run_command("run", "octomap", folder / "bare", "-o", tmp_path)
    assert code == 0, err
    removals = json.loads((tmp_path / "result.json").read_text())["removals"]
    assert removals["removed"] > 0
    assert f"{removals['removed']:,}" in out
    assert "crossed_by_rays 100" in out
    assert "SA" not in out
    for name in ("result.json", "run.rrd"):
        code, out, err = run_command(
            "info", tmp_path / name, "--failures", "--json", tmp_path / "removals.json"
        )
        assert code == 0, err
        assert "There is no ground truth, so it is unknown which points are wrong." in out
        assert f"{removals['removed']:,} of {removals['points']:,} points were removed" in out
        assert json.loads((tmp_path / "removals.json").read_text()) == removals
        assert "Points removed, by reason" in run_command("info", tmp_path / name)[1]


def test_a_map_in_another_frame_gives_a_warning_of_one_line(
    score: Command, folder: Path, tmp_path: Path
) -> None:
    code, _, err = score(folder / "away.pcd", folder / "room", "-o", tmp_path, "--record", "none")
    warnings = [line for line in err.splitlines() if "warning" in line]
    assert code == 0
    assert len(warnings) == 1
    assert "another frame" in warnings[0]


@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ("clean.pcd bare", "no ground truth"),
        ("clean.pcd nowhere", "nowhere"),
        ("clean.pcd room --radius -1", "radius"),
        ("clean.pcd room --frames 7:", "--frames 7:"),
        ("clean.pcd room --name a/b", "name"),
        ("absent.pcd room", "absent.pcd"),
        ("short room", "000010.label: has 9 labels, but the scan has 1,500 points"),
        ("bare room", "bare: contains no label files"),
        ("clean.pcd room --key a", "key = a"),
        ("cut.pcd room", "cut.pcd, byte"),
        ("empty.pcd room", "empty.pcd: contains no points"),
        ("notes.txt room", "notes.txt"),
    ],
)
def test_a_mistake_gives_one_line(
    score: Command, folder: Path, tmp_path: Path, typed: str, expected: str
) -> None:
    map_, sequence, *options = typed.split()
    code, _, err = score(folder / map_, folder / sequence, "-o", tmp_path / "out", *options)
    assert code == 2
    assert err.count("\n") == 1, err
    assert expected in err
    assert not list(tmp_path.rglob("*.*")), "nothing is written"


def test_help_begins_with_examples(score: Command) -> None:
    code, out, _ = score("--help")
    assert code == 0
    assert out.index("  dynaviz score erasor_output.pcd") < out.index("Options:")


def test_a_broken_metric_gives_a_warning(
    broken_plugins: None, score: Command, folder: Path, tmp_path: Path
) -> None:
    code, _, err = score(folder / "clean.pcd", folder / "room", "-o", tmp_path)
    assert (code, err.count("warning: metric 'a_broken_one'"), ".." in err.splitlines()[-1]) == (
        0,
        1,
        False,
    ), err
