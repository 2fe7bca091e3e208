"""What objects and places did: each word, at the bounds of its rule."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.failure_cases import INFO, section
from helpers.sections import plain

from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Scan
from dynaviz.scores.behaviour import Behaviour
from dynaviz_eval.behaviour import (
    Objects,
    VisitedPlaces,
    behaviour_of_object,
    behaviour_of_place,
    shift,
    standing,
)
from dynaviz_eval.cases import Cases, summed
from dynaviz_eval.failures import FailuresMetric

pytestmark = pytest.mark.boundscheck

ROW = Cases(1, np.inf).kind
CASE = summed(np.empty(0, ROW)).dtype


def track(x: Any, first: int = 0, **fields: Any) -> np.ndarray:
    """One row per frame of an object of 4 x 2 m, whose rear end is at x metres."""
    rows = np.zeros(len(x), ROW)
    rows["frame"], rows["points"], rows["ranges"] = np.arange(first, first + len(x)), 10, 100
    rows["low"][:, 0], rows["high"] = x, (4, 2, 1.5)
    rows["high"][:, 0] += np.asarray(x, np.float32)
    for name, value in fields.items():
        rows[name] = value
    return rows


DRIVE, STAND = np.arange(30.0), np.zeros(20)


@pytest.mark.parametrize(
    ("x", "first", "fields", "expected"),
    [
        (DRIVE, 0, {}, Behaviour.PASSED_BY),
        (np.append(DRIVE, STAND + 29), 0, {}, Behaviour.CAME_TO_STOP),
        (np.append(DRIVE[10:], STAND + 29), 0, {}, Behaviour.STOOD),
        (STAND, 0, {}, Behaviour.STOOD),
        (np.append(STAND, DRIVE), 0, {}, Behaviour.WAITED_FIRST),
        (np.concatenate([DRIVE, STAND + 29, DRIVE + 30]), 0, {}, Behaviour.STOPPED),
        (DRIVE[:10], 90, {}, Behaviour.END_OF_DRIVE),
        (DRIVE[:25], 75, {}, Behaviour.ARRIVED_LATE),
        (DRIVE[:25], 74, {}, Behaviour.PASSED_BY),
        (DRIVE[:14], 75, {}, Behaviour.PASSED_BY),
        (DRIVE, 0, {"ranges": 301}, Behaviour.FAR_AWAY),
        (DRIVE, 0, {"ranges": 300}, Behaviour.PASSED_BY),
        (DRIVE, 0, {"touching": 6}, Behaviour.TOUCHED),
        (DRIVE, 0, {"touching": 5}, Behaviour.PASSED_BY),
        (DRIVE[:2], 0, {}, Behaviour.PASSED_BY),
        (DRIVE[:1], 0, {}, None),
        (DRIVE[:1], 0, {"touching": 6}, Behaviour.TOUCHED),
    ],
)
def test_what_an_object_did(x, first, fields, expected):
    assert behaviour_of_object(track(x, first, **fields), 99) is expected


ROUTE = np.concatenate([STAND, DRIVE, STAND + 29, DRIVE + 30, STAND + 59])


@pytest.mark.parametrize(
    ("frames", "expected"),
    [
        ((2, 9), Behaviour.WAITED_FIRST),
        ((25, 45), Behaviour.PASSED_BY),
        ((25, 60), Behaviour.STOPPED),
        ((52, 68), Behaviour.STOPPED),
        ((75, 95), Behaviour.PASSED_BY),
        ((75, 119), Behaviour.CAME_TO_STOP),
        ((85, 119), Behaviour.STOOD),
        ((110, 112), Behaviour.STOOD),
    ],
)
def test_what_an_object_did_in_some_frames(frames, expected):
    assert behaviour_of_object(track(ROUTE), 200, frames) is expected


def test_an_object_moves_only_if_both_ends_of_its_box_do():
    rows = track(STAND)
    rows["high"][:, 0] += np.arange(20)  # the sensor drives past and sees more and more of it
    assert shift(rows[0], rows[-1]) == 0
    assert standing(rows).all()
    rows["low"][:, 0] += 0.06 * np.arange(20)  # 0.6 m in ten frames
    assert shift(rows[0], rows[10]) == pytest.approx(0.6)
    assert not standing(rows).any()


@pytest.mark.parametrize(
    ("visits", "fields", "expected"),
    [
        ([0, 99, 100], {}, Behaviour.IN_VIEW),
        ([0, 99, 50], {}, Behaviour.IN_VIEW),
        ([0, 99, 49], {}, Behaviour.ON_AND_OFF),
        ([20, 24, 5], {}, Behaviour.SEEN_BRIEFLY),
        ([75, 99, 25], {}, Behaviour.SEEN_LATE),
        ([74, 99, 26], {}, Behaviour.IN_VIEW),
        ([0, 99, 100], {"ranges": 3001}, Behaviour.FAR_AWAY),
        ([0, 99, 100], {"touching": 51}, Behaviour.NEXT_TO_MOVER),
        ([0, 99, 100], {"touching": 50}, Behaviour.IN_VIEW),
    ],
)
def test_how_a_place_was_seen(visits, fields, expected):
    case = np.zeros((), CASE)
    for name, value in {"points": 100, "ranges": 1000, **fields}.items():
        case[name] = value
    assert behaviour_of_place(case, np.array([visits], np.int32), 99) is expected


def test_a_place_without_hits_is_unknown():
    case = np.zeros((), CASE)
    case["points"] = 1
    assert behaviour_of_place(case, np.empty((0, 3), np.int32), 99) is None


def test_places_remember_when_their_cells_were_hit():
    rng, places, expected = np.random.default_rng(3), VisitedPlaces(), {}
    for frame in range(6):
        points = rng.uniform(-40, 40, (14_000, 3)).astype(np.float32)
        points[rng.choice(14_000, 50)] = np.nan
        points[0] = 1e9
        for cell in set(
            map(tuple, np.floor(points[np.isfinite(points).all(1)][1:]).astype(int).tolist())
        ):
            first, _, frames = expected.get(cell, (frame, 0, 0))
            expected[cell] = first, frame, frames + 1
        places.add(frame, Scan(frame, points, np.eye(4)).points)
    whole = places.visits(np.full(3, -50.0), np.full(3, 50.0))
    assert sorted(map(tuple, whole.tolist())) == sorted(expected.values())
    cell = next(iter(expected))
    (found,) = places.visits(np.array(cell) + 0.1, np.array(cell) + 0.9).tolist()
    assert tuple(found) == expected[cell]


def scene(frame: int, car: float, caught: bool, instances: bool) -> Labelled:
    """A road with a car of which the method removes everything or half, and a wall next to it from
    frame 30 on.
    """
    rng = np.random.default_rng(frame)
    road = rng.uniform([-10, -5, 0], [60, 5, 0.02], (3000, 3))
    body = rng.uniform([car, -1, 0.3], [car + 4, 1, 1.5], (200, 3))
    points = np.concatenate([road, body])
    labels = np.repeat([0, 1], [3000, 200])
    dynamic = labels == 1
    dynamic[3000:] = caught | (points[3000:, 0] > car + 2)
    fields = (
        {"classes": 10 * labels, "instances": 7 * labels, "class_names": {10: "car"}}
        if instances
        else {}
    )
    scan = Scan(frame, points, np.eye(4), labels=labels.astype(np.uint8), **fields)
    return Labelled.of(frame, scan, dynamic, np.where(labels == 1, 1, 0).astype(np.uint8))


@pytest.mark.parametrize("instances", [True, False])
def test_the_motion_in_the_frames_of_a_case_counts(instances):
    frames = [scene(f, min(f, 20.0), caught=f > 8, instances=instances) for f in range(45)]
    (case,) = section(*frames)["cases"]
    assert (case["last_frame"], case["behaviour"]) == (8, "passed by")
    assert case["what"] == ("car" if instances else "moving object")
    assert ("car 7, 9 frames" in case["sentence"]) == instances


def test_an_object_touches_what_stands_next_to_it_but_not_the_road_or_a_bridge():
    def behaviour(low: float, high: float) -> str:
        objects = Objects()
        for frame in range(8):
            rng = np.random.default_rng(frame)
            car = rng.uniform([2.0 * frame, 0, 0.3], [2.0 * frame + 1, 0.4, 1.5], (50, 3))
            wall = rng.uniform([-2, 0.5, low], [20, 0.9, high], (4000, 3))
            points, labels = (
                np.concatenate([car, wall]),
                np.repeat([1, 0], [50, 4000]).astype(np.uint8),
            )
            scan = Scan(frame, points, np.eye(4), labels=labels, instances=labels)
            labelled = Labelled.of(frame, scan, np.zeros(4050, np.bool_), np.zeros(4050, np.uint8))
            objects.add(labelled, scan.points[:, 2])
        objects.finish()
        row = objects._cases.rows[0]
        return str(objects.behaviour(objects._cases.rows[:1])) if row["points"] else ""

    assert behaviour(0.3, 2) == "touched something"
    assert behaviour(0, 0.2) == behaviour(3.1, 5) == "passed by"


def test_without_heights_the_ground_is_unknown():
    metric = FailuresMetric(INFO)
    labelled = scene(0, 5.0, caught=False, instances=False)
    metric.add(labelled, 3000, 200)
    (case,) = plain(metric.finish())["failures"]["cases"]
    assert case["ground"] is None
