"""Layouts of runs and of comparisons, as the viewer shows them."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.guessing_method import Guess, record
from helpers.viewer_client import headless, problems
from helpers.worlds import room

from dynaviz.views.layout import SCORE_CURVES, WRONG


def test_a_run_is_shown_without_problems(tmp_path: Path) -> None:
    recording = record(room(3, 2000), tmp_path / "run.rrd")
    with headless((1200, 800)) as client:
        shown = problems(recording, client)
    assert {"map", "frame", SCORE_CURVES, WRONG, "report"} <= set(shown)
    assert set(shown) >= {state.name for state in Guess.info.emits if state.name != "remark"}
    assert {name: reports for name, reports in shown.items() if reports} == {}


@pytest.mark.parametrize(
    ("name", "views"),
    [
        (
            "two",
            {"A octomap resolution=0.15", "B octomap resolution=0.6", "whole run: green A better, purple B better",
             "right in this frame: green A, purple B, white neither", "report", "SA [%]: A green, B purple"},
        ),
        ("many", {"A octomap resolution=0.15: whole run", "SA [%]: A green, B purple, C teal", "report"}),
        ("scores", {"report", "FN: distance [m]", "FP: distance [m]"}),
    ],
)  # fmt: skip
def test_a_comparison_is_shown_without_problems(merged: dict[str, Path], name: str, views: set[str]) -> None:
    with headless((1600, 900)) as client:
        shown = problems(merged[name], client)
    assert {n: reports for n, reports in shown.items() if reports} == {}
    assert views <= set(shown)
    assert len([n for n in shown if n and n.endswith("whole run")]) == (3 if name == "many" else 0)
