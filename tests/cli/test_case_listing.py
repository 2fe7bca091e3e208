"""Lists of cases in the terminal."""

from __future__ import annotations

import io

import msgspec
import pytest
from rich.console import Console

from dynaviz.cli.cases import _cases, _clusters, listing, top_of
from dynaviz.scores.failure_case import FailureCase, RangeSpan
from dynaviz.scores.result import Result, result_table
from dynaviz.scores.sections import Failures, Removals, RemovedCluster, Sections, SequenceInfo

WHERE = {
    "points": 1234,
    "first_frame": 3,
    "last_frame": 40,
    "worst_frame": 7,
    "frames": 30,
    "low": (1.0, 2.0, 3.0),
    "high": (4.0, 5.0, 6.0),
    "range": RangeSpan(1.0, 2.0, 3.0),
    "moved": 0.0,
    "reasons": {"crossed_by_rays": 3, "never_crossed": 1},
}
CASE = FailureCase(
    kind="false_negative", cost=12.5, sentence="Kept: a car that stood there. " * 6, **WHERE
)
CLUSTER = RemovedCluster(suspicion=0.75, sentence="Removed: ground. " * 9, **WHERE)
REMOVALS = Removals(4000, 1000, {"crossed_by_rays": 900, "too_high": 100}, clusters=(CLUSTER,) * 5)


def rendered(*items, width: int = 80) -> list[str]:
    console = Console(file=io.StringIO(), record=True, width=width)
    for item in items:
        console.print(item)
    return [line.rstrip() for line in console.export_text().splitlines()]


@pytest.mark.parametrize("case", [CASE, CLUSTER])
@pytest.mark.parametrize("width", [60, 80, 200])
def test_a_long_sentence_has_a_hanging_indent(case, width):
    lines = rendered(listing([case] * 11), width=width)
    begin = lines[0].index(case.sentence[:7])
    numbered = [line for line in lines if line[:2].strip()]
    assert [int(line[:2]) for line in numbered] == list(range(1, 12))
    assert len(lines) > len(numbered)
    assert all(line.startswith(" " * begin) for line in lines if line not in numbered)
    assert max(map(len, lines)) <= width


def test_the_costliest_or_most_suspicious_are_listed_after_a_run():
    plain = {"metrics": {"SA": 90.0}, "failures": {"cases": []}}
    scored = Result("m", {}, SequenceInfo("street"), Sections.of(plain))
    assert top_of(scored, "show") == ()
    bare = Result("m", {}, SequenceInfo("street"), Sections(removals=REMOVALS))
    lines = rendered(*top_of(bare, "show"))
    assert lines[0] == "Removed points that look most suspicious (show lists all):"
    assert [line[:7] for line in lines if line[:1].strip()][1:] == ["1  0.75", "2  0.75", "3  0.75"]


def test_the_table_of_runs_without_ground_truth_shows_what_was_removed():
    bare = Result("octomap", {}, SequenceInfo("street"), Sections(removals=REMOVALS))
    earlier = Result("octomap", {}, SequenceInfo("street"))
    text = "\n".join(rendered(result_table([bare, earlier])))
    assert "SA" not in text
    for part in (
        "1,000",
        "25.00",
        "crossed_by_rays 90\N{NO-BREAK SPACE}%",
        "too_high 10",
        "no ground truth",
    ):
        assert part in text
    assert text.count("n/a") == 5  # nothing is known about the second, and no runtime of either


def test_runs_without_cases_say_why_there_are_none():
    assert rendered(*_cases(Failures(), 20)) == ["No failure cases: no labelled point is wrong."]
    assert rendered(*_clusters(Removals(4000, 0), 20))[-1] == "No point was removed."
    removed = msgspec.structs.replace(REMOVALS, clusters=())
    assert (
        "contains no clusters of removed points" in rendered(*_clusters(removed, 20), width=120)[-1]
    )
    assert rendered(*_clusters(REMOVALS, 3))[-1] == "2 more clusters."
