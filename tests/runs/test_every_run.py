"""The ledger of a point exists for every kind of run, and its verdict is the stored label."""

from __future__ import annotations

import dataclasses
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from helpers.bags import START, BagWriter
from helpers.toy_method import InProcessExecutor
from helpers.worlds import room

import dynaviz as dv
from dynaviz.contracts import registry
from dynaviz.contracts.plugin_code import plugin
from dynaviz.errors import DataError, UsageError
from dynaviz.io.maps import open_map
from dynaviz.io.pcd import write_pcd
from dynaviz.runs.explanation import explain
from dynaviz.runs.run import open_run
from dynaviz.scores.result import Result
from dynaviz.sources.datasets.convert import convert
from dynaviz.spatial import geometry

FRAMES, RAYS, ASKED = 5, 900, 20
SCANS = room(FRAMES, RAYS).scans
POSES = np.array([scan.T_world_sensor for scan in SCANS])
LOCAL = [geometry.transform(geometry.inverse(scan.T_world_sensor), scan.points) for scan in SCANS]
MOUNT = "0.5,0,0.3,0,0,90"
Command = Callable[..., tuple[int, str, str]]
SETTINGS = ("resolution=0.4",)


def columns(xyz: np.ndarray) -> dict[str, np.ndarray]:
    return {axis: xyz[:, k].astype(np.float32) for k, axis in enumerate("xyz")}


def mounted() -> np.ndarray:
    """Poses of a vehicle on which the lidar is mounted as in ``MOUNT``."""
    T = np.array([[0, -1, 0, 0.5], [1, 0, 0, 0], [0, 0, 1, 0.3], [0, 0, 0, 1]], np.float64)
    return geometry.compose(POSES, geometry.inverse(T))


def scans_of_a_vehicle(folder: Path) -> tuple[Path, Path]:
    folder.mkdir()
    for k, xyz in enumerate(LOCAL):
        write_pcd(folder / f"{k:06d}.pcd", columns(xyz))
    poses = folder.with_name("vehicle.txt")
    np.savetxt(poses, mounted()[:, :3].reshape(-1, 12), fmt="%.17g")
    return folder, poses


def bag_without_poses(folder: Path) -> Path:
    with BagWriter(folder / "drive", "ros1") as writer:
        for k, xyz in enumerate(LOCAL):
            writer.cloud(k / 10, columns(xyz))
    return writer.path


def merged_map(folder: Path) -> tuple[Path, Path]:
    path, rows = (
        folder / "survey.ply",
        ["stamp [ns]," + ",".join(f"T{r}{c}" for r in range(3) for c in range(4))],
    )
    with open_map(path, {"gps_time": np.dtype("f8")}, np.zeros(3)) as append:
        for k, scan in enumerate(SCANS):
            append(
                scan.points.astype(np.float64),
                {"gps_time": START / 1e9 + 0.1 * k + np.linspace(0, 0.09, RAYS)},
            )
            stamp = START + round(1e8 * k)
            rows.append(f"{stamp},{','.join(map(repr, scan.T_world_sensor[:3].ravel().tolist()))}")
    rows.append(f"{START + FRAMES * 10**8},{','.join(map(repr, POSES[-1, :3].ravel().tolist()))}")
    trajectory = folder / "trajectory.csv"
    trajectory.write_text("\n".join(rows) + "\n")
    return path, trajectory


def stored(folder: Path) -> Path:
    convert(room(FRAMES, RAYS), folder / "room")
    return folder / "room"


def by_command(run: Command, folder: Path) -> Path:
    words = (
        "run",
        "octomap",
        stored(folder),
        "--frames",
        "1:",
        "--set",
        SETTINGS[0],
        "-o",
        folder / "out",
    )
    assert run(*words)[0] == 0
    return folder / "out"


def cleaned_bag(run: Command, folder: Path) -> Path:
    assert (
        run(
            "clean",
            bag_without_poses(folder),
            "-m",
            "octomap",
            "-o",
            folder / "map.pcd",
            "--accept",
        )[0]
        == 0
    )
    return folder / "map_run"


