"""The functions that scripts call."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.worlds import InMemory

import dynaviz as dv
from dynaviz.contracts.sensors import Sensor
from dynaviz.errors import DataError, UsageError
from dynaviz.scores.collect import combined
from dynaviz.scores.result import Result


def test_a_recording_alone(little_room: InMemory, tmp_path: Path) -> None:
    from dynaviz.views.read.reader import RunRecording

    result = dv.run("octomap", little_room, record=tmp_path / "here.rrd")
    assert [file.name for file in tmp_path.iterdir()] == ["here.rrd"]
    assert RunRecording(tmp_path / "here.rrd").result.metrics == result.metrics


def test_nothing_is_written_without_out_or_record(
    little_room: InMemory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    recorded = dv.run("octomap", little_room, out="kept", record="scores")
    assert dv.run("octomap", little_room).labels_sha256 == recorded.labels_sha256
    assert [file.name for file in tmp_path.iterdir()] == ["kept"]


def test_a_result_stores_the_preset_and_the_origin_of_each_parameter(
    little_room: InMemory, tmp_path: Path
) -> None:
    """Also for a run from Python, which has no command line to read them from."""
    dv.run(
        "octomap",
        little_room,
        preset="av2",
        settings=("prob_hit=0.6",),
        out=tmp_path,
        record="none",
    )
    result = Result.load(tmp_path / "result.json")
    assert result.preset == "av2"
    assert result.parameters.keys() == result.parameter_origins.keys()
    assert result.parameter_origins["prob_hit"] == "--set"
    assert set(result.parameter_origins.values()) == {"default", "preset av2", "--set"}
    assert dv.run("octomap", little_room).preset is None


def test_an_invalid_record_mode_is_rejected(little_room: InMemory) -> None:
    with pytest.raises(
        UsageError, match=r"record = all: give full, errors, scores, none, or the path of an \.rrd"
    ):
        dv.run("octomap", little_room, record="all")


def test_an_invalid_seed_and_a_view_without_a_recording_are_rejected(little_room: InMemory) -> None:
    with pytest.raises(UsageError, match="seed = -1: give 0"):
        dv.run("octomap_g", little_room, seed=-1)
    with pytest.raises(UsageError, match=r"give out=FOLDER or record=FILE\.rrd"):
        dv.run("octomap", little_room, view=True)


def test_a_run_that_fails_takes_nothing_from_the_one_before(
    little_room: InMemory, tmp_path: Path
) -> None:
    dv.run("octomap", little_room, out=tmp_path, record="scores")
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    few = [
        replace(scan, points=scan.points[:50], labels=None, instances=None)
        for scan in little_room.scans
    ]
    with pytest.raises(
        UsageError, match="removert needs the vertical field of view"
    ):  # too few points to estimate it
        dv.run("removert", InMemory(few, "few", Sensor()), out=tmp_path)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before


def test_nothing_of_an_earlier_run_is_taken_for_this_one(
    little_room: InMemory, tmp_path: Path
) -> None:
    dv.run("octomap", little_room, out=tmp_path, record="scores")
    dv.run("dufomap", little_room, out=tmp_path, record=tmp_path / "here.rrd")
    assert sorted(file.name for file in tmp_path.glob("*.rrd")) == ["here.rrd"]
    dv.score(tmp_path / "static_map.pcd", little_room, out=tmp_path / "scored", record="none")
    (tmp_path / "scored/config.toml").write_text("of an earlier run")
    dv.score(tmp_path / "static_map.pcd", little_room, out=tmp_path / "scored", record="none")
    assert sorted(file.name for file in (tmp_path / "scored").iterdir()) == [
        "dynamic_points.pcd", "labels.npz", "result.json", "static_map.pcd",
    ]  # fmt: skip


def test_a_folder_that_cannot_be_written_is_told(
    little_room: InMemory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path, *_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr("dynaviz.engine.outputs.zipfile.ZipFile", refuse)
    with pytest.raises(DataError, match=r"labels\.npz: cannot be written"):
        dv.run("octomap", little_room, out=tmp_path, record="none")


def test_a_broken_metric_ends_no_run_and_no_score(
    broken_plugins: None, little_room: InMemory, tmp_path: Path
) -> None:
    np.save(
        tmp_path / "map.npy",
        np.concatenate([scan.points[scan.labels == 0] for scan in little_room.scans]),
    )
    with pytest.warns(UserWarning, match="metric 'a_broken_one'"):
        results = [dv.run("octomap", little_room)]
    with pytest.warns(UserWarning, match="metric 'a_broken_one'"):
        results.append(dv.score(tmp_path / "map.npy", little_room))
    for result in results:
        with pytest.warns(UserWarning, match="metric 'a_broken_one'"):
            total = combined([result, result])
        assert total.counts["static_kept"] == 2 * result.counts["static_kept"] > 0
