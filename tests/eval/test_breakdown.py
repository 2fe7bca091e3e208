"""Counts by range, height, frame and object."""

import itertools
import json

import numpy as np
import pytest
from helpers.sections import plain

from dynaviz.scores.scores import Counts
from dynaviz_eval.breakdown import BreakdownMetric

pytestmark = pytest.mark.boundscheck

COUNTED = ("static_kept", "static_removed", "dynamic_removed", "dynamic_kept", "unlabelled")


def breakdown(info, *labelled):
    metric = BreakdownMetric(info)
    for each in labelled:
        metric.update(each)
    section = plain(metric.finish())["breakdown"]
    json.dumps(section, allow_nan=False)
    return section


def test_every_list_adds_up_to_the_total(info, make_labelled):
    frames = [make_labelled(k, instances=np.ones(400)) for k in range(3)]
    total = sum((Counts.of(f.outcome) for f in frames), Counts())
    section = breakdown(info, *frames)
    for part in ("range", "height", "frame", "object"):
        for name in COUNTED:
            assert sum(row[name] for row in section[part]) == getattr(total, name)
    assert [(row["frame"], row["index"]) for row in section["frame"]] == [(0, 50), (1, 51), (2, 52)]
    assert section["frame"][0]["SA"] == Counts.of(frames[0].outcome).SA


@pytest.mark.plain
def test_ranges_are_from_the_sensor_and_include_their_lower_edge(info, make_labelled):
    pose = np.eye(4)
    pose[:3, 3] = 1000, 0, 0
    points = [[1000 + r, 0, 0] for r in (0, 9.99, 10, 20, 30, 50, 500)]
    section = breakdown(
        info,
        make_labelled(0, points=points, labels=[0] * 7, dynamic=[False] * 7, T_world_sensor=pose),
    )
    assert [(row["from"], row["to"]) for row in section["range"]] == [
        (0, 10),
        (10, 20),
        (20, 30),
        (30, 50),
        (50, None),
    ]
    assert [row["static_kept"] for row in section["range"]] == [2, 1, 1, 1, 2]


def test_ranges_use_each_points_own_origin(info, make_labelled):
    origins = np.array([[0, 0, 0], [40, 0, 0]])
    points = np.full((2, 3), [41.0, 0, 0])
    section = breakdown(
        info,
        make_labelled(0, points=points, labels=[0, 0], dynamic=[False, False], origins=origins),
    )
    assert [row["static_kept"] for row in section["range"]] == [1, 0, 0, 1, 0]


def test_ranges_are_three_dimensional(info, make_labelled):
    points = np.array(
        [[0, 12, 16], [24, 0, 32], [6, 8, 0], [-3, -4, -12]]
    )  # 20, 40, 10 and 13 m away
    section = breakdown(info, make_labelled(0, points=points, labels=[0] * 4, dynamic=[False] * 4))
    assert [row["static_kept"] for row in section["range"]] == [0, 2, 1, 1, 0]


@pytest.mark.plain
def test_heights_include_their_lower_edge(info, make_labelled):
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(-3, 3, 0.2), np.arange(-3, 3, 0.2)))
    z = np.array([-1, 0.19, 0.2, 0.5, 1, 1.9, 2, 4, 9])
    points = np.concatenate([np.c_[x, y, 0 * x], np.c_[np.full((len(z), 2), 0.5), z]])
    labels = [0] * len(points)
    section = breakdown(
        info, make_labelled(0, points=points, labels=labels, dynamic=[False] * len(points))
    )
    edges = [None, 0.2, 0.5, 1, 2, 4, None]
    assert [(row["from"], row["to"]) for row in section["height"]] == list(
        itertools.pairwise(edges)
    )
    assert [row["static_kept"] for row in section["height"]] == [len(x) + 2, 1, 1, 2, 1, 2]


def test_points_without_coordinates_count_in_the_last_bin(info, make_labelled):
    points = np.array([[np.nan, 0, 0], [1, 0, 0]])
    section = breakdown(info, make_labelled(0, points=points, labels=[0, 0], dynamic=[True, False]))
    assert section["range"][-1]["static_removed"] == section["height"][-1]["static_removed"] == 1


def test_objects_are_sorted_by_missed_points(info, make_labelled):
    def scan(frame, dynamic):
        return make_labelled(
            frame,
            points=np.zeros((6, 3)),
            labels=[1, 1, 1, 1, 0, 0],
            instances=[7, 7, 9, 9, 11, 0],
            classes=[252, 252, 254, 254, 10, 40],
            dynamic=dynamic,
        )

    rows = breakdown(info, scan(0, [1, 1, 1, 0, 0, 0]), scan(4, [1, 0, 0, 0, 0, 1]))["object"]
    assert [
        (row["class"], row["instance"], row["dynamic_kept"], row["points"]) for row in rows
    ] == [
        (254, 9, 3, 4),
        (252, 7, 1, 4),
    ]  # a parked car is not listed
    assert rows[0]["DA"] == 25
    assert (rows[0]["first_frame"], rows[0]["last_frame"]) == (0, 4)


def test_classes_without_instances_make_objects(info, make_labelled):
    labelled = make_labelled(
        0, points=np.zeros((3, 3)), labels=[1, 1, 0], classes=[252, 254, 40], dynamic=[1, 0, 0]
    )
    rows = breakdown(info, labelled)["object"]
    assert [(row["class"], row["instance"], row["DA"]) for row in rows] == [
        (254, 0, 0),
        (252, 0, 100),
    ]


def test_an_object_that_stops_keeps_its_row_and_its_frames(info, make_labelled):
    def scan(frame, label, instance=7):
        return make_labelled(
            frame,
            points=np.zeros((2, 3)),
            labels=[label] * 2,
            instances=[instance] * 2,
            dynamic=[True, False],
        )

    (row,) = breakdown(info, *(scan(frame, label) for frame, label in ((1, 1), (2, 0), (4, 0))))[
        "object"
    ]
    assert (row["first_frame"], row["last_frame"], row["points"]) == (1, 4, 6)
    assert [row[name] for name in COUNTED] == [2, 2, 1, 1, 0]


def test_objects_with_equal_misses_are_sorted_by_number(info, make_labelled):
    classes, instances = [5, 5, 3, 4], [2, 1, 9, 9]
    labelled = make_labelled(
        0,
        points=np.zeros((4, 3)),
        labels=[1] * 4,
        classes=classes,
        instances=instances,
        dynamic=[False] * 3 + [True],
    )
    rows = breakdown(info, labelled)["object"]
    assert [(row["class"], row["instance"]) for row in rows] == [(3, 9), (5, 1), (5, 2), (4, 9)]


def test_objects_need_truth(info, make_labelled):
    known = make_labelled(0, labels=None, instances=np.ones(400), dynamic=np.zeros(400, bool))
    assert breakdown(info, known)["object"] == []
    assert breakdown(info, make_labelled(0))["object"] == []  # labels without classes or instances


def test_no_objects_without_truth(info, make_labelled):
    assert (
        breakdown(info, make_labelled(0, labels=None, dynamic=np.zeros(400, bool)))["object"] == []
    )
