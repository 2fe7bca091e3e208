from __future__ import annotations

import numpy as np
import pytest
from worlds import room

from dynaviz.method import MethodInfo
from dynaviz.metric import Labelled
from dynaviz.scan import Scan
from dynaviz_eval.voxelwise import EDGE, Voxelwise

INFO = MethodInfo("m", "M", "none", ())


def section(scans: list[Scan], answers: list[np.ndarray]) -> dict[str, float | None]:
    metric = Voxelwise(INFO)
    for frame, (scan, dynamic) in enumerate(zip(scans, answers, strict=True)):
        metric.update(Labelled.of(frame, scan, dynamic, np.zeros(len(scan), np.uint8)))
    return metric.finish()["voxelwise"]


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


def test_undefined_where_there_is_nothing_to_count() -> None:
    scan = room(frames=1, rays=50, labelled=False)[0]
    nothing = section([scan], [np.zeros(len(scan), bool)])
    assert (nothing["PR"], nothing["RR"], nothing["F1"]) == (None, None, None)
