"""Which points of a state are drawn if there are too many."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.worlds import pose
from hypothesis import given, settings
from hypothesis import strategies as st

from dynaviz import kernels
from dynaviz.arrays import F32
from dynaviz.contracts.scan import Label, Scan
from dynaviz.views.record.budget import REACH, Budget

_XY = np.mgrid[-40:40:0.2, -40:40:0.2] + 0.05
GROUND = np.stack([*_XY, np.zeros((400, 400))], -1).reshape(-1, 3).astype(np.float32)


def scan_of(points: F32, dynamic: bool = True) -> Scan:
    labels = np.full(len(points), Label.DYNAMIC if dynamic else Label.STATIC, np.uint8)
    return Scan(0, points, pose(0.0, 0.0, 1.5), labels=labels)


@pytest.mark.parametrize("most", [1, 500, 4000, 10**6])
def test_the_budget_is_kept_and_used(most: int) -> None:
    chosen = Budget(scan_of(GROUND[:0]), most).chosen(GROUND)
    within = (np.abs(GROUND) < REACH).all(1).sum()
    assert (np.diff(chosen) > 0).all()
    assert most / 3 <= len(chosen) <= most or len(chosen) == within < most


def test_everything_around_dynamic_points_and_errors_comes_first() -> None:
    mover, error = (
        np.array([[38.0, 5.0, 0.0]], np.float32),
        np.array([[-25.0, -25.0, 0.0]], np.float32),
    )
    chosen = Budget(scan_of(mover), 2000, error).chosen(GROUND)
    for place in (mover, error):
        around = np.flatnonzero((np.abs(GROUND - place) < 0.99).all(1))
        assert np.isin(around, chosen).all()


def test_distant_places_are_covered_and_get_fewer_points() -> None:
    chosen = GROUND[Budget(scan_of(GROUND[:0]), 3000).chosen(GROUND)]
    ranges = np.abs(chosen[:, :2]).max(1)
    near, far = ((low <= ranges) & (ranges < high) for low, high in ((2, 10), (18, 28)))
    for block in np.mgrid[-24:25:12, -24:25:12].reshape(2, -1).T:
        assert (np.abs(chosen[:, :2] - block) < 6).all(1).any()
    assert near.sum() / (20**2 - 4**2) > 2 * far.sum() / (56**2 - 36**2)


def test_points_without_a_place_are_left_out() -> None:
    odd = np.array([[np.nan, 0, 0], [1e9, 0, 0], [1, 1, 1], [0, np.inf, 0]], np.float32)
    budget = Budget(scan_of(GROUND[:0]), 1)
    assert budget.chosen(odd).tolist() == [2]
    assert budget.chosen(odd[:0]).tolist() == []


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1), st.floats(0.05, 3.0))
def test_thinned_points_are_the_first_of_their_cell(seed: int, size: float) -> None:
    points = kernels.as_readonly(np.random.default_rng(seed).uniform(-6, 6, (300, 3)), np.float32)
    rows, all_cells_alike = np.arange(len(points)), 100.0
    kept, complete = kernels.thinning.thinned(
        points, rows, np.zeros(3), size, all_cells_alike, 1000, 1.0
    )
    _, first = np.unique(
        np.floor(points.astype(np.float64) * (1.0 / size)), axis=0, return_index=True
    )
    assert kept.tolist() == np.sort(first).tolist()
    assert complete
    some, complete = kernels.thinning.thinned(
        points, rows, np.zeros(3), size, all_cells_alike, len(kept) - 1, 1.0
    )
    assert some.tolist() == kept[:-1].tolist()
    assert not complete
    few, complete = kernels.thinning.thinned(
        points, rows, np.zeros(3), 1e-3, all_cells_alike, 1000, 0.25
    )
    assert 60 <= len(few) <= 90
    assert np.diff(few).max() <= 8
    assert complete
