"""The functions that scripts call."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.worlds import InMemory

import dynaviz as dv
from dynaviz.contracts.sensors import Sensor
from dynaviz.errors import DataError, UsageError
from dynaviz.scores.collect import combined
from dynaviz.scores.result import Result
from dynaviz.sources.options import Frames


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


@pytest.mark.parametrize(
    ("frames", "stride", "expected"),
    [
        ("1:4", 1, [1, 2, 3]),
        ((1, 4), 1, [1, 2, 3]),
        ((None, 2), 1, [0, 1]),
        (slice(1, 4), 1, [1, 2, 3]),
        (slice(None, None, 2), 1, [0, 2, 4]),
        (slice(-2, None), 1, [3, 4]),
        (range(1, 5, 2), 1, [1, 3]),
        (range(1, 4), 2, [1, 3]),
    ],
)
def test_frames_as_text_pair_slice_or_range(
    frames: Frames, stride: int, expected: list[int]
) -> None:
    world = [(np.ones((2, 3)) * k, np.eye(4)) for k in range(5)]
    drive = dv.open(world, frames=frames, stride=stride)
    assert [int(scan.points[0, 0]) for scan in drive] == expected


@pytest.mark.parametrize("frames", [3, (1, 2, 3), (0.5, 2), [None], {"a": 1}])
def test_frames_of_another_kind_are_rejected(frames: Any) -> None:
    with pytest.raises(UsageError, match="frames = "):
        dv.open([(np.ones((2, 3)), np.eye(4))], frames=frames)


def test_a_step_and_a_stride_are_not_both_given() -> None:
    with pytest.raises(UsageError, match=r"stride = 2: the frames have the step 3 already"):
        dv.open([(np.ones((2, 3)), np.eye(4))] * 9, frames=slice(0, 9, 3), stride=2)


def test_what_a_session_shows_of_a_value_is_one_line(little_room: InMemory) -> None:
    result = dv.run("octomap", little_room)
    drive = dv.open(little_room)
    assert repr(drive) == f"<Drive room: {len(drive)} frames, test, with ground truth>"
    unknown = dv.open([(np.ones((2, 3)), np.eye(4))] * 2)
    assert ": 2 frames, unknown sensor, without ground truth>" in repr(unknown)
    scores = ", ".join(f"{name} {result.metrics[name]:.2f}" for name in ("SA", "DA", "AA"))
    assert repr(result) == f"<Result of octomap on room: {scores}>"
    points = f"{result.sequence.points:,} points"
    assert repr(result.labels) == f"<RunLabels of {len(drive)} frames, {points}>"
    assert result._repr_html_().startswith("<pre>")


def test_dir_lists_what_is_meant_to_be_used() -> None:
    assert dir(dv) == sorted({*dv.__all__, "__version__"})
    assert dv.UsageError is UsageError
    assert dv.DataError is DataError
