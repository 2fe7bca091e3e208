"""The rays that touch a place, against a brute-force reference, and what they are counted as."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.worlds import pose

from dynaviz import kernels
from dynaviz.arrays import F64
from dynaviz.contracts.scan import Scan
from dynaviz.testing import InMemory
from dynaviz.views.witnesses import CROSSED, GRAZED, HIT, STRIPS, Place, find

STEPS = np.linspace(0, 1, 4001)


@pytest.mark.parametrize("one_origin", [True, False])
def test_touched_boxes_are_those_that_samples_along_the_rays_meet(one_origin: bool) -> None:
    random = np.random.default_rng(3)
    points = random.uniform(-5, 5, (150, 3)).astype(np.float32)
    points[:10, 1] = points[:10, 2] = 0  # parallel to axes
    origins = random.uniform(-5, 5, (1 if one_origin else len(points), 3))
    origins[:, 1:] = np.where(random.random((len(origins), 1)) < 0.3, 0, origins[:, 1:])
    low = random.uniform(-4, 2, (7, 3))
    high = low + random.uniform(0.3, 3, (7, 3))
    hit, crossed = kernels.witnesses.touched(points, origins, low, high)
    along = origins[:, None] + (points[:, None] - origins[:, None]) * STEPS[:, None]  # (N, samples, 3)
    for box in range(len(low)):
        inside = ((along >= low[box]) & (along <= high[box])).all(2)
        mine = inside.sum(1)
        expected = (mine > 0) & ~inside[:, -1] & ~inside[:, 0]
        found = crossed >> np.uint32(box) & 1 == 1
        np.testing.assert_array_equal(hit >> np.uint32(box) & 1 == 1, inside[:, -1])
        assert found[expected].all()
        between = found & ~expected  # it may cut a corner between two samples
        assert not mine[between].any()
        assert between.sum() <= 1


def test_rays_without_an_end_touch_nothing() -> None:
    points = np.full((2, 3), np.nan, np.float32)
    hit, crossed = kernels.witnesses.touched(points, np.zeros((1, 3)), np.full((1, 3), -9.0), np.full((1, 3), 9.0))
    assert not hit.any()
    assert not crossed.any()


def walls(x: float, sensor: F64) -> Scan:
    """Rays from a sensor to a grid on a wall at a distance."""
    y, z = np.meshgrid(np.linspace(-0.5, 0.5, 11), np.linspace(0.5, 1.5, 11))
    return Scan(0, np.stack([np.full(y.size, x), y.ravel(), z.ravel()], 1).astype(np.float32), sensor)


def test_hits_are_evidence_for_static_and_crossings_for_dynamic() -> None:
    sequence = InMemory(
        [walls(5.0, pose(0.0)), walls(9.0, pose(0.0)), walls(3.0, pose(0.0)), walls(999.0, pose(900.0))]
    )
    positions = np.array([scan.position for scan in sequence.scans])
    found, none = find(
        sequence, positions, [Place.of(sequence[0].points), Place.of(np.array([[0, 40, 0]], np.float32))]
    )
    assert found.rays == {HIT: 121, CROSSED: 121, GRAZED: 0}
    assert found.scans == {HIT: 1, CROSSED: 1, GRAZED: 0}
    assert found.searched == 3  # the last scan is too far away
    assert 0 < len(found.strips) <= STRIPS
    assert {int(k): int(f) for f, k in zip(found.frames, found.kinds, strict=True)} == {HIT: 0, CROSSED: 1}
    np.testing.assert_array_equal(found.strips[:, 0], np.broadcast_to(np.float32([0, 0, 1]), (len(found.strips), 3)))
    assert none.rays == dict.fromkeys((HIT, CROSSED, GRAZED), 0)
    assert "evidence for static" in found.text()
    assert "121 rays of 1 scan hit" in found.text()
    assert "No ray of 3 scans" in none.text()


def test_rays_along_the_ground_graze_it() -> None:
    x, y = np.meshgrid(np.linspace(9.5, 10.5, 9), np.linspace(-0.5, 0.5, 9))
    ground = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], 1).astype(np.float32)
    beyond = np.array([[14.0, 0.0, -0.2], [10.0, 0.0, -1.0]], np.float32)
    flat, steep = Scan(0, beyond[:1], pose(0.0, z=0.5)), Scan(1, beyond[1:], pose(10.0, z=2.0))
    sequence = InMemory([flat, steep])
    (found,) = find(sequence, np.array([scan.position for scan in sequence.scans]), [Place.of(ground)])
    assert found.rays == {HIT: 0, CROSSED: 1, GRAZED: 1}
    assert found.kinds.tolist() == [GRAZED, CROSSED]
    assert "50 % of them at less than 10°" in found.text()


def test_drawn_rays_are_spread_over_scans() -> None:
    sequence = InMemory([walls(5.0 if frame % 2 else 9.0, pose(0.0)) for frame in range(30)])
    positions = np.zeros((30, 3))
    (found,) = find(sequence, positions, [Place.of(sequence[1].points)])
    assert len(found.strips) == STRIPS
    assert (found.kinds == HIT).sum() == STRIPS // 2
    assert len(np.unique(found.frames)) == 30