def cleaned_map(run: Command, folder: Path) -> Path:
    path, trajectory = merged_map(folder)
    assert (
        run(
            "clean",
            path,
            "--poses",
            trajectory,
            "-m",
            "octomap",
            "-o",
            folder / "map.pcd",
            "--accept",
        )[0]
        == 0
    )
    return folder / "map_run"


def cleaned_scans(run: Command, folder: Path) -> Path:
    path, poses = scans_of_a_vehicle(folder / "scans")
    words = (
        "clean",
        path,
        "--poses",
        poses,
        "--extrinsic",
        MOUNT,
        "-m",
        "octomap",
        "-o",
        folder / "map.pcd",
        "--accept",
    )
    assert run(*words)[0] == 0
    return folder / "map_run"


def from_python(run: Command, folder: Path) -> Path:
    dv.run(
        "octomap",
        stored(folder),
        out=folder / "out",
        frames=":4",
        stride=2,
        settings={"resolution": 0.4},
    )
    return folder / "out"


def from_a_slice(run: Command, folder: Path) -> Path:
    whole = dv.open(stored(folder), frames="1:")
    dv.run("octomap", dv.open(whole, stride=2), out=folder / "out", settings=SETTINGS)
    return folder / "out"


def from_arrays(run: Command, folder: Path) -> Result:
    return dv.run("octomap", list(zip(LOCAL, POSES, strict=True)), settings=SETTINGS)


def of_a_bench(run: Command, folder: Path) -> Path:
    plan = {
        "methods": ["octomap"],
        "sequences": [{"path": str(stored(folder)), "name": "named", "stride": 2}],
    }
    dv.bench({**plan, "record": "none"}, folder / "bench")
    return folder / "bench/named/octomap"


def on_tiles(run: Command, folder: Path) -> Path:
    result = dv.run("octomap", stored(folder), out=folder / "out", tiles=12.0, settings=SETTINGS)
    recorded = open_run(folder / "out/run.rrd").result
    assert recorded.sections.tiling == result.sections.tiling != None  # noqa: E711
    assert recorded.runtime == result.runtime
    return folder / "out"


def refined(run: Command, folder: Path) -> Path:
    dv.run("octomap", stored(folder), out=folder / "out", refine_poses=True, settings=SETTINGS)
    assert (folder / "out/poses_refined.csv").is_file()
    return folder / "out"


def simulated(run: Command, folder: Path) -> Path:
    assert (
        run("run", "octomap", "simulate:demo:2:7", "-o", folder / "out", "--record", "none")[0] == 0
    )
    return folder / "out"


