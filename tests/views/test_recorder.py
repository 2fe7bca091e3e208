"""What a recording contains in each mode."""

from __future__ import annotations

import hashlib
import json
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.guessing_method import guess_run, record, record_with_metrics
from helpers.worlds import InMemory, room
from rerun.chunk import RrdReader

from dynaviz.contracts.extent import CELL, Extent
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.probe import MemoryProbe
from dynaviz.contracts.scan import Outcome, Scan, outcomes
from dynaviz.engine.loop import Listener, execute
from dynaviz.errors import DataError, UsageError
from dynaviz.spatial.grid import pack
from dynaviz.views import classes, paths
from dynaviz.views.read.reader import RunRecording
from dynaviz.views.record.recorder import Recorder

MODES = ("full", "errors", "scores")
WORLD = {
    paths.SCAN, paths.MAP, paths.MAP_WRONG, paths.REMOVED, paths.REMOVED_WRONG,
    paths.TRAJECTORY, paths.SENSOR, paths.RINGS, paths.LEGEND,
}  # fmt: skip
NUMBERS = {
    "answers", "report", "report/failures", "log",
    "scores/SA/so_far", "scores/SA/frame", "scores/DA/so_far", "reasons/band", paths.WORST,
    "scores/wrong_points/false_negatives", "scores/wrong_points/false_positives",
    "error_distance/false_negative", "error_distance/false_negative/run",
    "error_distance/false_negative/p10",
}  # fmt: skip
STATES = {
    *(
        f"world/guess/{name}"
        for name in ("cells", "plain_cells", "found", "kinds", "ground", "plane")
    ),
    *(f"guess/{name}" for name in ("ranges", "bins", "bins/rings", "bins/travel", "count")),
    *(
        f"guess/keys/{name}"
        for name in ("cells", "plain_cells", "found", "kinds", "ground", "plane", "ranges", "bins")
    ),
}


def expected(sequence: InMemory) -> list[Labelled]:
    """The labels of the test's method, computed here."""
    answers = []
    for frame, scan in enumerate(sequence.scans):
        dynamic = (scan.points[:, 2] < 1.0) & (scan.points[:, 1] > 2.2)
        answers.append(Labelled.of(frame, scan, dynamic, dynamic.astype(np.uint8)))
    return answers


@pytest.mark.parametrize(
    ("mode", "entities"),
    [
        (MODES[0], WORLD | STATES),
        (MODES[1], WORLD | STATES | {paths.SCAN_ROWS}),
        (MODES[2], set()),
    ],
)
def test_every_entity_is_recorded(
    little_room: InMemory, tmp_path: Path, mode: str, entities: set[str]
) -> None:
    found = set(RunRecording(record(little_room, tmp_path / "run.rrd", mode)).entities())
    assert found - {"", "world"} == NUMBERS | entities


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("online", [False, True])
def test_all_labels_are_recorded(
    little_room: InMemory, tmp_path: Path, mode: str, online: bool
) -> None:
    recording = RunRecording(record(little_room, tmp_path / "run.rrd", mode, online=online))
    answers = list(recording.answers())
    assert [a.index for a in answers] == [10, 11, 12, 13, 14, 15]
    for a, b in zip(answers, expected(little_room), strict=True):
        assert a.frame == b.frame
        np.testing.assert_array_equal(a.dynamic, b.dynamic)
        np.testing.assert_array_equal(a.truth, b.scan.labels)
        np.testing.assert_array_equal(a.reasons, b.reasons)
        np.testing.assert_array_equal(a.outcome, b.outcome)


def test_full_draws_every_point(little_room: InMemory, tmp_path: Path) -> None:
    recording = RunRecording(record(little_room, tmp_path / "run.rrd", "full"))
    for drawn, truth in zip(recording.drawn(), expected(little_room), strict=True):
        np.testing.assert_array_equal(drawn.xyz, truth.scan.points)
        np.testing.assert_array_equal(drawn.outcome, truth.outcome)
        assert drawn.stands_for.tolist() == [1] * len(truth.scan)


