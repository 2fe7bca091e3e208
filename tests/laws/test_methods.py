"""Laws that any method should keep to, tried on every one that is installed; and which break which, and why."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from helpers.static_hall import PLACES, SENSOR, hall, seen_through

from dynaviz import registry
from dynaviz.arrays import Bool
from dynaviz.method import Context
from dynaviz.scan import Label, Scan
from dynaviz.spatial.extent import Extent

METHODS = [handle.name for handle in registry.handles("methods")]
STILL = 6  # frames of a world in which nothing moves

DRAWS = (
    "the ground plane is the best of planes through points that are drawn at random, by seed, frame number and place "
    "in the scan (PCL's RANSAC): points at its rim change sides, and with them what the filter takes for noise"
)
NOT_MET = {
    (
        "dynablox",
        "removed",
    ): "space must have been seen free for 6 frames, with all its neighbours, before the box comes: "
    "what came earlier stays, and so does what floats beside space that no ray ever crossed",
    (
        "octomap_gf",
        "removed",
    ): "points that are sparse in their scan count as noise and cast no ray: too few rays are left "
    "to wear the box away",
    ("octomap_gf", "order"): DRAWS,
    ("octomap_gf", "numbers"): DRAWS,
}
"""By method and law: what the published algorithm does instead."""

SHARE = {"dufomap": 0.9}
"""What part of the box a method must remove, where that is not nearly all: DUFOMap wants each of 27 voxels crossed."""

ROUNDED = (
    5e-4  # share of points that may change sides, for other sums round otherwise and other draws find other planes
)


def labels(name: str, scans: list[Scan]) -> list[Bool]:
    """The answers of a method with its default parameters."""
    kind = registry.load("methods", name)
    running, bare = kind(kind.Params()), [scan.without_truth() for scan in scans]
    raw_map = np.concatenate([scan.points for scan in bare]) if kind.info.needs_map else None
    running.begin(Context(Extent.of(*bare), SENSOR, raw_map=raw_map))
    for scan in bare:
        running.observe(scan)
    return [running.label(scan).dynamic.copy() for scan in bare]


@cache
def with_box() -> list[Scan]:
    return hall()


@cache
def through_box() -> Bool:
    return seen_through(with_box())


@cache
def answers(name: str) -> list[Bool]:
    """The answers for the hall with the box."""
    return labels(name, with_box())


@pytest.fixture(params=METHODS)
def name(request: pytest.FixtureRequest) -> Any:
    law = request.function.__name__.rpartition("_")[2]
    if (request.param, law) in NOT_MET:
        reason = NOT_MET[request.param, law]
        request.applymarker(pytest.mark.xfail(raises=AssertionError, strict=True, reason=reason))
    return request.param


def test_a_box_that_is_seen_through_is_removed(name: str) -> None:
    """It is never twice in the same place, and in four or more other scans rays pass on all sides of the point."""
    through = through_box()
    assert through.sum() > 1000
    removed = np.concatenate(answers(name))[through].mean()
    assert removed > SHARE.get(name, 0.99), f"{100 * removed:.1f} % of the box removed"


def test_more_of_the_same_makes_nothing_dynamic_still(name: str) -> None:
    """Where nothing moves, seeing every scan again tells nothing new."""
    world = hall(STILL, box=False)
    once = np.concatenate(labels(name, world))
    again = [dataclasses.replace(scan, index=STILL + scan.index) for scan in world]
    for order in (world + again, [scan for pair in zip(world, again, strict=True) for scan in pair]):
        more = labels(name, order)
        of_world = np.concatenate([dynamic for scan, dynamic in zip(order, more, strict=True) if scan.index < STILL])
        assert (of_world & ~once).sum() < ROUNDED * len(once), f"{(of_world & ~once).sum()} points became dynamic"


def test_points_have_their_labels_in_any_order(name: str) -> None:
    random = np.random.default_rng(0)
    orders = [random.permutation(len(scan)) for scan in with_box()]
    mixed = [dataclasses.replace(s, points=s.points[k], labels=None) for s, k in zip(with_box(), orders, strict=True)]
    changed = sum(
        (before[k] != after).sum() for before, after, k in zip(answers(name), labels(name, mixed), orders, strict=True)
    )
    assert not changed, f"{changed} labels changed with the order of points"


def test_frames_may_have_any_stamps_and_numbers(name: str) -> None:
    renamed = [dataclasses.replace(scan, index=5000 - 7 * scan.index, stamp_ns=None) for scan in with_box()]
    changed = sum((a != b).sum() for a, b in zip(answers(name), labels(name, renamed), strict=True))
    assert not changed, f"{changed} labels changed with the numbers of frames"


def test_the_hall_is_what_it_says() -> None:
    """The box is somewhere else in every frame, and the rest is static."""
    boxes = [scan.points[scan.labels == Label.DYNAMIC] for scan in with_box()]
    assert len(boxes) == PLACES
    assert min(map(len, boxes)) > 100
    middles = np.array([box.mean(0) for box in boxes])
    apart = np.linalg.norm(middles[:, None] - middles[None], axis=-1) + 9 * np.eye(PLACES)
    assert apart.min() > 2.0
    assert not any((scan.labels == Label.DYNAMIC).any() for scan in hall(2, box=False))
