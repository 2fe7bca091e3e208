"""Labels from boxes: inside, border and ground of boxes in any pose; moving and parked tracks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dynaviz.sources.datasets.box_labels import (
    BORDER,
    GROUND,
    MARGIN,
    OrientedBox,
    moving_tracks,
    track_facts,
    truth_from_boxes,
)
from dynaviz.spatial import geometry

CAR = (4.0, 2.0, 1.5)


def placed(
    track: int = 1, at: Any = (0, 0, 0), yaw: float = 0.0, size: Any = CAR, **more: Any
) -> OrientedBox:
    return OrientedBox(
        track, 3, geometry.pose(at, (np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))), size, **more
    )


def labels(points: Any, boxes: list[OrientedBox], moving: Any = (1,), **more: Any) -> list[int]:
    return truth_from_boxes(
        np.array(points, float).reshape(-1, 3), boxes, moving, **more
    ).labels.tolist()


@pytest.mark.parametrize(
    ("point", "label"),
    [
        ((0, 0, 0.7), 1),
        ((2.04, 1.04, 1.54), 1),  # annotated boxes are tight
        ((2.06, 0, 0.7), 255),
        ((2.24, 1.24, 1.74), 255),
        ((2.26, 0, 0.7), 0),
        ((0, 1.26, 0.7), 0),
        ((0, 0, 1.76), 0),
        ((0, 0, 0.08), 1),
        ((0, 0, 0.06), 255),  # ground between the wheels
        ((0, 0, -0.24), 255),
        ((0, 0, -0.26), 0),
        ((np.nan, 0, 0.7), 0),
        ((np.inf, 0, 0.7), 0),
    ],
)
def test_the_inside_is_dynamic_and_the_border_is_unlabelled(point: Any, label: int) -> None:
    assert labels(point, [placed()]) == [label]
    assert labels(point, [placed()], moving=()) == [0]


def test_parked_objects_have_classes_and_instances() -> None:
    truth = truth_from_boxes(
        np.array([(0, 0, 1), (10, 0, 1), (5, 0, 1.0)]), [placed(7), placed(8, (10, 0, 0))], {8}
    )
    assert truth.labels.tolist() == [0, 1, 0]
    assert truth.instances is not None
    assert truth.instances.tolist() == [7, 8, 0]
    assert truth.classes is not None
    assert truth.classes.tolist() == [3, 3, 0]


def test_a_border_does_not_hide_another_box() -> None:
    boxes = [placed(1), placed(2, (0, 2.1, 0))]
    for order in (boxes, boxes[::-1]):
        assert labels([(0, 1.1, 1), (0, 1.02, 1)], order, moving=(1, 2)) == [1, 1]
        assert labels([(0, 1.2, 1)], order, moving=(1,)) == [
            255
        ]  # the parked one is near a moving one


def test_outside_the_annotated_region_only_boxes_are_labelled() -> None:
    points = [(0, 0, 1), (9, 0, 1), (9, 9, 1)]
    assert labels(points, [placed()], annotated=np.array([False, False, True])) == [1, 255, 0]


def test_points_in_an_extrapolated_box_are_unlabelled() -> None:
    points = [(0, 0, 1), (2.2, 0, 1), (3, 0, 1)]
    assert labels(points, [placed(extrapolated=True)]) == [255, 255, 0]
    assert labels(points, [placed(extrapolated=True)], moving=()) == [0, 0, 0]


def test_no_points_and_no_boxes() -> None:
    assert labels([], [placed()]) == []
    assert labels([(0, 0, 0)], []) == [0]


angle = st.floats(-np.pi, np.pi)
length = st.floats(0.2, 12)


@settings(max_examples=60, deadline=None)
@given(st.tuples(angle, angle, angle), st.tuples(length, length, length), st.integers(0, 2**31))
def test_boxes_in_any_pose_agree_with_rotated_points(angles: Any, size: Any, seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn = Rotation.from_euler("zyx", angles)
    local = rng.uniform(-0.8, 0.8, (400, 3)) * (np.array(size) + 0.6) + (0, 0, size[2] / 2)
    middle = rng.normal(0, 50, 3)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = turn.as_matrix(), middle
    outside = np.abs(local - (0, 0, size[2] / 2)) - np.array(size) / 2  # beyond each pair of sides
    beyond = outside.max(1)
    clear = np.abs(beyond[:, None] - (MARGIN, BORDER)).min(1) > 1e-6
    clear &= np.abs(local[:, 2] - (GROUND - MARGIN)) > 1e-6
    inside = (beyond < MARGIN) & (local[:, 2] > GROUND - MARGIN)
    expected = np.where(inside, 1, np.where(beyond < BORDER, 255, 0))
    found = np.array(labels(turn.apply(local) + middle, [OrientedBox(1, 1, T, size)]))
    np.testing.assert_array_equal(found[clear], expected[clear])


@pytest.mark.parametrize(
    ("metres", "seconds", "moves"),
    [(0.51, 1, True), (0.49, 1, False), (4.9, 10, False), (5.1, 10, True)],
)
def test_a_track_moves_if_its_mean_speed_is_high_enough(
    metres: float, seconds: float, moves: bool
) -> None:
    around = (5, seconds / 2, np.array([99.0, 0, 0]))  # positions in between do not count
    ends = [(5, 0.0, np.zeros(3)), around, (5, seconds, np.array([0.6, 0.8, 0]) * metres)]
    assert moving_tracks(ends) == (frozenset({5}) if moves else frozenset())


def test_tracks_are_separate_and_a_single_sighting_is_not_motion() -> None:
    here, there = np.zeros(3), np.array([30.0, 0, 0])
    seen = [(1, 0.0, here), (2, 0.0, here), (3, 0.0, there), (1, 9.0, there), (2, 9.0, here)]
    assert moving_tracks(seen) == {1}
    assert moving_tracks(seen, speed=5.0) == frozenset()
    assert moving_tracks([]) == frozenset()


def test_facts_count_objects() -> None:
    assert track_facts({1, 2, 3}, {2}) == {"objects with boxes": "3, of which 1 move"}
    assert track_facts(set(), set()) == {}
