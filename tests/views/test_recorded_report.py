"""The report in a recording."""

from __future__ import annotations

import numpy as np
from helpers.guessing_method import Guess

from dynaviz.contracts.scan import Outcome
from dynaviz.scores.result import Result
from dynaviz.scores.sections import Runtime, Sections, SequenceInfo
from dynaviz.views.record import report


def outcome_counts() -> report.OutcomeCounts:
    counted = report.OutcomeCounts()
    for frame, wrong in enumerate([0, 3, 9, 1, 9, 2, 5]):
        outcome = np.array([Outcome.FALSE_NEGATIVE] * wrong + [Outcome.STATIC_KEPT] * 4, np.uint8)
        assert counted.add(frame, 100 + frame, outcome, np.ones(len(outcome), np.uint8)) == (
            wrong,
            0,
        )
    return counted


def test_the_worst_frames_come_first() -> None:
    assert [(frame, index) for frame, index, *_ in outcome_counts().worst()] == [
        (2, 102),
        (4, 104),
        (6, 106),
        (1, 101),
        (5, 105),
    ]
    assert report.OutcomeCounts().worst() == []


def test_the_report_of_a_run() -> None:
    result = Result(
        method="guess",
        parameters={"height": 1.0, "note": "a|b"},
        sequence=SequenceInfo("room", "f" * 64, 7, 57),
        sections=Sections(metrics={"SA": 99.5, "DA": None}, counts={"static_kept": 1234}),
        runtime=Runtime(mean_s=0.5, std_s=0.25, threads=2),
    )
    text = report.report(Guess.info, result, outcome_counts(), "errors")
    for line in (
        "### Guess on room",
        "| 99.50 % | n/a |",
        "| static kept | 1,234 |",
        "| 2 | 102 | 9 | 0 |",
        "| 1 | band | 28 | 29 | lies in the band |",
        "| orange | false negative: dynamic, but kept |",
        '| note | "a\\|b" |',
        "| seconds per frame | 0.500 ± 0.250 |",
        "| ground | points of the floor |",
    ):
        assert line in text.splitlines(), line
    assert "How to read" in report.report(Guess.info, result, outcome_counts(), "scores")
    assert "did not finish" in report.before(Guess.info, "room", {}, "full")
