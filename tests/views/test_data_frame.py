"""A recording as a data frame: cases as rows, answers as columns, read without dynaviz."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.guessing_method import record_with_metrics
from helpers.worlds import room

from dynaviz.contracts.scan import Outcome
from dynaviz.scores.failure_case import FailureCase
from dynaviz.views import object_lanes, paths
from dynaviz.views.cases import listed
from dynaviz.views.read.reader import RunRecording

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> RunRecording:
    return RunRecording(record_with_metrics(room(), tmp_path_factory.mktemp("cases") / "run.rrd"))


def failures(recording: RunRecording) -> list[FailureCase]:
    assert recording.result is not None
    return listed(recording.result)


def test_a_case_is_a_row(recorded: RunRecording) -> None:
    rows = dict(recorded.rows(paths.CASES_TABLE, paths.CASE))
    assert list(rows) == list(range(1, len(failures(recorded)) + 1))
    for case, row in zip(failures(recorded), rows.values(), strict=True):
        cells = {name: values[0] for name, values in row.items() if len(values) == 1}
        for name in ("kind", "cost", "points", "what", "worst_frame", "cause", "behaviour"):
            assert cells[name] == getattr(case, name)
        assert cells["range"] == case.range.mean
        assert case.looks is not None
        assert cells["looks_through"] == case.looks.through
        instance = cells["instance"]
        assert case.instance == (None if instance is None or np.isnan(instance) else instance)
        assert (row["low"] <= row["high"]).all()
    boxes = dict(recorded.rows(paths.CASE_BOX, paths.CASE))
    for number, row in rows.items():
        middle = (row["low"] + row["high"]) / 2
        np.testing.assert_allclose(middle, boxes[number]["Boxes3D:centers"][0], atol=1e-5)


def test_answers_are_columns(recorded: RunRecording) -> None:
    columns = dict(recorded.rows(paths.ANSWERS, paths.FRAME))
    for answers in recorded.answers():
        row = columns[answers.frame]
        np.testing.assert_array_equal(row["dynaviz.Answers:removed"] != 0, answers.dynamic)
        np.testing.assert_array_equal(row["dynaviz.Answers:truth"], answers.truth)
        np.testing.assert_array_equal(row["dynaviz.Answers:reason"], answers.reasons)


def test_objects_have_their_names_in_paths(recorded: RunRecording) -> None:
    named = {path.split("/")[1] for path in recorded.entities() if path.startswith("objects/")}
    assert any(name.startswith("moving_object_1") for name in named)
    assert object_lanes.names(["van 9", "ground", "car (parked)", "ground"]) == [
        "van_9",
        "ground_1",
        "car_parked",
        "ground_2",
    ]


def test_the_example_asks_without_dynaviz(
    recorded: RunRecording, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("datafusion", reason="needs rerun-sdk[catalog]")
    source = (EXAMPLES / "ask_recordings.py").read_text()
    assert "import dynaviz" not in source
    assert "from dynaviz" not in source
    monkeypatch.syspath_prepend(str(EXAMPLES))
    sys.modules.pop("ask_recordings", None)
    import ask_recordings

    ask_recordings.main([str(recorded.path)])
    printed = capsys.readouterr().out
    kept = sum((a.outcome == Outcome.FALSE_NEGATIVE).sum() for a in recorded.answers())
    by_reason = printed.split("Kept dynamic points by reason:")[1].split("Name:")[0].split("\n")
    counts = [int(line.split()[1]) for line in by_reason if len(line.split()) == 2]
    assert sum(counts) == kept > 0
    for case in failures(recorded):
        if case.kind == "false_negative":
            assert str(case.cause) in printed
