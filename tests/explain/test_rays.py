"""The rays that touch boxes, against a brute-force reference, and those that are drawn."""

from __future__ import annotations

import numpy as np
import pytest

from dynaviz import kernels
from dynaviz.colours import CROSSED, GRAZED, HIT
from dynaviz.contracts.method import Reason
from dynaviz.explain.point_ledger import LedgerEntry, PointLedger
from dynaviz.explain.rays import rays_of

pytestmark = pytest.mark.plain

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
    starts = np.array([0, 3, 3, 7])
    rays, boxes, ends = kernels.witnesses.touched(points, origins, starts, low, high)
    hit, crossed = np.zeros((2, len(low), len(points)), np.bool_)
    hit[boxes[ends], rays[ends]] = crossed[boxes[~ends], rays[~ends]] = True
    # (N, samples, 3)
    along = origins[:, None] + (points[:, None] - origins[:, None]) * STEPS[:, None]
    for box in range(len(low)):
        inside = ((along >= low[box]) & (along <= high[box])).all(2)
        mine = inside.sum(1)
        expected = (mine > 0) & ~inside[:, -1] & ~inside[:, 0]
        found = crossed[box]
        np.testing.assert_array_equal(hit[box], inside[:, -1])
        assert found[expected].all()
        between = found & ~expected  # it may cut a corner between two samples
        assert not mine[between].any()
        assert between.sum() <= 1


def test_rays_without_an_end_touch_nothing() -> None:
    points = np.full((2, 3), np.nan, np.float32)
    low = np.full((1, 3), -9.0)
    rays, *_ = kernels.witnesses.touched(points, np.zeros((1, 3)), np.array([0, 1]), low, -low)
    assert not len(rays)


def entry(frame: int, hits: int, crossed: int, angle: float | None = None) -> LedgerEntry:
    """A scan seen from the origin, with the point 10 m away."""
    behind = 5.0 if crossed else None
    return LedgerEntry(
        frame, frame, (0.0, 0.0, 0.0), 10.0, angle, hits, crossed, behind, {}, {}, (), None
    )


def ledger(*entries: LedgerEntry) -> PointLedger:
    reason = Reason("kept", "kept: no")
    return PointLedger(0, 0, 0, (10.0, 0.0, 0.0), "static", False, reason, None, (), (), entries, 9)


def test_hits_end_at_the_point_and_crossings_beyond_it() -> None:
    found = rays_of(
        [ledger(entry(0, 3, 0), entry(1, 0, 2, 45.0), entry(2, 0, 1, 9.0), entry(3, 1, 1))]
    )
    assert found.frames.tolist() == [0, 1, 2, 3, 3]
    assert found.kinds.tolist() == [HIT, CROSSED, GRAZED, HIT, CROSSED]
    np.testing.assert_array_equal(found.strips[:, 0], np.zeros((5, 3)))
    assert found.strips[:, 1, 0].tolist() == [10.0, 15.0, 15.0, 10.0, 15.0]


def test_drawn_rays_are_spread_over_scans() -> None:
    many = [
        ledger(*(entry(frame, frame % 2, 1 - frame % 2) for frame in range(30))) for _ in range(8)
    ]
    found = rays_of(many, 40)
    assert len(found.strips) == 40
    assert (found.kinds == HIT).sum() == 20
    assert len(np.unique(found.frames)) == 30
    assert len(rays_of([ledger()]).strips) == 0
