"""Laws for any method, tested on every installed one.

NOT_MET lists the methods that break a law, and why.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from helpers.static_hall import PLACES, SENSOR, hall, seen_through

from dynaviz.arrays import Bool
from dynaviz.contracts import registry
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.scan import Label, Scan

METHODS = [handle.name for handle in registry.handles("methods")]
STILL = 6  # frames of a static world

DRAWS = (
    "the ground plane is the best of several planes through random points, which depend on the "
    "seed, the frame number "
    "and the order of the points (PCL's RANSAC): ground points at its border change, and with them "
    "the noise"
)
NOT_MET = {
    (
        "dynablox",
        "removed",
    ): "a voxel and all its neighbours must be observed as free for 6 frames before the box "
    "arrives: "
    "earlier boxes are kept, and so are boxes next to space that no ray crossed",
    (
        "freedom",
        "removed",
    ): "a voxel and all its neighbours must be crossed in 6 scans in a row, without a hit: parts "
    "of the box are kept",
    (
        "hmm_mos",
        "removed",
    ): "the first 6 of 10 scans are never labelled: the histories of their voxels are too short",
    (
        "octomap_gf",
        "removed",
    ): "points that are sparse in their scan count as noise and cast no ray, so too few rays cross "
    "the box",
    ("octomap_gf", "order"): DRAWS,
    ("octomap_gf", "numbers"): DRAWS,
}
"""By method and law: what the published algorithm does instead."""

SHARE = {"dufomap": 0.9}
"""The share of the box that a method must remove, if less than 0.99: DUFOMap needs rays through all
of 27 voxels."""

# share of points whose label may change, through rounding of sums and other random samples
ROUNDED = 5e-4


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


def test_a_box_that_rays_pass_through_is_removed(name: str) -> None:
    """The box is never in the same place twice.

    In at least four other scans, rays pass on all sides of the point.
    """
    through = through_box()
    assert through.sum() > 1000
    removed = np.concatenate(answers(name))[through].mean()
    assert removed > SHARE.get(name, 0.99), f"{100 * removed:.1f} % of the box removed"


def test_repeated_scans_of_a_static_hall_keep_it_still(name: str) -> None:
    """In a static world, repeated scans make no static point dynamic."""
    world = hall(STILL, box=False)
    once = np.concatenate(labels(name, world))
    again = [dataclasses.replace(scan, index=STILL + scan.index) for scan in world]
    for order in (
        world + again,
        [scan for pair in zip(world, again, strict=True) for scan in pair],
    ):
        more = labels(name, order)
        of_world = np.concatenate(
            [dynamic for scan, dynamic in zip(order, more, strict=True) if scan.index < STILL]
        )
        assert (of_world & ~once).sum() < ROUNDED * len(once), (
            f"{(of_world & ~once).sum()} points became dynamic"
        )


def test_labels_do_not_depend_on_point_order(name: str) -> None:
    random = np.random.default_rng(0)
    orders = [random.permutation(len(scan)) for scan in with_box()]
    mixed = [
        dataclasses.replace(s, points=s.points[k], labels=None)
        for s, k in zip(with_box(), orders, strict=True)
    ]
    changed = sum(
        (before[k] != after).sum()
        for before, after, k in zip(answers(name), labels(name, mixed), orders, strict=True)
    )
    assert not changed, f"{changed} labels changed with the order of points"


def test_labels_do_not_depend_on_stamps_and_frame_numbers(name: str) -> None:
    renamed = [
        dataclasses.replace(scan, index=5000 - 7 * scan.index, stamp_ns=None) for scan in with_box()
    ]
    changed = sum((a != b).sum() for a, b in zip(answers(name), labels(name, renamed), strict=True))
    assert not changed, f"{changed} labels changed with the numbers of frames"


def test_the_hall_has_one_moving_box() -> None:
    """The box is in another place in every frame, and the rest is static."""
    boxes = [scan.points[scan.labels == Label.DYNAMIC] for scan in with_box()]
    assert len(boxes) == PLACES
    assert min(map(len, boxes)) > 100
    middles = np.array([box.mean(0) for box in boxes])
    apart = np.linalg.norm(middles[:, None] - middles[None], axis=-1) + 9 * np.eye(PLACES)
    assert apart.min() > 2.0
    assert not any((scan.labels == Label.DYNAMIC).any() for scan in hall(2, box=False))