def test_errors_draws_dynamic_points_and_downsamples_false_positives(
    little_room: InMemory, tmp_path: Path
) -> None:
    recording = RunRecording(record(little_room, tmp_path / "run.rrd", "errors"))
    for drawn, truth in zip(recording.drawn(), expected(little_room), strict=True):
        np.testing.assert_array_equal(drawn.xyz, truth.scan.points[drawn.point])
        np.testing.assert_array_equal(drawn.outcome, truth.outcome[drawn.point])
        for outcome in Outcome:
            mine, all_of_it = drawn.outcome == outcome, truth.outcome == outcome
            if outcome in (Outcome.STATIC_KEPT, Outcome.UNLABELLED_KEPT):
                assert not mine.any()
            else:
                assert drawn.stands_for[mine].sum() == all_of_it.sum()
        wrong = drawn.outcome == Outcome.FALSE_POSITIVE
        assert 0 < wrong.sum() < (truth.outcome == Outcome.FALSE_POSITIVE).sum()
        moving = (drawn.outcome == Outcome.DYNAMIC_REMOVED) | (
            drawn.outcome == Outcome.FALSE_NEGATIVE
        )
        assert moving.sum() == truth.scan.labels.sum()  # type: ignore[union-attr]


def test_the_map_contains_one_kept_point_per_voxel(little_room: InMemory, tmp_path: Path) -> None:
    recording = RunRecording(record(little_room, tmp_path / "run.rrd"))
    kept = np.concatenate(
        [e.scan.points[e.outcome == Outcome.STATIC_KEPT] for e in expected(little_room)]
    )
    xyz = recording.static(paths.MAP)["Points3D:positions"]
    middle = np.round(np.median(Extent.of(*little_room.scans).cells, axis=0) * CELL).astype(
        np.float32
    )
    reasons = {
        tuple(p.round(3)): r
        for e in expected(little_room)
        for p, r in zip(e.scan.points, e.reasons, strict=True)
    }
    for path, outcome in (
        (paths.MAP, Outcome.STATIC_KEPT), (paths.MAP_WRONG, Outcome.FALSE_NEGATIVE),
        (paths.REMOVED, Outcome.DYNAMIC_REMOVED), (paths.REMOVED_WRONG, Outcome.FALSE_POSITIVE),
    ):  # fmt: skip
        drawn = recording.static(path)
        assert set(classes.outcomes(drawn["Points3D:class_ids"])) == {outcome}
        codes = [reasons[tuple(p.round(3))] for p in drawn["Points3D:positions"]]
        assert (drawn["Points3D:class_ids"] % classes.REASONS).tolist() == codes
    assert len(xyz) == len(np.unique(pack(kept - middle, 0.2)))


def test_properties_describe_the_run(little_room: InMemory, tmp_path: Path) -> None:
    recording = RunRecording(
        record(little_room, tmp_path / "run.rrd", "scores", seed=7, command="typed")
    )
    p, result = recording.properties, recording.result
    assert result is not None
    assert recording.complete
    properties = {
        "method": "guess",
        "sequence": "room",
        "frames": 6,
        "mode": "scores",
        "seed": 7,
        "online": False,
    }
    assert {name: p[name] for name in properties} == properties
    assert p["digest"] == result.sequence.digest
    assert p["points"] == sum(len(s) for s in little_room.scans)
    assert recording.parameters == {"height": 1.0, "note": "a|b"}
    assert [r.name for r in recording.reasons] == ["outside", "band", "at_sensor"]
    assert json.loads(p["environment_json"])["versions"]["rerun-sdk"]
    assert result.metrics == {"SA": 90.0, "DA": None}
    assert recording.facts()["command"] == "typed"


def test_curves_keep_order_and_gaps(little_room: InMemory, tmp_path: Path) -> None:
    recording = RunRecording(record(little_room, tmp_path / "run.rrd", "scores"))
    frames, values = recording.curve("scores/wrong_points/false_positives")
    assert frames.tolist() == [0, 1, 2, 3, 4, 5]
    assert values.tolist() == [
        (e.outcome == Outcome.FALSE_POSITIVE).sum() for e in expected(little_room)
    ]
    assert np.isnan(recording.curve("scores/DA/so_far")[1]).all()
    assert len(recording.curve("scores/none")[0]) == 0
    worst, _ = recording.curve(paths.WORST)
    assert len(worst) == 5


def test_timelines(little_room: InMemory, tmp_path: Path) -> None:
    assert timelines(record(little_room, tmp_path / "run.rrd")) == {"frame", "sensor_time"}
    blind = InMemory([replace(scan, stamp_ns=None) for scan in little_room.scans])
    assert timelines(record(blind, tmp_path / "unstamped.rrd")) == {"frame"}


def timelines(path: Path) -> set[str]:
    return {column.name for column in RrdReader(path).store().schema().index_columns()}


NOTHING = np.empty((0, 3), np.float32)


def empty_scan(scan: Scan) -> Scan:
    return replace(scan, points=NOTHING, labels=np.empty(0, np.uint8), instances=None)


