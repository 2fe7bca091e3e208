"""Intervals over drawn movers, counted again one draw at a time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.made_results import result

from dynaviz.contracts import registry
from dynaviz.reports.reporting import report
from dynaviz.scores.movers import DRAWS, aa_interval, change_intervals, movers_of
from dynaviz.scores.result import Result

POINTS = (500, 40, 60, 300, 100)
FIRST = (480, 10, 60, 100, 50)
SECOND = (490, 30, 50, 290, 90)


def run(
    removed: tuple[int, ...], method: str = "erasor", sequence: str = "hall", first: int = 1
) -> Result:
    """A result with these movers, of which the first has a number."""
    rows: list[dict[str, Any]] = [
        {"class": 13, "instance": first + k, "dynamic_removed": gone, "dynamic_kept": whole - gone}
        for k, (gone, whole) in enumerate(zip(removed, POINTS, strict=False))
    ]
    rows.append({"class": 7, "instance": 90, "static_kept": 5})  # a parked car
    points = sum(POINTS[: len(removed)])
    counts = (900, 100, sum(removed), points - sum(removed))
    return result(method, sequence, counts, sections={"breakdown": {"object": rows}})


def again(removed: tuple[int, ...], points: tuple[int, ...]) -> list[float]:
    """AA of drawn movers, with another generator."""
    rng = np.random.default_rng(7)
    found = []
    for _ in range(DRAWS):
        chosen = rng.integers(len(points), size=len(points)).tolist()
        share = sum(removed[k] for k in chosen) / sum(points[k] for k in chosen)
        found.append(100 * (0.9 * share) ** 0.5)
    return found


def test_the_interval_is_that_of_movers_drawn_one_by_one() -> None:
    low, high = aa_interval([run(FIRST)]) or (0, 0)
    expected = np.quantile(again(FIRST, POINTS), [0.025, 0.975])
    assert [low, high] == pytest.approx(expected.tolist(), abs=2)
    assert low < run(FIRST).metrics["AA"] < high


def test_movers_of_several_sequences_are_drawn_together() -> None:
    together = aa_interval([run(FIRST), run(SECOND, sequence="street")]) or (0, 0)
    expected = np.quantile(again(FIRST + SECOND, POINTS * 2), [0.025, 0.975])
    assert list(together) == pytest.approx(expected.tolist(), abs=2)


def test_parked_objects_are_no_movers() -> None:
    assert list(movers_of(run(FIRST)).values()) == list(zip(FIRST, POINTS, strict=True))


@pytest.mark.parametrize("few", [run(FIRST[:2]), run(FIRST, first=0), result("erasor")])
def test_few_or_unknown_movers_give_no_interval(few: Result) -> None:
    """Fewer than three, one without a number, and a result without objects."""
    assert aa_interval([few]) is None
    assert change_intervals(few, few) == {}


def test_both_runs_of_a_comparison_have_the_same_movers() -> None:
    assert change_intervals(run(FIRST), run(FIRST)) == {"DA": (0, 0), "AA": (0, 0)}
    there = change_intervals(run(FIRST), run(SECOND))
    back = change_intervals(run(SECOND), run(FIRST))
    for name in ("DA", "AA"):
        assert there[name] == pytest.approx([-end for end in reversed(back[name])])
    low, high = there["AA"]
    assert low < run(SECOND).metrics["AA"] - run(FIRST).metrics["AA"] < high
    # Smaller than that of independent draws, since a large mover is large for both.
    low_a, high_a = aa_interval([run(FIRST)]) or (0, 0)
    low_b, high_b = aa_interval([run(SECOND)]) or (0, 0)
    assert high - low < (high_a - low_a) + (high_b - low_b)


@pytest.mark.parametrize("format_", ["html", "md", "latex"])
def test_reports_show_intervals(tmp_path: Path, format_: str) -> None:
    for number, each in enumerate((run(FIRST), run(SECOND, "dufomap"))):
        each.save(tmp_path / str(number) / "result.json")
    assert format_ in {handle.name for handle in registry.handles("reports")}
    text = report(tmp_path, format=format_)
    low, high = aa_interval([run(SECOND)]) or (0, 0)
    assert text.count(f"{low:.0f} to {high:.0f}") >= 2  # at a glance, and accuracy
    assert "drawn again with replacement" in text
