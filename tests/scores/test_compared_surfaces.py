"""Static surfaces from which two runs removed different numbers of points."""

from __future__ import annotations

from typing import Any

import pytest
from helpers.compared_results import removed_cases
from hypothesis import given
from hypothesis import strategies as st

from dynaviz.scores.comparison.surfaces import surface_changes

Case = dict[str, Any]


def wall(x: float, cost: float, **fields: Any) -> Case:
    """A removed part of a wall that is 4 m long, at a place along x."""
    return {"cost": cost, "low": [x, 0, 0], "high": [x + 4, 0.1, 2], "what": "wall", **fields}


costs = st.lists(
    st.tuples(st.integers(0, 5), st.integers(1, 400), st.sampled_from([None, 3])), max_size=8
)


def cases(drawn: list[tuple[int, int, int | None]]) -> tuple[Case, ...]:
    return tuple(wall(10.0 * at, cost / 100, **{"class": of}) for at, cost, of in drawn)


@given(costs, costs)
def test_the_gains_of_surfaces_add_up_to_that_of_the_listed_cases(
    one: list[tuple[int, int, int | None]], two: list[tuple[int, int, int | None]]
) -> None:
    first = removed_cases(cases(one))
    second = removed_cases(cases(two))
    changes = surface_changes(first, second)
    total = sum(cost for _, cost, _ in one) - sum(cost for _, cost, _ in two)
    assert sum(each.gain_SA for each in changes) == pytest.approx(total / 100)
    back = surface_changes(second, first)
    assert sorted(each.gain_SA for each in changes) == pytest.approx(
        sorted(-each.gain_SA for each in back)
    )
    assert len(changes) <= len({(at, of) for at, _, of in (*one, *two)})
    sizes = [abs(each.gain_SA) for each in changes]
    assert sizes == sorted(sizes, reverse=True)


def test_a_surface_has_the_case_and_the_cause_of_each_run() -> None:
    first = removed_cases(
        (wall(50, 3.0, cause="thin or rough"), wall(0, 2.0, cause="grazing rays"), wall(1, 0.5))
    )
    second = removed_cases((wall(50.5, 3.0), wall(0.5, 1.0, cause="poses disagree")))
    (change,) = surface_changes(first, second)  # the other is alike
    assert change.what == "wall"
    assert change.gain_SA == pytest.approx(1.5)
    assert change.low == (0, 0, 0)
    assert (change.first.lost, change.first.case) == (pytest.approx(2.5), 2)
    assert change.first.cause == "grazing rays"
    assert (change.second.lost, change.second.case) == (1.0, 2)
    assert change.second.cause == "poses disagree"


def test_a_run_without_a_listed_case_there_lost_nothing_there() -> None:
    (change,) = surface_changes(removed_cases(()), removed_cases((wall(0, 1.0),)))
    assert change.gain_SA == -1.0
    assert (change.first.lost, change.first.case) == (0.0, None)
    assert change.second.case == 1
