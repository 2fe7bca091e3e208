"""Removed points by reason, range and frame, and clusters where there is no ground truth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.failure_cases import INFO
from helpers.sections import plain

from dynaviz.contracts.metric import FrameBoxes, Labelled
from dynaviz.contracts.scan import Outcome, Scan
from dynaviz.scores.sections import Sections
from dynaviz_eval.removals import RemovalsMetric

pytestmark = pytest.mark.boundscheck


def measured(*frames: Labelled) -> tuple[dict[str, Any], RemovalsMetric]:
    """The section of these frames, which is plain JSON and opens as a typed section.

    And the metric.
    """
    metric = RemovalsMetric(INFO)
    for frame in frames:
        assert metric.update(frame) == {}
    section = plain(metric.finish())
    typed = Sections.of(section).removals
    assert typed is not None
    assert len(typed.clusters) == len(section["removals"].get("clusters", ()))
    return dict(section["removals"]), metric


def street(frame: int) -> Labelled:
    """A road and a wall, of each a patch removed, and a removed car that drives.

    The ground truth is unknown.
    """
    rng = np.random.default_rng(frame)
    road = rng.uniform([-20, -5, 0], [40, 5, 0.03], (6000, 3))
    wall = rng.uniform([-20, 6, 0], [40, 6.3, 4], (6000, 3))
    car = rng.uniform([frame / 2, -1, 0.4], [frame / 2 + 4, 1, 1.5], (400, 3))
    points = np.concatenate([road, wall, car])
    patch = (points[:, 0] > 0) & (points[:, 0] < 8) & (np.abs(points[:, 1] - 3) < 1)
    hole = (points[:, 0] > 20) & (points[:, 0] < 22) & (points[:, 1] > 6) & (points[:, 2] > 2)
    dynamic = patch | hole | (np.arange(len(points)) >= 12000)
    reasons = np.where(hole, 1, 0).astype(np.uint8)
    return Labelled.of(
        frame, Scan(100 + frame, points.astype(np.float32), np.eye(4)), dynamic, reasons
    )


@pytest.fixture(scope="module")
def without_truth() -> tuple[dict[str, Any], RemovalsMetric]:
    return measured(*map(street, range(25)))


def test_removed_points_are_counted_by_reason_range_and_frame():
    points = np.array([[x, 0, 0] for x in (1, 10, 19, 20, 49, 50, np.nan)], np.float32)
    scan = Scan(7, points, np.eye(4), labels=np.zeros(7, np.uint8))
    removed = np.array([True, True, False, True, False, True, True])
    section, metric = measured(
        Labelled.of(0, scan, removed, np.array([1, 0, 0, 1, 0, 99, 1], np.uint8))
    )
    assert (section["points"], section["removed"]) == (7, 5)
    assert list(section["reasons"].items()) == [
        ("never_crossed", 3),
        ("crossed", 1),
        ("unknown code", 1),
    ]
    assert [tuple(row.values()) for row in section["range"]] == [
        (0.0, 10.0, 1, 1), (10.0, 20.0, 2, 1), (20.0, 30.0, 1, 1), (30.0, 50.0, 1, 0),
        (50.0, None, 2, 2),
    ]  # fmt: skip
    assert section["frame"] == [{"frame": 0, "index": 7, "points": 7, "removed": 5}]
    assert section["clusters"] == []
    assert metric.figures() == {}


def test_a_static_surface_looks_suspicious_and_a_mover_does_not(without_truth):
    clusters = {cluster["what"]: cluster for cluster in without_truth[0]["clusters"]}
    road, car = clusters["ground"], clusters["moving car-sized object"]
    hole = next(
        cluster for cluster in without_truth[0]["clusters"] if "never_crossed" in cluster["reasons"]
    )
    assert without_truth[0]["clusters"][0] is road
    assert road["suspicion"] > hole["suspicion"] > 2 * car["suspicion"]
    assert road["why"][0] == "ground"
    assert "stays at one place for 25 frames" in hole["why"]
    assert (road["ground"], hole["ground"], car["why"]) == (1.0, 0.0, [])
    assert road["kept_near"] > 0.3
    assert "Suspicious: ground, " in road["sentence"]
    assert car["sentence"].endswith("Moves as movers do.")
    assert car["moved"] == pytest.approx(
        11, abs=0.3
    )  # from its first three frames to its last three


def test_clusters_contain_all_removed_points_and_have_boxes(without_truth):
    section, metric = without_truth
    listed = sum(cluster["points"] for cluster in section["clusters"])
    assert listed + section["others"]["points"] == section["removed"]
    boxes = metric.figures()["clusters"]
    assert isinstance(boxes, FrameBoxes)
    assert set(boxes.outcomes.tolist()) == {Outcome.UNLABELLED_REMOVED}
    assert len(boxes.labels) == len(section["clusters"])
    np.testing.assert_allclose(boxes.low[0], section["clusters"][0]["low"])


def test_a_labelled_point_in_any_frame_means_that_there_is_ground_truth():
    scan = street(1).scan
    labels = np.full(len(scan), 255, np.uint8)
    nothing = np.zeros(len(scan), np.uint8)
    for first, clusters in ((255, True), (0, False)):
        labels[0] = first
        last = Scan(1, scan.points, np.eye(4), labels=labels)
        section, _ = measured(street(0), Labelled.of(1, last, nothing.astype(np.bool_), nothing))
        assert bool(section["clusters"]) == clusters


def test_nothing_removed():
    scan = street(0).scan
    section, metric = measured(
        Labelled.of(0, scan, np.zeros(len(scan), np.bool_), np.zeros(len(scan), np.uint8))
    )
    assert (section["removed"], section["reasons"], section["clusters"]) == (0, {}, [])
    assert metric.figures() == {}
