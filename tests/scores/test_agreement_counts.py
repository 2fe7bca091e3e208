"""Numbers of a comparison: laws, and plain references."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.two_runs import TwoRuns, any_two_runs, cells_of, two_runs
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import bootstrap

from dynaviz.contracts.scan import Outcome, outcomes
from dynaviz.scores.comparison.counts import (
    BOTH,
    FIRST,
    SECOND,
    SpatialCells,
    block_length,
    count_agreement,
    frame_gains,
    intervals,
    scores,
    spatial_gains,
)
from dynaviz.scores.scores import SCORES, Counts


@settings(deadline=None, max_examples=40)
@given(any_two_runs)
def test_scores_are_those_of_each_run_alone(runs: TwoRuns) -> None:
    for run, found in zip(runs[:2], scores(count_agreement(*runs[:2]).points), strict=True):
        counts = sum((Counts.of(a.outcome) for a in run), Counts())
        for name, value in found.items():
            if name in SCORES:
                np.testing.assert_allclose(value, getattr(counts, name), rtol=1e-12)
        assert (counts.static_removed, counts.dynamic_kept) == (found.FP, found.FN)


@settings(deadline=None, max_examples=40)
@given(any_two_runs)
def test_gains_of_frames_and_of_places_sum_up_to_the_difference(runs: TwoRuns) -> None:
    first, second, xyz = runs
    counts = count_agreement(first, second)
    a, b = scores(counts.points)
    difference = [np.nan_to_num(b.SA - a.SA), np.nan_to_num(b.DA - a.DA)]
    np.testing.assert_allclose(frame_gains(counts).sum(0), difference, atol=1e-9)
    places = spatial_gains(cells_of(first, xyz), cells_of(second, xyz), counts.points.sum(1))
    np.testing.assert_allclose(places.gain.sum(0), difference, atol=1e-9)


def test_drawn_points_count_for_all_they_stand_for_and_non_finite_points_are_skipped() -> None:
    xyz = np.array([[1, 1, 0], [np.nan, 0, 0], [2, 2, 4], [3, 3, 3], [-1, 1, 0]], np.float32)
    truth, dynamic = np.array([0, 0, 1, 0, 255], np.uint8), np.array([1, 1, 0, 0, 1], np.bool_)
    places = SpatialCells(5.0)
    places.add(3, xyz, outcomes(truth, dynamic), np.array([6, 1, 1, 1, 1]))
    keys, frames, counts, heights = places.rows()
    assert (counts.tolist(), frames.tolist(), heights.tolist()) == ([[6, 1]], [3], [4.0])
    np.testing.assert_array_equal(places.corners(keys), [[0, 0]])


@given(
    st.lists(
        st.tuples(st.integers(-20000, 20000), st.integers(-20000, 20000)),
        min_size=1,
        max_size=20,
        unique=True,
    )
)
def test_packing_a_cell_keeps_its_corner(cells: list[tuple[int, int]]) -> None:
    places = SpatialCells(5.0)
    xyz = np.array([[5 * x + 2.5, 5 * y + 2.5, 0] for x, y in cells], np.float32)
    places.add(
        0, xyz, np.full(len(cells), Outcome.FALSE_POSITIVE, np.uint8), np.ones(len(cells), np.int64)
    )
    corners = places.corners(places.rows()[0])
    assert {tuple(corner) for corner in corners.tolist()} == {(5.0 * x, 5.0 * y) for x, y in cells}


def test_runs_on_different_points_are_refused() -> None:
    first, _, _ = two_runs(0, 3, 30)
    other, _, _ = two_runs(1, 3, 30)
    with pytest.raises(ValueError, match="in frame 0 the ground truth differs"):
        count_agreement(first, other)
    with pytest.raises(ValueError, match="shorter"):
        count_agreement(first, first[:2])


def counted(seed: int, frames: int, drift: float) -> np.ndarray:
    """(F, 2, 4) counts of two runs.

    The second is better, by a lead that varies slowly over the frames.
    """
    random = np.random.default_rng(seed)
    lead = 0.3 + drift * np.sin(np.arange(frames) * 2 * np.pi / 60)
    share = np.clip(lead + random.normal(0, 0.05, frames), 0, 1)
    counts = np.zeros((frames, 2, 4), np.int64)
    counts[:, 0, BOTH], counts[:, 1, BOTH] = 900, 60
    counts[:, 0, SECOND], counts[:, 1, SECOND] = (100 * share).astype(int), (40 * share).astype(int)
    counts[:, 0, FIRST] = 5
    return counts


def test_intervals_against_blocks_drawn_one_by_one() -> None:
    counts, draws = counted(0, 11, 0.2), 50
    length = block_length(11)
    random = np.random.default_rng(0)
    differences = []
    for starts in random.integers(0, 11, (draws, 4)):  # 11 frames in blocks of 3
        frames = [(start + k) % 11 for start in starts for k in range(length)]
        a, b = scores(counts[frames].sum(0))
        differences.append(float(b.AA - a.AA))
    assert length == 3
    np.testing.assert_allclose(
        intervals(counts, draws).AA, np.quantile(differences, [0.025, 0.975])
    )


def test_intervals_of_independent_frames_agree_with_scipy() -> None:
    ratios = []
    for seed in range(10, 20):
        counts = counted(seed, 225, 0.0)

        def difference(at: np.ndarray, axis: int = -1, counts: np.ndarray = counts) -> np.ndarray:
            a, b = scores(counts[at].sum(at.ndim - 1))
            return b.AA - a.AA

        random = np.random.default_rng(seed)
        theirs = bootstrap(
            (np.arange(225),), difference, method="percentile", n_resamples=400, rng=random
        )
        low, high = intervals(counts, 1000).AA or (0, 0)
        ratios.append(
            (high - low) / (theirs.confidence_interval.high - theirs.confidence_interval.low)
        )
        assert (low + high) / 2 == pytest.approx(sum(theirs.confidence_interval) / 2, rel=0.05)
    assert np.mean(ratios) == pytest.approx(1, abs=0.2)


def test_correlated_frames_widen_the_interval() -> None:
    counts = counted(2, 225, 0.3)
    low, high = intervals(counts).AA or (0, 0)
    shuffled = intervals(counts[np.random.default_rng(0).permutation(225)]).AA or (0, 0)
    assert high - low > 2 * (shuffled[1] - shuffled[0])


def test_a_single_frame_has_no_interval() -> None:
    assert {value for _, value in intervals(counted(0, 1, 0.0)).items()} == {None}
