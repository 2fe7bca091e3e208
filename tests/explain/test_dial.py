"""The dial: drawn points judged again have the labels of real runs, and estimates are unbiased."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.worlds import room

import dynaviz as dv
from dynaviz.arrays import Bool
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Scan
from dynaviz.explain import sample
from dynaviz.explain.dial import Dial, PointSample, pack, unpack
from dynaviz.explain.judging import front, of_ledgers
from dynaviz.explain.sample import Draw, Drawn
from dynaviz.explain.words import number
from dynaviz.scores.result import Result
from dynaviz.views import paths
from dynaviz.views.read.reader import RunRecording
from dynaviz.views.record import turns

TURNS: list[tuple[str, dict[str, Any], dict[str, float]]] = [
    ("octomap", {}, {"prob_miss": 0.3}),
    ("octomap", {}, {"prob_hit": 0.55, "clamp_min": 0.4}),
    ("octomap_g", {}, {"prob_miss": 0.45, "clamp_max": 0.6}),
    ("octomap_gf", {"noise_neighbours": 5}, {"prob_miss": 0.2}),
    ("removert", {}, {"threshold": 0.02}),
    ("removert", {}, {"threshold": 0.12}),
    ("dynablox", {"clusters": True}, {"min_cluster": 3}),
]


def scans(frames: int = 8, **changes: Any) -> Any:
    found = room(frames, 1500, **changes)
    return replace(found, sensor=replace(found.sensor, rings=24, elevation=(-60.0, 60.0)))


def of_run(run: Result, drawn: Drawn) -> Bool:
    """The labels of drawn points in a run."""
    places = zip(drawn.frame.tolist(), drawn.row.tolist(), strict=True)
    return np.array([run.labels[frame][row] for frame, row in places])


@pytest.mark.parametrize(("method", "settings", "values"), TURNS)
def test_points_judged_again_have_the_labels_of_a_run_with_these_values(
    tmp_path: Path, method: str, settings: dict[str, Any], values: dict[str, float]
) -> None:
    run = dv.run(method, scans(), settings=settings, out=tmp_path)
    recording = RunRecording(tmp_path / "run.rrd")
    found = recording.sample
    assert found is not None
    assert found.judged.removed.tolist() == of_run(run, found.drawn).tolist()
    again = found.judged.replay(found.given, found.given)
    assert again.tolist() == found.judged.removed.tolist()
    other = dv.run(method, scans(), settings={**settings, **values})
    judged = found.judged.judge(values, found.given)
    assert judged.tolist() == of_run(other, found.drawn).tolist()
    for name, score in found.scores(values).items():
        # if all points of a truth are drawn, the score is exact
        assert abs(score.value - other.metrics[name]) <= 2 * score.whisker + 1e-9
    for k, case in enumerate(run.failures[:20], 1):
        ledgers = recording.ledgers(k)
        if ledgers:
            mine = of_ledgers(ledgers, found.given).judge(values, found.given)
            places = [(each.frame, each.point) for each in ledgers]
            assert mine.tolist() == [other.labels[frame][row] for frame, row in places], case


def test_the_scores_of_the_run_itself_have_no_whiskers(tmp_path: Path) -> None:
    run = dv.run("octomap", scans(), out=tmp_path)
    recording = RunRecording(tmp_path / "run.rrd")
    found = recording.sample
    assert found is not None
    for name, score in found.scores({}).items():
        assert score.whisker == 0
        assert score.value == pytest.approx(run.metrics[name])
    dial = Dial(found, run.failures, [recording.ledgers(1)])
    assert dial.turn({}).text.startswith("As it ran: SA ")
    (case,) = dial.turn({}).cases
    assert case.cost == pytest.approx(run.failures[0].cost)
    assert dial.turn({"prob_miss": 0.4}).values == {}


@pytest.mark.parametrize("method", ["octomap", "removert"])
def test_sliders_offer_values_that_the_method_takes_and_that_keep_their_meaning(
    tmp_path: Path, method: str
) -> None:
    dv.run(method, scans(), out=tmp_path)
    found = RunRecording(tmp_path / "run.rrd").sample
    assert found is not None
    for each in found.parameters:
        assert each.low <= each.value <= each.high
        if each.name.startswith(("prob", "clamp")):
            assert (each.low > 0.5) == (each.high > 0.5) == (each.value > 0.5)
        for value in each.values(5):
            dv.run(method, scans(frames=1), settings={each.name: value})


@pytest.mark.parametrize("method", ["erasor", "seethrough", "dufomap"])
def test_no_slider_for_a_parameter_that_changes_more_than_a_threshold(
    tmp_path: Path, method: str
) -> None:
    dv.run(method, scans(), out=tmp_path)
    assert RunRecording(tmp_path / "run.rrd").sample is None


def test_without_ground_truth_no_points_are_drawn(tmp_path: Path) -> None:
    dv.run("octomap", scans(labelled=False), out=tmp_path)
    assert RunRecording(tmp_path / "run.rrd").sample is None


def test_a_sample_is_the_same_after_packing(tmp_path: Path) -> None:
    dv.run("removert", scans(), out=tmp_path)
    found = RunRecording(tmp_path / "run.rrd").sample
    assert found is not None
    again = unpack(np.frombuffer(pack(found), np.uint8))
    assert again.parameters == found.parameters
    values = {"threshold": 0.1}
    assert again.scores(values) == found.scores(values)


class Known:
    """Points whose labels with another value are known."""

    def __init__(self, removed: Bool, judged: Bool) -> None:
        self.removed = removed
        self._judged = judged

    def judge(self, *_: Any) -> Bool:
        return self._judged


@pytest.mark.parametrize("most_frames", [6, 64])
def test_estimates_are_unbiased_and_whiskers_contain_the_score(
    monkeypatch: pytest.MonkeyPatch, most_frames: int
) -> None:
    """Of 60 samples of the same points, each score is within the whiskers of most."""
    monkeypatch.setattr(sample, "POINTS", 200)
    monkeypatch.setattr(sample, "FRAMES", most_frames)
    random = np.random.default_rng(1)
    labelled = []
    other = []
    for frame in range(24):
        n = 800
        dynamic_truth = random.random(n) < 0.2
        removed = random.random(n) < np.where(dynamic_truth, 0.8, 0.1)
        reasons = random.integers(0, 3, n).astype(np.uint8)
        turned = np.where(random.random(n) < 0.1 * (reasons + 1), ~removed, removed)
        scan = Scan(frame, np.zeros((n, 3), np.float32), np.eye(4),
                    labels=dynamic_truth.astype(np.uint8))  # fmt: skip
        labelled.append(Labelled.of(frame, scan, removed, reasons))
        other.append(turned)
    truth = np.concatenate([each.scan.labels for each in labelled]) == 1
    joined = np.concatenate(other)
    scores = {"SA": 100 * (~joined[~truth]).mean(), "DA": 100 * joined[truth].mean()}
    original = sample._order
    errors: dict[str, list[float]] = {"SA": [], "DA": []}
    for seed in range(60):
        monkeypatch.setattr(sample, "_order", lambda f, n, s=seed: original(f + 100 * s + 1, n))
        draw = Draw(len(labelled))
        for each in labelled:
            draw.add(each)
        drawn = draw.drawn()
        assert drawn is not None
        places = list(zip(drawn.frame.tolist(), drawn.row.tolist(), strict=True))
        judged: Any = Known(
            np.array([labelled[frame].dynamic[row] for frame, row in places]),
            np.array([other[frame][row] for frame, row in places]),
        )
        for name, score in PointSample(drawn, judged, (), {}).scores({"p": 1}).items():
            errors[name].append((score.value - scores[name]) / score.whisker)
    for found in errors.values():
        assert np.mean(np.abs(found) <= 1) >= 0.85
        assert abs(np.mean(found)) < 0.2


def test_the_front_keeps_what_decides() -> None:
    """With any thresholds, the candidates that are kept decide as all do."""
    random = np.random.default_rng(0)
    tests = ["<", ">="]
    for _ in range(50):
        numbers = random.integers(0, 6, (12, 2)).astype(float)
        kept = front(numbers, tests)
        assert kept.any()
        for low in range(7):
            for high in range(7):
                holds = (numbers[:, 0] < low) & (numbers[:, 1] >= high)
                assert holds.any() == holds[kept].any()


def test_the_table_of_other_parameters_states_the_estimates(tmp_path: Path) -> None:
    run = dv.run("octomap", scans(), out=tmp_path)
    recording = RunRecording(tmp_path / "run.rrd")
    found = recording.sample
    assert found is not None
    text = recording.static(paths.WHAT_IF)["TextDocument:text"][0]
    for each in found.parameters:
        for value in each.values(turns.VALUES):
            scores = found.scores({each.name: value})
            mark = "**" if value == each.value else ""
            cells = (f"{mark}{each.name}{mark}", f"{mark}{number(value)}{mark}")
            assert f"| {cells[0]} | {cells[1]} | {mark}{scores['SA'].value:.1f}" in text
    assert f"**{run.metrics['SA']:.1f}** | **{run.metrics['DA']:.1f}**" in text
