"""A recording knows the case of a point where boxes of cases overlap."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.case_members import members
from helpers.recount import scans_of

import dynaviz as dv
from dynaviz.contracts.scan import ERRORS
from dynaviz.runs.run import Run, open_run
from dynaviz.runs.stored_evidence import Stored, kind_of
from dynaviz.scores.case_points import CasePoints
from dynaviz.views import stored_points

SEQUENCE = "simulate:street_vlp16?frames=10"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("stored")
    dv.run("octomap", SEQUENCE, out=folder, maps=False)
    return open_run(folder)


@pytest.fixture(scope="module")
def truth(run: Run) -> dict[tuple[int, int], int]:
    return members(run, scans_of(SEQUENCE))


def test_the_points_of_cases_are_told_apart(run: Run, truth: dict[tuple[int, int], int]) -> None:
    by_box = CasePoints(run.result.failures)
    total = right = right_by_box = 0
    for drawn in run.recording.drawn():
        numbers = np.array([truth.get((drawn.frame, row), 0) for row in drawn.point.tolist()])
        for kind, outcome in ERRORS.items():
            rows = np.flatnonzero((numbers > 0) & (drawn.outcome == outcome))
            frames = np.full(len(rows), drawn.frame)
            own = numbers[rows]
            total += len(rows)
            asked = kind, frames, drawn.xyz[rows]
            right += np.count_nonzero(run.recording.case_points.owners(*asked) == own)
            right_by_box += np.count_nonzero(by_box.owners(*asked) == own)
    assert total > 5000
    assert right >= 0.98 * total
    assert right_by_box < 0.9 * total


def test_stored_evidence_is_of_points_of_its_case(
    run: Run, truth: dict[tuple[int, int], int]
) -> None:
    numbers = [
        (number, truth.get((each.frame, each.point)))
        for number in range(1, len(run.result.failures) + 1)
        for each in run.recording.ledgers(number)
    ]
    assert len(numbers) > 300
    assert sum(number == own for number, own in numbers) >= 0.97 * len(numbers)


def test_a_place_is_answered_for_the_case_of_its_point(
    run: Run, truth: dict[tuple[int, int], int]
) -> None:
    by_box = CasePoints(run.result.failures)
    listed = range(1, len(run.result.failures) + 1)
    stored = [each for number in listed for each in run.recording.ledgers(number)]
    # the box alone would name another case
    asked = [e for e in stored if by_box.owner(kind_of(e), e.frame, e.position) != e.case]
    assert len(asked) > 20
    for each in asked[::10]:
        answer = dv.why(run, near=each.position)
        assert answer.ledger.case == truth[answer.ledger.frame, answer.ledger.point]
        assert answer.cause == run.result.failures[answer.ledger.case - 1].cause
        assert f"(case {answer.ledger.case})" in answer.sentence
        assert "may be of another case" not in answer.note


def test_earlier_recordings_answer_by_boxes_and_say_so(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stored_points, "read", lambda components: None)
    earlier = Stored(open_run(run.path))
    notes = [
        earlier.document(each).note
        for number in range(1, 21)
        for each in run.recording.ledgers(number)
    ]
    said = [note for note in notes if "no recording of this run stores the points" in note]
    assert 0 < len(said) < len(notes)
