"""Failure cases in a recording, as drawn and listed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.guessing_method import Guess, GuessParams, guess_run
from helpers.worlds import InMemory

from dynaviz.contracts import registry
from dynaviz.contracts.scan import Outcome
from dynaviz.engine.loop import Listener, RunSpec, execute
from dynaviz.views import paths
from dynaviz.views.cases import listed
from dynaviz.views.read.reader import RunRecording
from dynaviz.views.record.recorder import Recorder


def record(sequence: InMemory, path: Path, mode: str = "errors", *listeners: Listener) -> Path:
    """Record the test's method with the real metrics."""
    params = GuessParams()
    metrics = tuple(
        registry.load("metrics", name)(Guess.info) for name in ("confusion", "failures")
    )
    with Recorder(path, mode) as recorder:
        execute(RunSpec(Guess(params), sequence, params, metrics), [recorder, *listeners], recorder)
    return path


def test_the_failures_of_an_unfinished_run_are_unknown(little_room, tmp_path, run_command):
    class Stopped(Recorder):
        def finish(self, *_) -> None:
            raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"), Stopped(tmp_path / "cut.rrd") as recorder:
        execute(guess_run(little_room), [recorder], recorder)
    (tmp_path / ".cut.rrd.part").rename(tmp_path / "cut.rrd")
    code, _, problem = run_command("info", tmp_path / "cut.rrd", "--failures")
    assert (code, "did not finish" in problem) == (2, True)


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
        whole["Boxes3D:centers"] + whole["Boxes3D:half_sizes"],
        [case.high for case in cases],
        atol=0.02,
    )


def test_the_list_names_the_frame_to_go_to(little_room, tmp_path):
    recording = RunRecording(record(little_room, tmp_path / "run.rrd"))
    text = str(recording.static(paths.FAILURE_LIST)["TextDocument:text"][0])
    first = recording.result.failures[0]
    assert f"| {first.worst_frame} |" in text
    assert f"{first.cost:.2f}" in text
    assert first.sentence in str(recording.static(paths.REPORT)["TextDocument:text"][0])
