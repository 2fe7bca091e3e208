"""The case of a wrong point, where boxes of cases overlap."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynaviz.contracts.metric import CaseSample
from dynaviz.scores.case_points import CasePoints
from dynaviz.scores.failure_case import FailureCase, RangeSpan


def case(
    points: np.ndarray, kind: str = "false_positive", first: int = 0, last: int = 0
) -> FailureCase:
    """A case around points."""
    return FailureCase(
        points=len(points), first_frame=first, last_frame=last, worst_frame=first, frames=1,
        low=tuple(points.min(0).tolist()), high=tuple(points.max(0).tolist()),
        range=RangeSpan(1.0, 2.0, 3.0), moved=0.0, reasons={}, kind=kind, cost=1.0,
    )  # fmt: skip


def corner(way: float, apart: float) -> np.ndarray:
    """(N, 3): an L of two walls; the box of another one in it contains all of that."""
    along = np.arange(0.0, 8.0, 0.2)
    walls = [np.stack([along, 0 * along], 1), np.stack([0 * along, along], 1)]
    flat = way * np.concatenate(walls) + (0.0 if way > 0 else apart)
    return np.column_stack([flat, np.tile([0.0, 0.5], len(flat) // 2)])


@given(apart=st.floats(4.0, 7.0), every=st.integers(1, 5), order=st.permutations([0, 1]))
def test_of_two_overlapping_boxes_that_of_the_nearest_point_counts(
    apart: float, every: int, order: list[int]
) -> None:
    shapes = [corner(1.0, apart), corner(-1.0, apart)]
    shapes = [shapes[k] for k in order]
    numbers = np.concatenate([np.full(len(shape), k) for k, shape in enumerate(shapes)])
    points = np.concatenate(shapes).astype(np.float32)
    frames = np.zeros(len(points), np.int64)
    cases = [case(shape) for shape in shapes]
    known = CaseSample(numbers[::every], frames[::every], points[::every])
    inside = np.array([CasePoints(cases).around("false_positive", 0, at) for at in points.tolist()])
    assert (inside == 2).any()
    # where the walls cross, the nearest known point may be of either
    gap = np.array(
        [
            np.linalg.norm(points[numbers != number] - at, axis=1).min()
            for number, at in zip(numbers, points, strict=True)
        ]
    )
    clear = gap > 0.25 * every + 0.6
    assert (clear & (inside == 2)).any()
    found = CasePoints(cases, known).owners("false_positive", frames, points)
    np.testing.assert_array_equal(found[clear], numbers[clear] + 1)
    by_box = CasePoints(cases).owners("false_positive", frames, points)
    assert (by_box[clear & (inside == 2)] == 1).all()
    assert (by_box[clear] != numbers[clear] + 1).any()


def test_a_point_is_of_a_case_of_its_kind_and_its_frames() -> None:
    wall = np.random.default_rng(0).uniform(0, 2, (50, 3)).astype(np.float32)
    cases = [
        case(wall, "false_negative", 0, 9),
        case(wall, "false_positive", 0, 4),
        case(wall, "false_positive", 20, 24),
    ]
    points = CasePoints(cases)
    place = wall[3].tolist()
    assert points.owner("false_negative", 5, place) == 1
    assert points.owner("false_positive", 2, place) == 2
    assert points.owner("false_positive", 22, place) == 3
    assert points.owner("false_positive", 9, place) is None
    assert points.owner("false_negative", 5, [9.0, 9.0, 9.0]) is None


@pytest.mark.parametrize("frame", [0, 9])
def test_movers_that_cross_one_place_are_told_apart_by_time(frame: int) -> None:
    paths = [np.arange(10.0), np.arange(10.0)[::-1]]  # metres along x, by frame
    shapes = [np.column_stack([way, 0 * way, 0 * way]) for way in paths]
    cases = [case(shape, "false_negative", 0, 9) for shape in shapes]
    frames = np.tile(np.arange(10), 2)
    numbers = np.repeat([0, 1], 10)
    sample = CaseSample(numbers, frames, np.concatenate(shapes).astype(np.float32))
    points = CasePoints(cases, sample)
    for number in (0, 1):
        assert points.owner("false_negative", frame, shapes[number][frame].tolist()) == number + 1
