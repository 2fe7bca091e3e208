"""Moving objects of which two runs removed different shares."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynaviz.scores.comparison.objects import LEAST, object_changes
from dynaviz.scores.result import Result

Removed = list[tuple[int, int]]  # of each object: its points, and how many a run removed


def result(objects: Removed, cases: tuple[dict[str, Any], ...] = ()) -> Result:
    """A run in which the objects are numbered from 1, all of class 3."""
    rows = [
        {
            "class": 3, "instance": number, "first_frame": 2, "last_frame": 9, "points": points,
            "dynamic_removed": removed, "dynamic_kept": points - removed,
        }
        for number, (points, removed) in enumerate(objects, 1)
    ]  # fmt: skip
    counts = {
        "dynamic_removed": sum(removed for _, removed in objects),
        "dynamic_kept": sum(points - removed for points, removed in objects),
    }
    listed = [
        {
            "kind": "false_negative", "points": 1, "cost": 1.0, "first_frame": 2, "last_frame": 9,
            "worst_frame": 4, "frames": 8, "low": [0, 0, 0], "high": [1, 1, 1],
            "range": {"min": 1, "mean": 2, "max": 3}, "moved": 1.0, "reasons": {}, "class": 3,
            **case,
        }
        for case in cases
    ]  # fmt: skip
    given = {
        "method": "m",
        "parameters": {},
        "sequence": {"name": "00"},
        "counts": counts,
        "breakdown": {"object": rows},
        "failures": {"cases": listed},
    }
    return Result.from_dict(given, "result.json")


@st.composite
def two(draw: st.DrawFn) -> tuple[Removed, Removed]:
    points = draw(st.lists(st.integers(1, 200), min_size=1, max_size=6))
    first, second = ([(n, draw(st.integers(0, n))) for n in points] for _ in range(2))
    return first, second


@given(two())
def test_the_gains_of_objects_add_up_to_the_change_of_DA(runs: tuple[Removed, Removed]) -> None:
    first, second = runs
    total = sum(points for points, _ in first)
    DA = [100 * sum(removed for _, removed in run) / total for run in runs]
    changes = object_changes(result(first), result(second))
    assert sum(each.gain_DA for each in changes) == pytest.approx(DA[1] - DA[0])
    back = object_changes(result(second), result(first))
    assert {each.what: each.gain_DA for each in back} == {
        each.what: -each.gain_DA for each in changes
    }
    gains = [abs(each.gain_DA) for each in changes]
    assert gains == sorted(gains, reverse=True)
    assert all(gain >= LEAST for gain in gains)


def test_an_object_has_the_name_the_case_and_the_cause_of_each_run() -> None:
    case = {"instance": 2, "what": "truck", "cause": "stood there", "behaviour": "waited first"}
    other = {"instance": 1, "what": "car"}
    first = result([(50, 50), (50, 10)], (other, case))
    second = result([(50, 50), (50, 40)])
    (change,) = object_changes(first, second)
    assert change.what == "truck 2"
    assert (change.first.removed, change.second.removed) == (20, 80)
    assert (change.first_frame, change.last_frame, change.points) == (2, 9, 50)
    assert change.gain_DA == 30
    assert (change.first.case, change.first.cause) == (2, "stood there")
    assert change.first.behaviour == "waited first"
    assert change.second.case is None


def test_objects_of_other_points_or_without_a_number_are_left_out() -> None:
    assert object_changes(result([(50, 10)]), result([(60, 10)])) == ()
    assert object_changes(result([(50, 10)]), result([])) == ()
