"""Reasons crossed with outcomes."""

import numpy as np
import pytest
from helpers.sections import plain

from dynaviz.scores.scores import Counts
from dynaviz_eval.reasons import ReasonsMetric

pytestmark = pytest.mark.boundscheck


def test_wrong_points_are_counted_by_name(info, make_labelled):
    metric = ReasonsMetric(info)
    labelled = make_labelled(
        0,
        points=np.zeros((6, 3)),
        labels=[0, 0, 1, 1, 1, 255],
        dynamic=[True, False, False, False, True, True],
        reasons=[0, 1, 1, 1, 0, 0],
    )
    curves = metric.update(labelled)
    assert curves["reasons/false_negative/never_seen"] == 2
    assert curves["reasons/false_positive/never_seen"] == 0
    section = plain(metric.finish())["reasons"]
    assert section["false_negative"] == {"never_seen": 2}
    assert section["false_positive"] == {"seen_free": 1}
    assert section["dynamic_removed"] == {"seen_free": 1}
    assert section["static_kept"] == {"never_seen": 1}
    assert section["cost"] == {
        "seen_free": {"SA": 50, "DA": 0},
        "never_seen": {"SA": 0, "DA": pytest.approx(200 / 3)},
    }
    assert section["legend"]["never_seen"] == "no ray did"


def test_costs_add_up_to_the_missing_percentage_points(info, make_labelled):
    metric, total = ReasonsMetric(info), Counts()
    for frame in range(3):
        labelled = make_labelled(frame)
        metric.update(labelled)
        total += Counts.of(labelled.outcome)
    cost = plain(metric.finish())["reasons"]["cost"]
    assert sum(c["SA"] for c in cost.values()) == pytest.approx(100 - total.SA)
    assert sum(c["DA"] for c in cost.values()) == pytest.approx(100 - total.DA)


@pytest.mark.parametrize("code", [3, 255])  # the legend has 0 to 2
def test_an_undeclared_code_shows_as_a_number(info, make_labelled, code):
    metric = ReasonsMetric(info)
    metric.update(
        make_labelled(0, points=np.zeros((1, 3)), labels=[1], dynamic=[False], reasons=[code])
    )
    assert plain(metric.finish())["reasons"]["false_negative"] == {f"code {code}": 1}


def test_the_most_frequent_reason_is_first(info, make_labelled):
    metric = ReasonsMetric(info)
    metric.update(
        make_labelled(
            0,
            points=np.zeros((6, 3)),
            labels=[1] * 6,
            dynamic=[False] * 6,
            reasons=[0, 1, 1, 7, 7, 7],
        )
    )
    assert list(plain(metric.finish())["reasons"]["false_negative"].items()) == [
        ("code 7", 3),
        ("never_seen", 2),
        ("seen_free", 1),
    ]


def test_a_reason_may_cost_both_accuracies(info, make_labelled):
    metric = ReasonsMetric(info)
    labels, dynamic = [1, 1, 0, 0], [False, True, True, False]
    metric.update(
        make_labelled(0, points=np.zeros((4, 3)), labels=labels, dynamic=dynamic, reasons=[0] * 4)
    )
    assert plain(metric.finish())["reasons"]["cost"] == {"seen_free": {"SA": 50, "DA": 50}}


def test_no_wrong_points_without_ground_truth(info, make_labelled):
    metric = ReasonsMetric(info)
    metric.update(make_labelled(0, labels=None, dynamic=np.ones(400, bool)))
    section = plain(metric.finish())["reasons"]
    assert section["false_negative"] == section["false_positive"] == section["cost"] == {}
