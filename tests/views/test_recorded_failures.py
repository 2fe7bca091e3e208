"""Failure cases in a recording: as drawn, and computed from the drawn points if the run ended early."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from helpers.guessing_method import Guess, GuessParams, guess_run, record_with_metrics
from helpers.worlds import InMemory

from dynaviz.contracts import registry
from dynaviz.contracts.scan import Outcome
from dynaviz.engine.loop import Listener, RunSpec, execute
from dynaviz.errors import DataError
from dynaviz.scores.sections import CaseTotals
from dynaviz.views import paths
from dynaviz.views.cases import listed
from dynaviz.views.read.failures import failures_of, removals_of
from dynaviz.views.read.reader import RunRecording
from dynaviz.views.record.recorder import Recorder


def record(sequence: InMemory, path: Path, mode: str = "errors", *listeners: Listener) -> Path:
    """Record the test's method with the real metrics."""
    params = GuessParams()
    metrics = tuple(registry.load("metrics", name)(Guess.info) for name in ("confusion", "failures"))
    with Recorder(path, mode) as recorder:
        execute(RunSpec(Guess(params), sequence, params, metrics), [recorder, *listeners], recorder)
    return path


def cut_short(sequence: InMemory, path: Path, mode: str) -> Path:
    class First(Recorder):
        def finish(self, *_) -> None:
            raise RuntimeError("stopped")

    params = GuessParams()
    metrics = tuple(registry.load("metrics", name)(Guess.info) for name in ("confusion", "failures"))
    with pytest.raises(RuntimeError, match="stopped"), First(path, mode) as recorder:
        execute(RunSpec(Guess(params), sequence, params, metrics), [recorder], recorder)
    (path.parent / f".{path.name}.part").rename(path)
    return path


@pytest.mark.parametrize("mode", ["full", "errors"])
def test_the_cases_of_a_run_that_ended_early_are_computed(little_room, tmp_path, mode):
    whole = failures_of(record(little_room, tmp_path / "whole.rrd", mode))
    computed = failures_of(cut_short(little_room, tmp_path / "cut.rrd", mode))
    assert whole.cases
    assert not RunRecording(tmp_path / "cut.rrd").complete
    points, costs = Counter(), Counter()
    for sign, section in ((1, whole), (-1, computed)):
        for case in section.cases:
            points[case.kind] += sign * case.points
            costs[case.kind] += sign * case.cost
    assert set(points.values()) == {0}
    assert all(cost == pytest.approx(0, abs=1e-9) for cost in costs.values())


def test_what_an_unfinished_run_without_truth_removed_is_counted(little_room, tmp_path, run_command):
    scans = InMemory([replace(scan, labels=None) for scan in little_room.scans])
    whole = removals_of(record_with_metrics(scans, tmp_path / "whole.rrd", "scores"))
    cut = cut_short(scans, tmp_path / "cut.rrd", "scores")
    assert whole.clusters
    assert removals_of(cut) == msgspec.structs.replace(whole, clusters=(), others=CaseTotals())
    code, out, _ = run_command("info", cut, "--failures")
    assert (code, f"{whole.removed:,} of {whole.points:,} points" in out) == (0, True)

    class Stopping(Listener):
        def labelled(self, labelled, curves) -> None:
            raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"), Recorder(tmp_path / "early.rrd", "scores") as recorder:
        execute(guess_run(scans), [Stopping(), recorder], recorder)
    (tmp_path / ".early.rrd.part").rename(tmp_path / "early.rrd")
    with pytest.raises(DataError, match=r"contains no labelled frame.* Run the method again"):
        removals_of(tmp_path / "early.rrd")


def test_boxes_hold_the_wrong_points_of_their_frame(little_room, tmp_path):
    recording = RunRecording(record(little_room, tmp_path / "run.rrd"))
    cases = listed(recording.result)
    boxes, outside = dict(recording.rows(paths.FAILURES)), 0
    assert set(boxes) == set(range(len(little_room)))
    for drawn in recording.drawn():
        chosen = np.isin(drawn.outcome, (Outcome.FALSE_POSITIVE, Outcome.FALSE_NEGATIVE))
        wrong, parts = drawn.xyz[chosen], boxes[drawn.frame]
        if "Boxes3D:half_sizes" not in parts or not len(wrong):
            continue
        half, centre = parts["Boxes3D:half_sizes"], parts["Boxes3D:centers"]
        within = (np.abs(wrong[:, None] - centre[None]) <= half[None] + 1e-4).all(-1).any(1)
        outside += drawn.stands_for[chosen][~within].sum()
    assert outside <= sum(case.points for case in recording.result.failures[len(cases) :])
    whole = recording.static(paths.CASES)
    assert len(whole["Boxes3D:centers"]) == len(cases)
    np.testing.assert_allclose(
        whole["Boxes3D:centers"] + whole["Boxes3D:half_sizes"], [case.high for case in cases], atol=0.02
    )


def test_the_list_names_the_frame_to_go_to(little_room, tmp_path):
    recording = RunRecording(record(little_room, tmp_path / "run.rrd"))
    text = str(recording.static(paths.FAILURE_LIST)["TextDocument:text"][0])
    first = recording.result.failures[0]
    assert f"| {first.worst_frame} |" in text
    assert f"{first.cost:.2f}" in text
    assert first.sentence in str(recording.static(paths.REPORT)["TextDocument:text"][0])


def test_without_points_or_ground_truth_there_is_an_error(little_room, tmp_path):
    with pytest.raises(DataError, match="contains neither failure cases nor points"):
        failures_of(cut_short(little_room, tmp_path / "scores.rrd", "scores"))
    bare = InMemory([scan.without_truth() for scan in little_room.scans])
    with pytest.raises(DataError, match="no ground truth"):
        failures_of(record(bare, tmp_path / "bare.rrd"))
    assert failures_of(record(little_room, tmp_path / "finished.rrd", "scores")).cases
