"""Records on disk in sorted runs.

Intervals cover each once, and metrics that use them give the same numbers.
"""

from __future__ import annotations

import numpy as np
from helpers.sections import plain
from helpers.worlds import room

from dynaviz.contracts.method import MethodInfo
from dynaviz.contracts.metric import Labelled
from dynaviz_eval.behaviour import VisitedPlaces
from dynaviz_eval.sorted_runs import SortedRuns
from dynaviz_eval.voxelwise import VoxelwiseMetric

RECORD = np.dtype([("key", np.int64), ("value", np.int32)])


def test_intervals_contain_each_record_once_and_equal_keys_together() -> None:
    random, runs, whole = np.random.default_rng(0), SortedRuns(RECORD), []
    for count in (5000, 1, 0, 3000):
        records = np.empty(count, RECORD)
        records["key"], records["value"] = (
            random.integers(0, 2000, count),
            random.integers(0, 9, count),
        )
        runs.append(records)
        whole.append(records)
    expected = np.sort(np.concatenate(whole))
    assert len(runs) == len(expected)
    parts = [runs.between(*interval) for interval in runs.intervals(2000)]
    assert len(parts) > 2
    assert (np.sort(np.concatenate(parts)) == expected).all()
    assert sum(len(np.unique(part["key"])) for part in parts) == len(np.unique(expected["key"]))
    inside = expected[(expected["key"] >= 700) & (expected["key"] < 703)]
    assert (np.sort(runs.between(700, 703)) == inside).all()


def test_voxels_on_disk_are_counted_like_those_in_memory() -> None:
    random, info = np.random.default_rng(1), MethodInfo("m", "M", "none", ())
    metrics = [VoxelwiseMetric(info), VoxelwiseMetric(info, held=300)]
    for frame, scan in enumerate(room(frames=6, rays=800).scans):
        labelled = Labelled.of(
            frame, scan, random.random(len(scan)) < 0.3, np.zeros(len(scan), np.uint8)
        )
        for metric in metrics:
            metric.update(labelled)
    whole, stored = (plain(metric.finish())["voxelwise"] for metric in metrics)
    assert stored == whole
    assert whole["dynamic"] > 0


def test_places_on_disk_remember_like_those_in_memory() -> None:
    places = [VisitedPlaces(), VisitedPlaces(held=100)]
    for frame, scan in enumerate(room(frames=6, rays=800).scans):
        for each in places:
            each.add(frame, scan.points)
    low, high = np.float32([-5, -20, -2]), np.float32([3, 20, 2])
    whole, stored = (np.sort(each.visits(low, high), axis=0) for each in places)
    assert len(whole) > 50
    assert (stored == whole).all()
