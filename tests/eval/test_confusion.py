"""Counts and percentages."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from helpers.sections import plain
from hypothesis import given
from hypothesis import strategies as st

from dynaviz.contracts.scan import Outcome, outcomes
from dynaviz.scores.scores import Counts
from dynaviz_eval.confusion import Confusion

pytestmark = pytest.mark.boundscheck

OUTCOMES = st.lists(st.sampled_from(list(Outcome)), max_size=60).map(
    lambda o: np.array(o, np.uint8)
)

# table "Quantitative comparison", KITTI 00, before rounding as the benchmark's scripts print it:
# SA, DA, AA
PAPER = {
    "Removert": (99.4361, 41.5313, 64.2628),
    "ERASOR": (66.7024, 98.5352, 81.0711),
    "OctoMap": (68.0501, 99.6937, 82.3660),
    "OctoMap w G": (85.9206, 98.8779, 92.1719),
    "OctoMap w GF": (93.0621, 98.6727, 95.8263),
}


@pytest.mark.parametrize("method", PAPER)
def test_AA_matches_the_paper(method):
    SA, DA, AA = PAPER[method]
    kept, removed = round(SA * 10_000), round(DA * 10_000)  # of a million each
    metrics = Counts(kept, 1_000_000 - kept, removed, 1_000_000 - removed).metrics()
    assert [metrics[name] for name in ("SA", "DA", "AA")] == pytest.approx(
        [SA, DA, AA], abs=1.01e-4
    )


def test_every_percentage_by_hand():
    counts = Counts(
        static_kept=90, static_removed=10, dynamic_removed=30, dynamic_kept=20, unlabelled=7
    )
    assert counts.metrics() == {
        "SA": pytest.approx(90),
        "DA": pytest.approx(60),
        "AA": pytest.approx(math.sqrt(5400)),
        "HA": pytest.approx(72),
        "precision": pytest.approx(75),
        "IoU": pytest.approx(50),
    }


def test_undefined_percentages_are_none():
    only_static = Counts(static_kept=3, static_removed=1).metrics()
    assert only_static["SA"] == 75
    assert only_static["DA"] is only_static["AA"] is only_static["HA"] is None
    only_dynamic = Counts(dynamic_removed=3, dynamic_kept=1).metrics()
    assert only_dynamic["DA"] == 75
    assert only_dynamic["SA"] is only_dynamic["AA"] is only_dynamic["HA"] is None
    assert (
        Counts(static_kept=3, dynamic_kept=2).metrics()["precision"] is None
    )  # nothing was removed
    assert set(Counts(unlabelled=5).metrics().values()) == {None}


def test_the_mean_of_two_zero_accuracies_is_zero():
    counts = Counts(static_removed=1, dynamic_kept=1)
    assert (counts.AA, counts.HA) == (0, 0)


@given(OUTCOMES, OUTCOMES)
def test_adding_counts_equals_counting_all_points(a, b):
    assert Counts.of(a) + Counts.of(b) == Counts.of(np.concatenate([a, b]))


@given(OUTCOMES, st.randoms(use_true_random=False))
def test_the_order_of_points_does_not_matter(outcome, random):
    shuffled = outcome.tolist()
    random.shuffle(shuffled)
    assert Counts.of(np.array(shuffled, np.uint8)) == Counts.of(outcome)


@given(OUTCOMES)
def test_every_point_counts_once_and_HA_AA_are_means(outcome):
    counts = Counts.of(outcome)
    assert sum(dataclasses.astuple(counts)) == len(outcome)
    if not math.isnan(counts.AA):
        low, high = sorted((counts.SA, counts.DA))
        assert low - 1e-9 <= counts.HA <= counts.AA + 1e-9 <= high + 2e-9


def test_counts_by_label_and_answer():
    labels = np.array([0, 0, 1, 1, 255, 255], np.uint8)
    removed = np.array([False, True, False, True, False, True])
    assert Counts.of(outcomes(labels, removed)) == Counts(1, 1, 1, 1, 2)


def test_curves_are_per_frame_and_cumulative(info, make_labelled):
    metric = Confusion(info)
    kept = metric.update(
        make_labelled(0, points=np.zeros((4, 3)), labels=[0, 0, 0, 1], dynamic=[False] * 3 + [True])
    )
    assert (kept["SA/frame"], kept["DA/so_far"]) == (100, 100)
    lost = metric.update(make_labelled(1, points=np.zeros((1, 3)), labels=[0], dynamic=[True]))
    assert (lost["SA/frame"], lost["SA/so_far"]) == (0, 75)
    assert math.isnan(lost["DA/frame"])
    assert lost["DA/so_far"] == 100
    assert set(lost) == {
        f"{n}/{w}" for n, w in itertools.product(("SA", "DA", "AA", "HA"), ("frame", "so_far"))
    }


def test_sections_are_plain_json(info, make_labelled):
    metric = Confusion(info)
    metric.update(make_labelled(0, labels=np.full(400, 255)))
    sections = plain(metric.finish())
    assert sections["counts"] == {**dict.fromkeys(sections["counts"], 0), "unlabelled": 400}
    assert list(sections["metrics"]) == ["SA", "DA", "AA", "HA", "precision", "IoU"]
    assert set(sections["metrics"].values()) == {None}