KINDS = (
    by_command,
    cleaned_bag,
    cleaned_map,
    cleaned_scans,
    from_python,
    from_a_slice,
    from_arrays,
    of_a_bench,
    on_tiles,
    refined,
    simulated,
)


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_the_ledger_gives_the_stored_label(
    kind: Any, run_command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    found = open_run(kind(run_command, tmp_path))
    monkeypatch.chdir("/")  # sources are found again from anywhere
    labels, random = found.labels, np.random.default_rng(3)
    asked = {
        frame: sorted({int(p) for p in random.integers(len(labels[frame]), size=ASKED)})
        for frame in (0, 1)
    }
    answers = explain(found, asked)
    for frame, rows in asked.items():
        for row, why in zip(rows, answers[frame], strict=True):
            assert why.ledger.removed == labels[frame][row]
            assert why.ledger.searched == len(labels)
            assert why.ledger.rules


def test_data_that_moved(run_command: Command, tmp_path: Path) -> None:
    folder = by_command(run_command, tmp_path)
    moved = shutil.move(tmp_path / "room", tmp_path / "elsewhere")
    code, _, err = run_command("why", folder, "--frame", 0, "--point", 3)
    assert (code, "Give the sequence of the run: --sequence PATH" in err) == (2, True)
    code, out, err = run_command("why", folder, "--frame", 0, "--point", 3, "--sequence", moved)
    assert (code, "log-odds" in out) == (0, True), err


def test_arrays_of_another_process(tmp_path: Path) -> None:
    result = dv.run("octomap", list(zip(LOCAL, POSES, strict=True)), out=tmp_path)
    assert dv.why(result, 0, 3).ledger.searched == FRAMES
    with pytest.raises(
        UsageError, match=r"made from data in memory.*call dynaviz\.explore\(result\) there"
    ):
        dv.why(tmp_path, 0, 3)
    again = dv.open(list(zip(LOCAL, POSES, strict=True)))
    assert dv.why(tmp_path, 0, 3, sequence=again).ledger.searched == FRAMES


def test_the_origin_is_in_the_recording_and_in_the_result(tmp_path: Path) -> None:
    made = dv.run("dufomap", stored(tmp_path), out=tmp_path / "out", frames="1:", seed=3)
    for file in ("result.json", "run.rrd"):
        origin = open_run(tmp_path / "out" / file).result.origin
        assert origin == made.origin
        assert origin is not None
        assert origin.absolute == (str(tmp_path / "room"),)
        assert (origin.options.frames, origin.format, origin.sensor) == (
            "1:",
            "benchmark",
            made.origin.sensor,
        )
    assert made.plugin is not None
    assert (made.plugin.package, len(made.plugin.sha256)) == ("dynaviz", 64)


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize(
    "options", [{"poses": "vehicle.txt", "extrinsic": MOUNT}, {"poses": "small-gicp"}]
)
def test_arrays_are_cleaned_like_files(
    options: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With poses of a vehicle and an extrinsic, and with estimated ones."""
    monkeypatch.chdir(tmp_path)
    scans, _ = scans_of_a_vehicle(tmp_path / "scans")
    stored_scans = dv.clean(scans, tmp_path / "a.pcd", method="octomap", record="none", **options)
    arrays = [(xyz, np.eye(4)) for xyz in LOCAL]
    in_memory = dv.clean(arrays, tmp_path / "b.pcd", method="octomap", record="none", **options)
    assert in_memory.result.labels_sha256 == stored_scans.result.labels_sha256
    assert in_memory.result.labels_sha256 != dv.run("octomap", arrays).labels_sha256


def test_a_bench_runs_again_after_the_code_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "plugin"
    package.mkdir()
    source = "from dynaviz_methods.octomap import OctoMap\n\n\nclass Mine(OctoMap):\n    pass\n"
    (package / "mine.py").write_text(source, encoding="utf-8")
    monkeypatch.syspath_prepend(package)
    every = registry.handles
    handle = registry.PluginHandle("methods", "octomap", "mine:Mine", "mine", "1")
    monkeypatch.setattr(
        registry, "handles", lambda kind: [handle] if kind == "methods" else every(kind)
    )
    monkeypatch.setattr("dynaviz.benchmarking.bench.LocalExecutor", InProcessExecutor)
    plan = {"methods": ["octomap"], "sequences": [str(stored(tmp_path))], "record": "none"}
    kept, outdated = [], []
    for code in (source, source, f"{source}    # other code\n"):
        (package / "mine.py").write_text(code, encoding="utf-8")
        plugin.cache_clear()
        (row,) = dv.bench(plan, tmp_path / "bench").rows
        assert row.result is not None, row.error
        kept.append(row.kept)
        outdated.append(row.outdated)
    plugin.cache_clear()
    sys.modules.pop("mine", None)
    assert kept == [False, True, False]
    assert outdated == ["", "", "the code of octomap changed"]


def test_labels_of_other_code_or_of_another_version_are_not_replayed() -> None:
    scans = room(frames=2, rays=300)
    result = dataclasses.replace(dv.run("octomap", scans), labels_sha256="0" * 64)
    with pytest.raises(
        DataError,
        match=r"was written by dynaviz .* whose labels this version does not reproduce\. Run the "
        r"method again",
    ):
        dv.why(result, 0, 0, sequence=scans)
    assert result.plugin is not None
    other = dataclasses.replace(
        result, plugin=msgspec.structs.replace(result.plugin, sha256="1" * 64)
    )
    with pytest.raises(DataError, match="was made by other code of octomap"):
        dv.why(other, 0, 0, sequence=scans)
