"""Failure cases against connected components of a graph, and their fields."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.failure_cases import INFO, labelled, section
from helpers.sections import plain
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from dynaviz.contracts.metric import FrameBoxes, Labelled
from dynaviz.contracts.scan import Outcome, Scan
from dynaviz.scores.failure_case import FailureCase, RangeSpan
from dynaviz.scores.spans import in_words, shared_objects
from dynaviz_eval.cases import EDGE, GAP, KEEP, Cases, FramePoints, summed
from dynaviz_eval.failures import FailuresMetric, class_in_words, spans_of_looks

pytestmark = pytest.mark.boundscheck


def cube(n: int = 50, seed: int = 0, x: float = 0.0) -> np.ndarray:
    return np.random.default_rng(seed).uniform([x, 0, 0], [x + 0.9, 0.9, 0.9], (n, 3))


def components(frames: list[np.ndarray]) -> list[frozenset[tuple[int, int]]]:
    """Points (frame, number) joined where their cells touch and their frames are close.

    A graph of all pairs.
    """
    where = [(f, i) for f, points in enumerate(frames) for i in range(len(points))]
    if not where:
        return []
    cells = np.floor(np.concatenate(frames) / EDGE)
    when = np.array([f for f, _ in where])
    touch = (np.abs(cells[:, None] - cells[None]).max(-1) <= 1) & (
        np.abs(when[:, None] - when[None]) <= GAP
    )
    _, label = connected_components(coo_array(touch), directed=False)
    return [frozenset(where[i] for i in np.flatnonzero(label == k)) for k in range(label.max() + 1)]


@pytest.mark.plain
@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    n=st.integers(0, 40),
    frames=st.integers(1, 40),
    size=st.floats(1.0, 8.0),
)
def test_cases_are_connected_components(seed, n, frames, size):
    rng = np.random.default_rng(seed)
    scans = [
        rng.uniform(-size, size, (rng.integers(0, n + 1), 3)).astype(np.float32)
        for _ in range(frames)
    ]
    small = []
    cases = Cases(2, np.inf, small.append)
    for frame, points in enumerate(scans):
        m = len(points)
        zeros = (
            np.zeros(m, np.int64),
            np.zeros(m, np.uint8),
            np.zeros(m, np.float32),
            np.zeros(m, np.bool_),
        )
        cases.add(FramePoints(frame, points, *zeros))
    cases.settle(frames + GAP)
    found = np.concatenate([some["points"] for some in (summed(cases.rows), *small)])
    assert sorted(found) == sorted(len(c) for c in components(scans))


def test_memory_does_not_grow_with_frames():
    small, sizes = [], []
    rng, cases = np.random.default_rng(1), Cases(2, np.inf, small.append)
    for frame in range(600):
        points = rng.uniform([frame - 40, -40, -40], [frame + 40, 40, 40], (60, 3)).astype(
            np.float32
        )
        none = np.zeros(60, np.int64)
        zeros = none, none.astype(np.uint8), np.zeros(60, np.float32), none.astype(np.bool_)
        cases.add(FramePoints(frame, points, *zeros))
        sizes.append((len(cases._table), len(cases._parent), len(cases.rows)))
    assert (np.max(sizes[300:], axis=0) <= 1.5 * np.max(sizes[100:300], axis=0)).all()
    cases.settle(599 + GAP + 1)
    assert sum(some["points"].sum() for some in (summed(cases.rows), *small)) == 36000
    assert len(np.unique(cases.rows["case"])) == KEEP


def test_an_object_without_a_class():
    (case,) = section(labelled(0, [[1.0, 0, 0]] * 9, 1, False, instances=np.full(9, 4)))["cases"]
    assert (case["class"], case["instance"]) == (None, 4)


def test_a_large_hole_is_split_and_a_long_trail_is_not():
    x = np.arange(0, 70, 0.2)
    line = np.stack([x, 0 * x, 0 * x], 1)
    holes = section(labelled(0, line, 0, True))["cases"]
    assert len(holes) >= 4
    assert all(case["high"][0] - case["low"][0] <= 20.0 for case in holes)
    assert sum(case["points"] for case in holes) == len(line)
    assert len(section(labelled(0, line, 1, False))["cases"]) == 1


def test_one_object_is_followed_through_its_frames():
    frames = [labelled(f, cube(seed=f, x=f), 1, False, 1) for f in range(12)]
    found = section(*frames)
    (case,) = found["cases"]
    assert (case["kind"], case["points"], case["cost"], case["frames"]) == (
        "false_negative",
        600,
        100.0,
        12,
    )
    assert (case["first_frame"], case["last_frame"], case["worst_frame"]) == (0, 11, 0)
    assert case["moved"] == pytest.approx(
        9.0, abs=0.3
    )  # from the first three frames to the last three
    assert case["cause"] == "seen through, but the method demands more"
    assert case["looks"]["seen_through"] > 50
    assert (case["behaviour"], case["what"]) == ("passed by", "moving object")
    assert "passed by" in case["sentence"]
    assert case["reasons"] == {"never_crossed": 600}
    assert found["causes"]["false_negative"] == {case["cause"]: {"cases": 1, "points": 600}}
    assert found["others"] == {"cases": 0, "points": 0}


@pytest.mark.parametrize("reason", [4, 1])
def test_an_object_that_stays_is_reported_as_such(reason):
    (case,) = section(*(labelled(f, cube(seed=f), 1, False, reason) for f in range(12)))["cases"]
    assert case["cause"] == "stood there"
    assert case["word"] == INFO.reasons[reason].cause
    assert case["behaviour"] == "stood still until the end"
    assert "stood still until the end" in case["sentence"]


def test_points_that_return_after_a_gap_start_a_new_case():
    frames = [labelled(f, cube(), 1, False) for f in (0, 1, 2, 2 + GAP + 1)]
    assert sorted(case["points"] for case in section(*frames)["cases"]) == [50, 150]
    assert len(section(*(labelled(f, cube(), 1, False) for f in (0, GAP)))["cases"]) == 1


def test_one_scan_cannot_tell_and_a_trunk_next_to_a_pedestrian_has_a_mover_in_its_cell():
    ground = np.random.default_rng(0).uniform([0, 0, 0], [8, 4, 0.05], (2000, 3))
    (strip,) = section(labelled(0, ground, 0, True))["cases"]
    assert (strip["cause"], strip["what"]) == ("cannot be told", "ground")

    pedestrian, trunk = cube(60), cube(60) * [0.3, 0.3, 2] + [1.1, 0, 0]
    scan = Scan(0, np.concatenate([pedestrian, trunk]), np.eye(4), labels=np.repeat([1, 0], 60))
    cases = section(Labelled.of(0, scan, np.ones(120, np.bool_), np.zeros(120, np.uint8)))["cases"]
    found = [(case["cause"], case["what"], case["behaviour"], case["ground"]) for case in cases]
    assert found == [
        ("no ray through most of it: a mover near", "pole or trunk", "next to a mover", 0.0),
        (
            "no ray through most of it: a mover in its cell",
            "ground",
            "next to a mover",
            1.0,
        ),  # its foot
    ]


def test_the_word_of_the_method_stands_beside_the_cause():
    (high,) = section(*(labelled(f, cube(), 1, False, 2) for f in range(12)))["cases"]
    assert (high["cause"], high["word"]) == ("stood there", "height limit")
    (mystery,) = section(labelled(0, cube(), 1, False, 3))["cases"]
    assert (mystery["cause"], mystery["word"]) == ("cannot be told", None)
    assert mystery["sentence"].endswith("Unknown.")


def test_classes_and_objects_separate_and_name_cases():
    names = {5: "car", 7: "tree"}
    fields = {
        "classes": np.repeat([5, 7], 25),
        "class_names": names,
        "instances": np.repeat([3, 4], 25),
    }
    found = section(labelled(0, cube(), 1, False, **fields))["cases"]
    assert [(c["what"], c["class"], c["instance"], c["points"]) for c in found] == [
        ("car", 5, 3, 25),
        ("tree", 7, 4, 25),
    ]


def test_the_costliest_case_is_first_whatever_its_kind():
    static, ghost = cube(500) * [1, 1, 0.1], cube(10, x=50)
    frames = (
        labelled(0, static, 0, True),
        labelled(1, ghost, 1, False),
        labelled(2, cube(500, x=90), 0, False),
    )
    found = section(*frames)["cases"]
    assert [(c["kind"], c["cost"]) for c in found] == [
        ("false_negative", 100.0),
        ("false_positive", 50.0),
    ]


def test_boxes_contain_the_points_of_their_frame():
    metric, clouds = FailuresMetric(INFO), [cube(seed=f, x=f) for f in range(5)]
    for f, cloud in enumerate(clouds):
        metric.update(labelled(f, cloud, 1, False))
    metric.finish()
    boxes = metric.figures()["failures"]
    assert isinstance(boxes, FrameBoxes)
    assert boxes.frames.tolist() == [0, 1, 2, 3, 4]
    np.testing.assert_allclose(boxes.box_low, [c.min(0) for c in clouds], rtol=1e-6)
    np.testing.assert_allclose(boxes.box_high, [c.max(0) for c in clouds], rtol=1e-6)
    assert boxes.outcomes.tolist() == [Outcome.FALSE_NEGATIVE]


@pytest.mark.parametrize(
    "points", [np.empty((0, 3)), np.full((4, 3), np.nan), np.full((4, 3), 1e9)]
)
def test_points_without_a_position_belong_to_no_case(points):
    found = section(labelled(0, points, 1, False))
    assert found["cases"] == []


def test_no_cases_without_ground_truth():
    scan = Scan(0, cube(), np.eye(4))
    metric = FailuresMetric(INFO)
    metric.update(Labelled.of(0, scan, np.ones(50, np.bool_), np.zeros(50, np.uint8)))
    assert plain(metric.finish())["failures"]["cases"] == []
    assert metric.figures() == {}


def test_spans_tell_when_an_object_moved_and_when_it_was_kept():
    x = [min(0.9 * frame, 9.0) for frame in range(30)]  # it parks in frame 10
    frames = [labelled(f, cube(seed=f, x=at), 1, f >= 20, 1) for f, at in enumerate(x)]
    (case,) = section(*frames)["cases"]
    assert case["spans"] == {
        "moving": [[0, 9]], "standing": [[10, 29]], "kept": [[0, 19]], "removed": [[20, 29]],
        "hidden": [[2, 9]], "hit": [[10, 29]],
    }  # fmt: skip
    assert in_words(case["spans"]) == (
        "moves 0-9, stands 10-29; hidden 2-9, hit 10-29; kept 0-19, removed 20-29"
    )


def test_an_object_of_which_at_most_half_is_kept_is_kept_partly():
    points = cube(10)
    scan = Scan(0, points, np.eye(4), labels=np.ones(10, np.uint8))
    spans = {}
    for kept in (5, 6):
        answer = np.arange(10) >= kept
        (case,) = section(Labelled.of(0, scan, answer, np.zeros(10, np.uint8)))["cases"]
        spans[kept] = case["spans"]
    assert spans == {
        5: {"partly": [[0, 0]], "hit": [[0, 0]]},
        6: {"kept": [[0, 0]], "hit": [[0, 0]]},
    }


def test_runs_share_objects_by_class_and_number():
    moves = {"moving": ((0, 9),), "kept": ((0, 4),), "removed": ((5, 9),)}
    one, other = (
        failure_case(1.0, 7, moves),
        failure_case(3.0, 8, {"standing": ((2, 3),), "kept": ((2, 3),)}),
    )
    same = failure_case(5.0, 7, {**moves, "kept": ((0, 9),), "removed": ()})
    unnumbered = failure_case(9.0, None, moves)
    (first, found), (second, others) = shared_objects({"A": [other, one, unnumbered], "B": [same]})
    # the costliest first; those without a number are not compared
    assert (first, second) == (
        "car 7",
        "car 8",
    )
    kept = {"A": [("kept", (0, 4)), ("removed", (5, 9))], "B": [("kept", (0, 9))]}
    assert found == {"object": [("moving", (0, 9))], **kept}
    assert others == {
        "object": [("standing", (2, 3))],
        "A": [("kept", (2, 3))],
        "B": [("removed", (2, 3))],
    }


def failure_case(cost: float, instance: int | None, spans: Any) -> FailureCase:
    corner = (0.0, 0.0, 0.0)
    return FailureCase(
        kind="false_negative",
        points=1,
        cost=cost,
        first_frame=0,
        last_frame=9,
        worst_frame=0,
        frames=10,
        low=corner,
        high=corner,
        range=RangeSpan(1, 1, 1),
        moved=0.0,
        reasons={},
        class_=3,
        instance=instance,
        what="car",
        spans=spans,
    )


@pytest.mark.parametrize(
    ("hit", "through", "grazing", "hidden", "unknown", "shown"),
    [
        (30, 0, 0, 0, 98, None),  # fewer than a quarter
        (0, 20, 20, 0, 88, "through"),  # most rays miss it, and of the others most pass
        (10, 20, 20, 39, 39, "through"),  # grazing rays pass, too
        (60, 30, 0, 38, 0, "hit"),
        (0, 0, 0, 32, 96, "hidden"),
        (0, 0, 0, 0, 0, None),
    ],
)
def test_the_most_frequent_look_is_shown_over_time_if_it_is_a_quarter(
    hit: int, through: int, grazing: int, hidden: int, unknown: int, shown: str | None
) -> None:
    counts = np.array([[hit, through, grazing, hidden, unknown, 0]], np.int32)
    assert spans_of_looks(counts) == ({} if shown is None else {shown: ((0, 0),)})


@pytest.mark.parametrize(
    ("sizes", "looked_at"),
    [
        ([700, 327, 3], [512, 327, 3]),
        ([600] * 100, [128] * 100),
        ([600] * 50 + [28] * 50, [228] * 50 + [28] * 50),
    ],
)
def test_looks_are_taken_at_as_many_points_of_each_case(
    sizes: list[int], looked_at: list[int]
) -> None:
    points = np.concatenate([cube(size, k, 5.0 * k) for k, size in enumerate(sizes)])
    metric = FailuresMetric(INFO)
    metric.update(labelled(0, points, 1, False))
    groups = metric.places().groups
    assert np.bincount(groups[groups >= 0]).tolist() == looked_at


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("vehicle.bus.rigid", "rigid bus"),
        ("vehicle.car", "car"),
        ("human.pedestrian.adult", "adult pedestrian"),
        ("static_object.bicycle_rack", "bicycle rack"),
        ("moving car", "moving car"),
    ],
)
def test_classes_are_named_in_words(name: str, words: str) -> None:
    assert class_in_words(name) == words
