"""Rows of cases: their fields, and when cases are dropped."""

import numpy as np
import pytest

from dynaviz_eval.cases import EVERY, GAP, KEEP, Cases, FramePoints, gathered, summed

pytestmark = pytest.mark.boundscheck


def add(cases: Cases, frame: int, points, groups=0, reasons=0, ranges=1.0, touching=False) -> None:
    points = np.asarray(points, np.float32).reshape(-1, 3)
    n = len(points)
    dtypes = (groups, np.int64), (reasons, np.uint8), (ranges, np.float32), (touching, np.bool_)
    cases.add(
        FramePoints(frame, points, *(np.broadcast_to(np.asarray(v, t), n) for v, t in dtypes))
    )


def test_a_row_describes_a_case_in_a_frame():
    cases = Cases(3, np.inf)
    points = [[0.1, 0.2, 0.3], [9, 9, 9], [0.2, 0.1, 0.6], [0.3, 0.3, 0.2]]
    add(
        cases, 4, points, [7, 8, 7, 7], [0, 2, 1, 200], [1.5, 5, 2.5, 2], [True, False, True, False]
    )
    cases.settle(4 + GAP + 1)
    row, other = sorted(cases.rows, key=lambda row: row["group"])
    assert [int(row[name]) for name in ("frame", "group", "points", "cells", "touching")] == [
        4,
        7,
        3,
        2,
        2,
    ]
    np.testing.assert_allclose(row["low"], [0.1, 0.1, 0.2], rtol=1e-6)
    np.testing.assert_allclose(row["high"], [0.3, 0.3, 0.6], rtol=1e-6)
    assert (row["near"], row["far"], row["ranges"], row["reasons"].tolist()) == (
        1.5,
        2.5,
        6.0,
        [1, 1, 1],
    )
    assert (other["points"], other["cells"], other["reasons"].tolist()) == (1, 1, [0, 0, 1])


def test_two_cases_of_a_frame_that_join_later_become_one_row():
    cases = Cases(1, np.inf)
    add(cases, 0, [[0, 0, 0], [2, 0, 0]], ranges=[1, 4], touching=True)
    add(cases, 1, [[0.6, 0, 0], [1.1, 0, 0], [1.6, 0, 0]])  # a bridge between them
    cases.settle(1 + GAP + 1)
    first, second = cases.rows
    assert (first["case"], second["case"], first["frame"], second["frame"]) == (0, 0, 0, 1)
    assert (first["points"], first["cells"], first["touching"], first["ranges"]) == (2, 2, 2, 5)
    assert (first["near"], first["far"], first["low"][0], first["high"][0]) == (1, 4, 0, 2)
    assert second["points"] == 3


def test_a_summed_case_has_its_first_last_and_worst_frame_and_its_motion():
    cases = Cases(1, np.inf)
    for frame, x, n in ((0, 0.0, 1), (1, 0.3, 4), (2, 0.6, 4), (5, 0.9, 2)):
        add(cases, frame, [[x, 0, 0]] * n + [[x, 0.2, 0.2]])
    cases.settle(5 + GAP + 1)
    (total,) = summed(cases.rows)
    assert [int(total[name]) for name in ("frames", "first", "last", "frame", "points")] == [
        4,
        0,
        5,
        1,
        15,
    ]
    np.testing.assert_allclose(
        total["moved"], 0.3, rtol=1e-5
    )  # three first: 0, .3, .6; three last: .3, .6, .9


def test_only_cases_that_are_over_are_dropped_and_the_largest_never():
    small = []
    cases = Cases(1, np.inf, small.extend)
    many = np.stack([2.0 * np.arange(KEEP + 20), np.zeros(KEEP + 20), np.zeros(KEEP + 20)], 1)
    add(cases, 0, many)
    add(cases, 1, many[10 : KEEP + 10])  # these have two points
    cases.settle(GAP)
    assert not small  # points that touch them in the next frame still join them
    cases.settle(GAP + 1)
    assert (len(np.unique(cases.rows["case"])), len(small)) == (KEEP, 20)
    assert (
        summed(cases.rows)["points"].sum() + sum(case["points"] for case in small) == 2 * KEEP + 20
    )


def test_a_case_continues_after_settling():
    cases = Cases(1, np.inf)
    for frame in range(3 * EVERY):
        add(cases, frame, [[0.1 * frame, 0, 0], [0, 50 + 0.1 * frame, 0]])
    cases.settle(3 * EVERY + GAP)
    assert sorted(summed(cases.rows)["frames"]) == [3 * EVERY] * 2


def test_the_span_limits_a_case_over_frames_and_settling():
    cases = Cases(1, 5.0)
    for frame in range(4 * EVERY):
        add(cases, frame, [[0.25 * frame, 0, 0]])
    cases.settle(4 * EVERY + GAP)
    total = summed(cases.rows)
    assert (total["high"] - total["low"]).max() < 5.0
    assert len(total) == 4


def test_the_table_has_room_for_twice_the_cells_added_between_settling():
    cases = Cases(1, np.inf)
    for frame in range(EVERY - 1):
        add(
            cases,
            frame,
            np.stack([2.0 * np.arange(150), np.full(150, 2.0 * frame), np.zeros(150)], 1),
        )
        assert len(cases._table) >= 2 * 150 * (frame + 1)


def ground_case(
    number: int, x: float, points: int, frame: int = 0, ground: bool = True
) -> np.ndarray:
    row = np.zeros(1, Cases(1, 20.0).kind)
    row["case"], row["frame"], row["points"], row["ground"] = number, frame, points, points * ground
    row["low"], row["high"] = (x, 0, 0), (x + 2, 9, 0.2)
    return row


def test_patches_of_ground_near_each_other_are_one_case():
    rows = [
        ground_case(0, 7.0, 10), ground_case(1, 0.0, 30), ground_case(1, 0.5, 20, 1),
        ground_case(2, 17.9, 5),
        ground_case(3, 18.1, 40, GAP), ground_case(4, 3.0, 9, ground=False),
        ground_case(5, 3.0, 7, GAP + 2),
    ]  # fmt: skip
    found, largest, into = gathered(np.concatenate(rows), 20.0)
    assert sorted(
        zip(found["case"].tolist(), found["frame"].tolist(), found["points"].tolist(), strict=True)
    ) == [
        (1, 0, 45),
        (1, 1, 20),
        (3, GAP, 40),
        (3, GAP + 2, 7),
        (4, 0, 9),
    ]
    assert largest == {1: 50 / 65, 3: 40 / 47}
    assert into == {0: 1, 2: 1, 5: 3}
    assert found["high"][found["case"] == 1].max() == pytest.approx(19.9)
    none, nothing, _ = gathered(np.concatenate(rows)[:0], 20.0)
    assert (len(none), nothing) == (0, {})
