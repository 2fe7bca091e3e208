"""Verdicts, checks and tables of a comparison."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from helpers.two_runs import compared, two_runs

from dynaviz.errors import UsageError
from dynaviz.scores.comparison.counts import ByScore
from dynaviz.scores.comparison.pair import ComparedRun, ScoreChange
from dynaviz.scores.comparison.summary import Comparison
from dynaviz.scores.looks import Ceiling, Estimate
from dynaviz.scores.sections import Runtime, SequenceInfo

UNDEFINED = ScoreChange(None, None, None, None)
SAME = ScoreChange(50.0, 50.0, 0.0, (0.0, 0.0))


def comparison(**changes: ScoreChange) -> Comparison:
    """A comparison of two runs with chosen scores."""
    scores = ByScore(
        **{name: changes.get(name, SAME) for name in ("SA", "DA", "AA", "HA", "FP", "FN")}
    )
    pair = replace(compared(*two_runs(0, 3, 20)), scores=scores)
    values = ByScore(*(score.second for _, score in scores.items()))
    runs = [
        ComparedRun(
            letter,
            name,
            "",
            "",
            name,
            name,
            "errors",
            "mask",
            False,
            0,
            {},
            values,
            Runtime(),
            False,
            "",
        )
        for letter, name in (("A", "octomap"), ("B", "dufomap[fine]"))
    ]
    return Comparison(SequenceInfo("street", "", 3, 60), tuple(runs), (pair,))


@pytest.mark.parametrize(
    ("scores", "verdict"),
    [
        (
            {
                "AA": ScoreChange(70.3, 81.8, 11.5, (9.0, 13.0)),
                "SA": ScoreChange(90.0, 92.0, 2.0, (1.0, 3.0)),
            },
            "B dufomap[fine] is better than A octomap: AA 81.80 against 70.30. "
            "B dufomap[fine] keeps more static points (SA +2.00).",
        ),
        (
            {
                "AA": ScoreChange(81.8, 70.3, -11.5, (-13.0, -9.0)),
                "DA": ScoreChange(90.0, 88.5, -1.5, (-3.0, -1.0)),
            },
            "A octomap is better than B dufomap[fine]: AA 81.80 against 70.30. "
            "A octomap removes more dynamic points (DA +1.50).",
        ),
        (
            {"AA": ScoreChange(70.3, 70.8, 0.5, (-1.0, 2.0))},
            "No clear winner: B dufomap[fine] has AA 70.80 against 70.30, but the 95 % interval "
            "includes zero.",
        ),
        (
            {"AA": ScoreChange(70.3, 70.8, 0.5, None)},
            "No clear winner: B dufomap[fine] has AA 70.80 against 70.30, but there is no 95 % "
            "interval.",
        ),
        (
            {
                "AA": ScoreChange(70.3, 71.8, 1.5, (0.5, 2.0)),
                "DA": ScoreChange(90.0, 92.9, 2.9, (-0.1, 6.0)),
            },
            "B dufomap[fine] is better than A octomap: AA 71.80 against 70.30.",
        ),
        (
            {
                "AA": ScoreChange(70.3, 71.8, 1.5, (0.5, 2.0)),
                "SA": ScoreChange(90.0, 92.9, 2.9, None),
            },
            "B dufomap[fine] is better than A octomap: AA 71.80 against 70.30.",
        ),
        ({}, "A octomap and B dufomap[fine] are even: AA 50.00."),
        ({"AA": UNDEFINED, "DA": UNDEFINED}, "A octomap and B dufomap[fine] are even: SA 50.00."),
        (dict.fromkeys(("AA", "SA", "DA"), UNDEFINED), "No score is defined."),
    ],
)
def test_verdicts(scores: dict[str, ScoreChange], verdict: str) -> None:
    assert comparison(**scores).verdicts() == [verdict]


def test_drops_below_a_limit() -> None:
    worse = comparison(AA=ScoreChange(81.8, 70.3, -11.5, (-13.0, -9.0)))
    assert worse.drops_below(-12) == []
    assert worse.drops_below(-0.5) == [
        "B dufomap[fine]: AA changed from 81.80 to 70.30, by -11.50, which is below -0.5"
    ]
    with pytest.raises(UsageError, match="AA is undefined"):
        comparison(AA=UNDEFINED).drops_below(0.0)


def test_tables_show_brackets_as_they_are() -> None:
    shown = str(comparison())
    assert "B dufomap[fine]" in shown
    assert "x, y [m]" in shown


def test_what_the_drive_showed_stands_next_to_the_scores_if_it_is_known() -> None:
    title = "What the drive showed of moving objects"
    found = comparison()
    assert title not in found.markdown()
    known = Ceiling(
        possible=Estimate(95.8, 0.4), kept_seen=Estimate(12.5), kept_unseen=Estimate(3.25)
    )
    runs = (replace(found.runs[0], ceiling=known), found.runs[1])
    text = replace(found, runs=runs).markdown()
    assert f"### {title}" in text
    assert "| possible DA | 95.8 ±0.4 | n/a |" in text
    assert "| kept, with evidence | 12.5 | n/a |" in text
    json.dumps(replace(found, runs=runs).to_dict(), allow_nan=False)
