"""Fields of failure cases: range, objects, neighbours, order, and what is not listed."""

import numpy as np
import pytest
from helpers.failure_cases import INFO, labelled, section

from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Outcome, Scan
from dynaviz_eval.cases import KEEP
from dynaviz_eval.failures import FailuresMetric

pytestmark = pytest.mark.boundscheck

SPOT = np.full((3, 3), 0.25)


def labelled_one_by_one(points, labels, dynamic, reasons=0, **fields) -> Labelled:
    scan = Scan(
        0, np.asarray(points, np.float32), np.eye(4), labels=np.asarray(labels, np.uint8), **fields
    )
    return Labelled.of(
        0, scan, np.asarray(dynamic, np.bool_), np.full(len(scan), reasons, np.uint8)
    )


def test_ranges_are_measured_from_the_origin_of_each_ray():
    points = np.array([[3, 4, 0], [3, 4.2, 0.3]])
    (case,) = section(labelled(0, points, 1, False))["cases"]
    assert case["range"] == {"min": 5.0, "mean": 5.1, "max": 5.2}
    assert (case["low"], case["high"]) == ([3, 4, 0], [3, 4.2, 0.3])
    (case,) = section(labelled(0, points, 1, False, origins=np.array([[3, 3, 0], [3, 2.2, 0.3]])))[
        "cases"
    ]
    assert case["range"] == {"min": 1.0, "mean": 1.5, "max": 2.0}


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize(("cells", "shared"), [(1, True), (2, False)])
def test_a_mover_in_a_touching_cell_counts_as_a_shared_cell(axis, side, cells, shared):
    mover = np.full((3, 3), 0.25)
    mover[:, axis] += side * cells * 0.5
    mover[2] = np.nan  # ignored
    points, labels = np.concatenate([SPOT, mover]), np.repeat([0, 1], 3)
    (case,) = section(labelled_one_by_one(points, labels, [True] * 6))["cases"]
    assert case["cause"].endswith("a mover in its cell") == shared


def test_class_0_has_no_name_and_object_0_is_none():
    (case,) = section(
        labelled(
            0, SPOT, 1, False, classes=[0] * 3, instances=[0] * 3, class_names={0: "unlabelled"}
        )
    )["cases"]
    assert (case["class"], case["instance"], case["what"]) == (0, None, "moving object")
    (case,) = section(labelled(0, SPOT, 1, False))["cases"]
    assert (case["class"], case["instance"]) == (None, None)


def test_objects_separate_kept_points_and_classes_separate_removed_ones():
    of_two = {"classes": [4, 4, 5], "instances": [1, 2, 2]}
    kept, removed = (
        section(labelled(0, SPOT, label, label == 0, **of_two))["cases"] for label in (1, 0)
    )
    assert [(c["class"], c["instance"]) for c in kept] == [(4, 1), (4, 2), (5, 2)]
    assert [(c["class"], c["instance"], c["points"]) for c in removed] == [
        (4, None, 2),
        (5, None, 1),
    ]


def test_the_cost_relates_to_all_points_of_the_kind_and_reasons_are_sorted():
    points, wrong = np.tile(SPOT, (2, 1)), np.array([True] * 4 + [False] * 2)
    one = labelled_one_by_one(points, [0] * 6, wrong)
    one.reasons[:] = [9, 1, 1, 0, 0, 0]
    (case,) = section(one)["cases"]
    assert case["cost"] == pytest.approx(100 * 4 / 6)
    assert list(case["reasons"].items()) == [
        ("never_crossed", 2),
        ("crossed", 1),
        ("unknown code", 1),
    ]


def test_equal_costs_are_sorted_by_kind_frame_and_position():
    x = np.array([[39, 0, 0], [3, 0, 0]])
    frames = (
        labelled(0, x, 0, True),
        labelled(30, x, 0, True),
        labelled(60, x, 1, False),
        labelled(90, x, 1, False),
    )
    cases = section(*frames)["cases"]
    assert [(c["kind"], c["first_frame"], c["low"][0]) for c in cases] == [
        *(("false_negative", frame, x) for frame in (60, 90) for x in (3, 39)),
        *(("false_positive", frame, x) for frame in (0, 30) for x in (3, 39)),
    ]


def test_the_costliest_are_listed_and_the_others_summed():
    x = 2.0 * np.arange(KEEP + 30)
    line = np.stack([x, 0 * x, 0 * x], 1)
    frames = [
        labelled(f, line[: KEEP + 3] if f else line, 1, False, 2 if f else 1) for f in range(3)
    ]
    found = section(*frames, labelled(40, [], 1, False))
    assert len(found["cases"]) == KEEP
    assert {case["points"] for case in found["cases"]} == {3}
    assert found["others"] == {"cases": 30, "points": 3 * 3 + 27}
    causes = found["causes"]["false_negative"]
    assert causes.pop("not listed, not measured") == found["others"]
    assert sum(each["cases"] for each in causes.values()) == KEEP
    assert sum(each["points"] for each in causes.values()) == 3 * KEEP


def test_boxes_have_the_numbers_of_the_cases():
    metric = FailuresMetric(INFO)
    metric.update(labelled(0, np.array([[0, 0, 0], [9, 0, 0], [9, 0.1, 0]]), 1, False))
    metric.update(labelled(1, np.array([[9, 0, 0.3]]), 1, False))
    metric.finish()
    boxes = metric.figures()["failures"]
    assert boxes.labels == ("1 moving object", "2 moving object")
    assert boxes.outcomes.tolist() == [Outcome.FALSE_NEGATIVE] * 2
    np.testing.assert_allclose(boxes.low, [[9, 0, 0], [0, 0, 0]])
    np.testing.assert_allclose(boxes.high, [[9, 0.1, 0.3], [0, 0, 0]], rtol=1e-6)
    assert (boxes.frames.tolist(), boxes.case.tolist()) == ([0, 1, 0], [0, 0, 1])


@pytest.mark.parametrize(("z", "what"), [(-2.0, "ground"), (5.0, "level surface")])
def test_a_level_surface_is_ground_below_the_sensor_only(z, what):
    x, y = (v.ravel() for v in np.meshgrid(np.arange(0, 3, 0.2), np.arange(0, 3, 0.2)))
    (case,) = section(labelled(0, np.stack([x - 20, y + 7, np.full(len(x), z)], 1), 0, True))[
        "cases"
    ]
    assert (case["what"], case["cause"]) == (what, "cannot be told")
