"""Layouts of runs and of comparisons, as the viewer shows them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from helpers.guessing_method import Guess, record
from helpers.viewer_client import headless, problems
from helpers.worlds import room
from rerun.experimental import ViewerClient

from dynaviz.views.keys import title
from dynaviz.views.layout import SCORE_CURVES, WRONG
from dynaviz.views.read.shot import push


def test_a_run_is_shown_without_problems(tmp_path: Path) -> None:
    recording = record(room(3, 2000), tmp_path / "run.rrd")
    with headless((1200, 800)) as client:
        shown = problems(recording, client)
    assert {"map", "frame", SCORE_CURVES, WRONG, "report"} <= set(shown)
    assert set(shown) >= {title(state) for state in Guess.info.emits if state.name != "remark"}
    assert {name: reports for name, reports in shown.items() if reports} == {}


def test_the_viewer_keeps_the_eyes_where_the_layout_states_them(runs: dict[str, Path]) -> None:
    with headless((1200, 800)) as client:
        push(runs["errors/coarse"] / "run.rrd", client)
        stated = _eyes(client)
        client.take_screenshot()
        seen = _eyes(client)
    assert {entity for entity, _ in stated.values()} >= {"/world/case/around", "/world/case/aim"}
    for view, (
        _,
        distance,
    ) in stated.items():  # it adapts them to what it has loaded when it draws first
        assert seen[view][1] == pytest.approx(distance, rel=1e-4)
    assert (
        len({(entity, round(distance, 2)) for entity, distance in seen.values()}) == 2
    )  # hidden tabs as well


def _eyes(client: ViewerClient) -> dict[str, tuple[str, float]]:
    """What the eye of each view tracks, and its distance."""
    views = client.get_blueprint().blueprint
    eyes = {
        name: view["EyeControls3D"]
        for name, view in views.items()
        if "tracking_entity" in view.get("EyeControls3D", {})
    }
    return {
        name: (
            str(eye["tracking_entity"]),
            math.dist(np.ravel(eye["position"]), np.ravel(eye["look_target"])),
        )
        for name, eye in eyes.items()
    }


@pytest.mark.parametrize(
    ("name", "views"),
    [
        (
            "two",
            {"A octomap resolution=0.15", "B octomap resolution=0.6", "whole run: green A better, "
            "purple B better",
             "right in this frame: green A, purple B, white "
             "neither", "report", "SA [%]: A green, B purple"},
        ),
        ("many", {"A octomap resolution=0.15: whole "
        "run", "SA [%]: A green, B purple, C teal", "report"}),
        ("scores", {"report", "FN: distance [m]", "FP: distance [m]"}),
    ],
)  # fmt: skip
def test_a_comparison_is_shown_without_problems(
    merged: dict[str, Path], name: str, views: set[str]
) -> None:
    with headless((1600, 900)) as client:
        shown = problems(merged[name], client)
    assert {n: reports for n, reports in shown.items() if reports} == {}
    assert views <= set(shown)
    assert len([n for n in shown if n and n.endswith("whole run")]) == (3 if name == "many" else 0)
