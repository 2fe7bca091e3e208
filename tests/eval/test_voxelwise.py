from __future__ import annotations

import numpy as np
import pytest
from helpers.sections import plain
from helpers.worlds import room

from dynaviz.contracts.method import MethodInfo
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Scan
from dynaviz_eval.voxelwise import EDGE, VoxelwiseMetric

pytestmark = pytest.mark.boundscheck

INFO = MethodInfo("m", "M", "none", ())


def section(scans: list[Scan], answers: list[np.ndarray]) -> dict[str, float | None]:
    metric = VoxelwiseMetric(INFO)
    for frame, (scan, dynamic) in enumerate(zip(scans, answers, strict=True)):
        metric.update(Labelled.of(frame, scan, dynamic, np.zeros(len(scan), np.uint8)))
    return plain(metric.finish())["voxelwise"]


def test_agrees_with_sets_of_voxels() -> None:
    random = np.random.default_rng(3)
    scans = room(frames=4, rays=800).scans
    answers = [random.random(len(scan)) < 0.7 for scan in scans]
    static, dynamic, kept = set(), set(), set()
    for scan, answer in zip(scans, answers, strict=True):
        for point, label, removed in zip(scan.points, scan.labels, answer, strict=True):
            voxel = tuple(np.floor(point.astype(np.float64) * (1 / EDGE)).astype(int))
            (dynamic if label == 1 else static).add(voxel)
            if not removed:
                kept.add(voxel)
    dynamic -= static
    PR, RR = 100 * len(static & kept) / len(static), 100 * (1 - len(dynamic & kept) / len(dynamic))
    found = section(scans, answers)
    assert (found["static"], found["dynamic"]) == (len(static), len(dynamic))
    assert (found["PR"], found["RR"]) == pytest.approx((PR, RR))
    assert found["F1"] == pytest.approx(2 * PR * RR / (PR + RR))


def test_undefined_without_voxels() -> None:
    scan = room(frames=1, rays=50, labelled=False)[0]
    nothing = section([scan], [np.zeros(len(scan), bool)])
    assert (nothing["PR"], nothing["RR"], nothing["F1"]) == (None, None, None)


def scan_of(points: list[list[float]], labels: list[int]) -> Scan:
    return Scan(0, np.array(points, np.float32), np.eye(4), labels=np.array(labels, np.uint8))


def test_F1_needs_both_kinds_of_voxel() -> None:
    static, dynamic = (scan_of([[0, 0, 0]], [label]) for label in (0, 1))
    kept = [np.array([False])]
    assert [section([static], kept)[name] for name in ("PR", "RR", "F1")] == [100, None, None]
    assert [section([dynamic], kept)[name] for name in ("PR", "RR", "F1")] == [None, 0, None]


def test_all_correct_is_100() -> None:
    scan = scan_of([[0, 0, 0], [5, 0, 0]], [0, 1])
    found = section([scan], [np.array([False, True])])
    assert (found["PR"], found["RR"], found["F1"]) == (100, 100, 100)


def test_all_wrong_is_0() -> None:
    found = section([scan_of([[0, 0, 0], [5, 0, 0]], [0, 1])], [np.array([True, False])])
    assert (found["PR"], found["RR"], found["F1"]) == (0, 0, 0)


def test_points_without_a_position_or_label_do_not_count() -> None:
    scan = scan_of([[np.nan, 0, 0], [0, np.inf, 0], [0, 0, 0], [5, 0, 0]], [0, 1, 255, 1])
    found = section([scan], [np.zeros(4, bool)])
    assert (found["static"], found["dynamic"], found["dynamic_kept"]) == (0, 1, 1)


def test_the_points_of_a_cleaned_map_keep_voxels() -> None:
    metric = VoxelwiseMetric(INFO)
    metric.cleaned_map(np.array([[0.1, 0.1, 0.1]], np.float32))
    scan = scan_of([[0.05, 0.05, 0.05], [1, 0, 0], [5, 0, 0]], [0, 0, 1])
    metric.update(Labelled.of(0, scan, np.array([True, False, False]), np.zeros(3, np.uint8)))
    found = plain(metric.finish())["voxelwise"]
    assert (found["PR"], found["RR"]) == (50, 100)  # whatever the labels say
