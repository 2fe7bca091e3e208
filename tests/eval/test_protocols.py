"""Each protocol against a plain count of the same points, one by one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dynaviz.contracts import registry
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.protocol import ProtocolScores
from dynaviz.contracts.scan import Scan

NAMES = {0: "unlabelled", 1: "outlier", 9: "static", 40: "road", 252: "moving car"}


def labelled_scans(frames: int = 3, n: int = 500, seed: int = 0) -> list[Labelled]:
    """Scans with every kind of point.

    Unlabelled ones, and the classes 0 and 1 with labels of the public benchmark.
    """
    random = np.random.default_rng(seed)
    scans = []
    for frame in range(frames):
        points = random.uniform(-25, 25, (n, 3)) * [1, 1, 0.05]
        points[: n // 2] *= 0.05  # dense, so that voxels contain several points
        classes = random.choice([0, 1, 9, 40, 252], n)
        labels = np.where(classes == 252, 1, 0)
        labels[(classes < 2) & (random.random(n) < 0.3)] = 1  # the recording car
        labels[random.random(n) < 0.1] = 255
        pose = np.eye(4)
        pose[:3, 3] = frame, 0.5, 1.0
        scan = Scan(frame, points, pose, labels=labels, classes=classes, class_names=NAMES)
        dynamic = random.random(n) < np.where(labels == 1, 0.7, 0.2)
        scans.append(Labelled.of(frame, scan, dynamic, np.zeros(n, np.uint8)))
    return scans


def score(name: str, scans: list[Labelled], scoring: str = "mask") -> ProtocolScores:
    protocol = registry.load("protocols", name)(scoring)
    for labelled in scans:
        protocol.update(labelled)
    found: ProtocolScores = protocol.finish()
    return found


def plain_iou(points: list[tuple[bool, bool]]) -> dict[str, float]:
    """IoU, precision and recall of (truth, answer) pairs, in percent."""
    tp = sum(truth and answer for truth, answer in points)
    fp = sum(answer and not truth for truth, answer in points)
    fn = sum(truth and not answer for truth, answer in points)
    return {
        "IoU": 100 * tp / (tp + fp + fn),
        "precision": 100 * tp / (tp + fp),
        "recall": 100 * tp / (tp + fn),
    }


@pytest.mark.parametrize("name", ["semantickitti_mos", "helimos"])
def test_iou_equals_a_plain_count(name: str) -> None:
    scans = labelled_scans()
    pairs = []
    for each in scans:
        rows = zip(each.scan.labels, each.scan.classes, each.dynamic, strict=True)
        pairs += [
            (label == 1, answer)
            for label, kind, answer in rows
            if label != 255 and kind not in (0, 1)
        ]
    found = score(name, scans).scores
    assert found == pytest.approx(plain_iou(pairs), abs=1e-6)
    every = [
        (a == 1, b)
        for s in scans
        for a, b in zip(s.scan.labels, s.dynamic, strict=True)
        if a != 255
    ]
    assert found["IoU"] != pytest.approx(
        plain_iou(every)["IoU"], abs=1e-3
    )  # classes 0 and 1 matter here


def test_doals_is_the_mean_over_labelled_scans_within_range() -> None:
    scans = labelled_scans()
    blank = Scan(9, scans[0].scan.points, np.eye(4), labels=np.full(500, 255))
    scans.insert(1, Labelled.of(9, blank, np.ones(500, bool), np.zeros(500, np.uint8)))
    found = score("doals", scans)
    plain = []
    for each in (scans[0], *scans[2:]):
        origin = each.scan.T_world_sensor[:3, 3]
        pairs = [
            (label == 1, answer)
            for point, label, kind, answer in zip(
                each.scan.points, each.scan.labels, each.scan.classes, each.dynamic, strict=True
            )
            if label != 255 and kind > 1 and 0.5 <= math.dist(point, origin) <= 20
        ]
        plain.append(plain_iou(pairs))
    assert found.counts["scans"] == 3
    for name in ("IoU", "precision", "recall"):
        assert found.scores[name] == pytest.approx(sum(each[name] for each in plain) / 3, abs=1e-6)


def test_a_scan_in_which_nothing_moves_or_is_predicted_counts_fully_in_doals() -> None:
    scan = Scan(0, np.full((3, 3), 2.0), np.eye(4), labels=np.zeros(3))
    quiet = Labelled.of(0, scan, np.zeros(3, bool), np.zeros(3, np.uint8))
    assert score("doals", [quiet]).scores["IoU"] == 100.0
    assert score("semantickitti_mos", [quiet]).scores["IoU"] is None


def test_the_public_benchmark_searches_the_map_of_kept_points() -> None:
    scans = labelled_scans()
    kept = np.concatenate([each.scan.points[~each.dynamic] for each in scans])
    counts = dict.fromkeys(("static_kept", "static_removed", "dynamic_removed", "dynamic_kept"), 0)
    for each in scans:
        for point, label in zip(each.scan.points, each.scan.labels, strict=True):
            if label != 255:
                removed = np.sqrt(((kept - point) ** 2).sum(1)).min() > np.float32(0.05)
                kind = "dynamic" if label == 1 else "static"
                counts[f"{kind}_{'removed' if removed else 'kept'}"] += 1
    found = score("benchmark", scans)
    assert found.counts == counts
    assert counts != score("points", scans).counts  # some removed points lie next to kept ones
    assert score("benchmark", scans, "nn") == score(
        "points", scans
    )  # labels of a map already follow the rule


def plain_voxels(scans: list[Labelled], edge: float) -> tuple[set, set, set]:
    static, dynamic, kept = set(), set(), set()
    for each in scans:
        for point, label, answer in zip(
            each.scan.points, each.scan.labels, each.dynamic, strict=True
        ):
            voxel = tuple(np.floor(point.astype(np.float64) * (1 / edge)).astype(int))
            if label != 255:
                (dynamic if label == 1 else static).add(voxel)
            if label != 255 and not answer:
                kept.add(voxel)
    return static, dynamic - static, kept


@pytest.mark.parametrize(("name", "edge"), [("freedom", 0.2), ("freedom_indoor", 0.1)])
def test_freedom_equals_sets_of_voxels(name: str, edge: float) -> None:
    scans = labelled_scans()
    static, dynamic, kept = plain_voxels(scans, edge)
    PR, RR = 100 * len(static & kept) / len(static), 100 * len(dynamic - kept) / len(dynamic)
    expected = {"F1": 2 * PR * RR / (PR + RR), "PR": PR, "RR": RR}
    assert score(name, scans).scores == pytest.approx(expected, abs=1e-6)


def plain_voxel_points(points: list[tuple[np.ndarray, bool]]) -> list[tuple[np.ndarray, bool]]:
    """The mean of the points of each voxel, with the label of the point nearest to it."""
    voxels: dict[tuple, list] = {}
    for point, moving in points:
        voxels.setdefault(tuple(np.floor(point * (1 / 0.2)).astype(int)), []).append(
            (point, moving)
        )
    reduced = []
    for members in voxels.values():
        mean = np.mean([point for point, _ in members], axis=0)
        reduced.append((mean, min(members, key=lambda member: ((member[0] - mean) ** 2).sum())[1]))
    return reduced


def test_erasor_equals_a_search_among_voxel_points() -> None:
    scans = labelled_scans(2, 150)
    rows = [
        (point.astype(np.float64), label == 1, not answer)
        for each in scans
        for point, label, answer in zip(
            each.scan.points, each.scan.labels, each.dynamic, strict=True
        )
        if label != 255
    ]
    whole = plain_voxel_points([(point, moving) for point, moving, _ in rows])
    cleaned = plain_voxel_points([(point, moving) for point, moving, kept in rows if kept])
    counts = {"static": 0, "static_kept": 0, "dynamic": 0, "dynamic_kept": 0}
    for mean, moving in whole:
        distance, label = min((math.dist(mean, other), label) for other, label in cleaned)
        kind = "dynamic" if moving else "static"
        counts[kind] += 1
        counts[f"{kind}_kept"] += distance < 0.1 * math.sqrt(3) and label == moving
    assert score("erasor", scans).counts == counts


@pytest.mark.parametrize("name", [handle.name for handle in registry.handles("protocols")])
def test_nothing_to_count_is_undefined(name: str) -> None:
    scan = Scan(0, np.ones((4, 3)), np.eye(4))
    nothing = [Labelled.of(0, scan, np.ones(4, bool), np.zeros(4, np.uint8))]
    for scans in ([], nothing):
        found = score(name, scans)
        assert tuple(found.scores) != ()
        assert set(found.scores.values()) == {None}
    info = registry.load("protocols", name).info
    assert (info.name, set(info.scores)) == (name, set(found.scores))


def test_sequences_are_combined_as_the_protocols_say() -> None:
    first, second = labelled_scans(2, seed=1), labelled_scans(3, 300, seed=2)
    for name in (
        "points",
        "semantickitti_mos",
        "doals",
    ):  # voxels of different sequences never coincide
        combine = registry.load("protocols", name).combine
        together = score(name, first + second).scores
        assert combine([score(name, first), score(name, second)]).scores == pytest.approx(together)
    parts = [score("helimos", first), score("helimos", second)]
    mean = (parts[0].scores["IoU"] + parts[1].scores["IoU"]) / 2
    assert registry.load("protocols", "helimos").combine(parts).scores["IoU"] == pytest.approx(mean)
    parts = [score("freedom", first), score("freedom", second)]
    voxels = {name: parts[0].counts[name] + parts[1].counts[name] for name in parts[0].counts}
    assert registry.load("protocols", "freedom").combine(parts).counts == voxels


def test_the_official_splits_of_semantickitti() -> None:
    splits = registry.load("protocols", "semantickitti_mos").info.splits
    assert {name: len(numbers) for name, numbers in splits.items()} == {
        "train": 10,
        "val": 1,
        "test": 11,
    }
    assert sorted(number for numbers in splits.values() for number in numbers) == [
        f"{k:02}" for k in range(22)
    ]