def holey_scan(scan: Scan) -> Scan:
    points = scan.points.copy()
    points[::7] = np.nan
    return replace(scan, points=points)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(
    "change",
    [
        empty_scan,
        holey_scan,
        lambda scan: scan.without_truth(),
        lambda scan: replace(scan, labels=np.zeros(len(scan), np.uint8)),
        lambda scan: replace(scan, labels=np.full(len(scan), 255, np.uint8)),
        lambda scan: replace(
            scan, points=scan.points + np.float32(3e4), T_world_sensor=far_away(scan), origins=None
        ),
        lambda scan: replace(scan, points=scan.points * np.float32([1, 1, 1e4])),
    ],
    ids=[
        "empty",
        "not finite",
        "no labels",
        "nothing moves",
        "unlabelled",
        "far from the origin",
        "stray points",
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value encountered")
def test_odd_scans(tmp_path: Path, mode: str, change: Callable[[Scan], Scan]) -> None:
    scans = [change(scan) if i in (0, 2) else scan for i, scan in enumerate(room(4, 300).scans)]
    recording = RunRecording(record(InMemory(scans), tmp_path / "run.rrd", mode))
    for answer, scan in zip(recording.answers(), scans, strict=True):
        dynamic = (scan.points[:, 2] < 1.0) & (scan.points[:, 1] > 2.2)
        np.testing.assert_array_equal(answer.outcome, outcomes(scan.labels, dynamic))


def far_away(scan: Scan) -> np.ndarray:
    T_world_sensor = scan.T_world_sensor.copy()
    T_world_sensor[:3, 3] += 3e4
    return T_world_sensor


def test_labels_do_not_depend_on_the_probe(little_room: InMemory, tmp_path: Path) -> None:
    run = guess_run(little_room)
    with Recorder(tmp_path / "run.rrd") as recorder:
        recorded = execute(run, [recorder], recorder)
    assert (
        recorded.labels_sha256
        == execute(run).labels_sha256
        == execute(run, probe=MemoryProbe()).labels_sha256
    )


def test_the_file_appears_when_complete(little_room: InMemory, tmp_path: Path) -> None:
    seen: list[list[str]] = []

    class Watching(InMemory):
        def __getitem__(self, position: int) -> Scan:
            seen.append(sorted(p.name for p in tmp_path.iterdir()))
            return super().__getitem__(position)

    record(Watching(little_room.scans), tmp_path / "run.rrd")
    assert seen[-1] == [".run.rrd.part"]
    assert [p.name for p in tmp_path.iterdir()] == ["run.rrd"]


def test_digest_of_the_file(little_room: InMemory, tmp_path: Path) -> None:
    with Recorder(tmp_path / "deep" / "run.rrd", "scores") as recorder:
        execute(guess_run(little_room), [recorder], recorder)
    assert recorder.sha256() == hashlib.sha256((tmp_path / "deep/run.rrd").read_bytes()).hexdigest()


def test_unknown_modes_and_unwritable_paths(little_room: InMemory, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="choose from full, errors, scores"):
        Recorder(tmp_path / "run.rrd", "all")  # type: ignore[arg-type]
    (tmp_path / "file").touch()
    with (
        pytest.raises(DataError, match="cannot be written"),
        Recorder(tmp_path / "file/run.rrd") as recorder,
    ):
        execute(guess_run(little_room), [recorder], recorder)


@pytest.mark.parametrize(
    ("mode", "wanted"), [("errors", [True, False]), ("scores", [False, False])]
)
def test_a_recorder_wants_declared_states(
    little_room: InMemory, tmp_path: Path, mode: Any, wanted: list[bool]
) -> None:
    with Recorder(tmp_path / "run.rrd", mode) as recorder:

        class Asking(Listener):
            def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
                assert [recorder.wants(name) for name in ("cells", "unheard")] == wanted

        execute(guess_run(little_room), [recorder, Asking()], recorder)


def test_hovering_over_a_point_or_a_ray_lists_its_class(
    little_room: InMemory, tmp_path: Path
) -> None:
    """The viewer lists up to three components of what the mouse is on, and else their number."""
    path = record_with_metrics(little_room, tmp_path / "run.rrd")
    names: defaultdict[str, set[str]] = defaultdict(set)
    for chunk in RrdReader(path).stream().to_chunks():
        columns = [f for f in chunk.to_record_batch().schema if f.name not in chunk.timeline_names]
        names[str(chunk.entity_path)] |= {f.name for f in columns if "rerun" not in f.name}
    for entity in (paths.SCAN, paths.MAP, "world/guess/kinds", paths.CASE_RAYS):
        own = names[f"/{entity}"] - {"AnnotationContext:context"}
        assert any("class_ids" in name for name in own), entity
        assert len(own) <= 3, own
