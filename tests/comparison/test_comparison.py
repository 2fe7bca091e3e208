"""Numbers of a comparison: laws, and counts by hand."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import bootstrap

from dynaviz.comparison.answers import BAND_NAMES, Answers
from dynaviz.comparison.counts import (
    AGREEMENT,
    BOTH,
    FIRST,
    SECOND,
    TRUTHS,
    SpatialCells,
    block_length,
    compare_pair,
    count_agreement,
    frame_gains,
    intervals,
    scores,
    spatial_gains,
)
from dynaviz.scan import Outcome, outcomes
from dynaviz_eval.confusion import Counts

NAMES = {0: "zero", 1: "one", 2: "two"}
Drive = tuple[list[Answers], list[Answers], list[np.ndarray]]


def drive(seed: int, frames: int, points: int, truths: tuple[int, ...] = (0, 0, 1, 255)) -> Drive:
    """Two runs' answers to the same random points, and the points' coordinates."""
    random = np.random.default_rng(seed)
    first, second, places = [], [], []
    for frame in range(frames):
        n = int(random.integers(0, points + 1))
        truth, bands = random.choice(truths, n).astype(np.uint8), random.integers(0, 5, n).astype(np.uint8)
        for run in (first, second):
            dynamic, reasons = random.random(n) < random.random(), random.integers(0, 3, n).astype(np.uint8)
            run.append(Answers(frame, frame + 100, dynamic, truth, reasons, bands))
        places.append((random.normal(size=(n, 3)) * 12).astype(np.float32))
    return first, second, places


drives = st.builds(
    drive,
    st.integers(0, 2**32),
    st.integers(1, 9),
    st.integers(0, 30),
    st.sampled_from([(0, 0, 1, 255), (0,), (255,), (1,)]),
)


def compared(first: list[Answers], second: list[Answers], xyz: list[np.ndarray]) -> dict[str, Any]:
    crossed = count_agreement(first, second)
    sides = (placed(first, xyz), placed(second, xyz))
    return compare_pair(crossed, spatial_gains(*sides, crossed.points.sum(1)), (NAMES, NAMES))


def placed(run: list[Answers], xyz: list[np.ndarray], size: float = 5.0) -> SpatialCells:
    places = SpatialCells(size)
    for answers, points in zip(run, xyz, strict=True):
        places.add(answers.frame, points, answers.outcome, np.ones(len(points), np.int64))
    return places


@settings(deadline=None, max_examples=40)
@given(drives)
def test_a_run_does_not_differ_from_itself(runs: Drive) -> None:
    first, _, xyz = runs
    found = compared(first, first, xyz)
    for score in found["scores"].values():
        assert score["delta"] in (0, None)
        assert score["interval"] in ((0, 0), None)
    assert all(found["right"][truth][who] == 0 for truth in TRUTHS for who in ("only_first", "only_second"))
    assert found["frames"] == found["places"] == []


@settings(deadline=None, max_examples=40)
@given(drives)
def test_swapping_negates(runs: Drive) -> None:
    first, second, xyz = runs
    there, back = compared(first, second, xyz), compared(second, first, xyz)
    for name, score in there["scores"].items():
        other = back["scores"][name]
        assert (other["first"], other["second"]) == (score["second"], score["first"])
        if score["delta"] is not None:
            assert other["delta"] == -score["delta"]
        if score["interval"] is not None:
            np.testing.assert_allclose(other["interval"], np.negative(score["interval"])[::-1], atol=1e-9)
    for key in ("frames", "places"):
        assert Counter(-row["gain"] for row in there[key]) == Counter(row["gain"] for row in back[key])
    swap = {"only_first": "only_second", "only_second": "only_first", "neither": "neither"}
    turned = [
        (r["truth"], swap[r["right"]], r["second_reason"], r["first_reason"], r["points"]) for r in back["by_reason"]
    ]
    assert sorted(map(str, turned)) == sorted(str(tuple(row.values())) for row in there["by_reason"])


@settings(deadline=None, max_examples=40)
@given(drives)
def test_counts_add_up_to_all_points(runs: Drive) -> None:
    first, second, xyz = runs
    found = compared(first, second, xyz)
    for code, truth in enumerate(TRUTHS):
        assert sum(found["right"][truth].values()) == sum(int((a.truth == code).sum()) for a in first)
        for who in AGREEMENT:
            total = found["right"][truth][who]
            assert sum(band[truth][who] for band in found["by_range"]) == total
            told = [r["points"] for r in found["by_reason"] if (r["truth"], r["right"]) == (truth, who)]
            assert sum(told) == (0 if who == "both" else total)


@settings(deadline=None, max_examples=40)
@given(drives)
def test_scores_are_those_of_each_run_alone(runs: Drive) -> None:
    for run, found in zip(runs[:2], scores(count_agreement(*runs[:2]).points), strict=True):
        counts = sum((Counts.of(a.outcome) for a in run), Counts())
        for name in ("SA", "DA", "AA", "HA"):
            np.testing.assert_allclose(found[name], getattr(counts, name), rtol=1e-12)
        assert (found["FP"], found["FN"]) == (counts.static_removed, counts.dynamic_kept)


@settings(deadline=None, max_examples=40)
@given(drives)
def test_gains_of_frames_and_of_places_sum_up_to_the_difference(runs: Drive) -> None:
    first, second, xyz = runs
    crossed = count_agreement(first, second)
    a, b = scores(crossed.points)
    difference = [np.nan_to_num(b[name] - a[name]) for name in ("SA", "DA")]
    np.testing.assert_allclose(frame_gains(crossed).sum(0), difference, atol=1e-9)
    places = spatial_gains(placed(first, xyz), placed(second, xyz), crossed.points.sum(1))
    np.testing.assert_allclose(places.gain.sum(0), difference, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_everything_by_hand(seed: int) -> None:
    first, second, xyz = drive(seed, 7, 60)
    found = compared(first, second, xyz)
    right, bands, reasons = Counter[Any](), Counter[Any](), Counter[Any]()
    wrong: dict[Any, list[int]] = {}
    for a, b, points in zip(first, second, xyz, strict=True):
        for i in np.flatnonzero(a.truth != 255):
            goods = [run.dynamic[i] == a.truth[i] for run in (a, b)]
            who = {(True, True): "both", (True, False): "only_first", (False, True): "only_second"}.get(
                (bool(goods[0]), bool(goods[1])), "neither"
            )
            truth = TRUTHS[a.truth[i]]
            right[truth, who] += 1
            bands[BAND_NAMES[a.bands[i]], truth, who] += 1
            told = [None if good else NAMES[run.reasons[i]] for good, run in zip(goods, (a, b), strict=True)]
            if who != "both":
                reasons[truth, who, *told] += 1
            x, y = np.floor(points[i, :2] / 5) * 5
            for side, good in enumerate(goods):
                row = wrong.setdefault((x, y), [0, 0, 0, 0])
                row[2 * side + a.truth[i]] += not good
    assert right == +Counter({(t, w): n for t, row in found["right"].items() for w, n in row.items()})
    assert bands == +Counter({(r["band"], t, w): n for r in found["by_range"] for t in TRUTHS for w, n in r[t].items()})
    assert reasons == {
        (r["truth"], r["right"], r["first_reason"], r["second_reason"]): r["points"] for r in found["by_reason"]
    }
    assert len(found["places"]) == 10
    for place in found["places"]:
        ours = [place[side][name] for side in ("first", "second") for name in ("FP", "FN")]
        assert ours == wrong[tuple(place["low"])]
        assert place["high"] == [low + 5 for low in place["low"]]
    totals = [sum(right[t, w] for w in AGREEMENT) for t in TRUTHS]
    cost = {key: 100 * (w[0] - w[2]) / totals[0] + 100 * (w[1] - w[3]) / totals[1] for key, w in wrong.items()}
    largest = sorted((abs(c) for c in cost.values()), reverse=True)[:10]
    np.testing.assert_allclose([abs(p["gain"]) for p in found["places"]], largest)
    for place in found["places"]:
        by_frame = []
        for a, b, points in zip(first, second, xyz, strict=True):
            here = (np.floor(points[:, :2] / 5) * 5 == place["low"]).all(1) & (a.truth != 255)
            moved = (b.dynamic == a.truth)[here].astype(int) - (a.dynamic == a.truth)[here]
            by_frame.append(sum(100 * m / totals[t] for m, t in zip(moved, a.truth[here], strict=True)))
        assert by_frame[place["frame"]] * np.sign(place["gain"]) == pytest.approx(
            max(np.sign(place["gain"]) * np.array(by_frame))
        )


def test_points_that_stand_for_others_count_as_many_and_those_without_a_place_nowhere() -> None:
    xyz = np.array([[1, 1, 0], [np.nan, 0, 0], [2, 2, 4], [3, 3, 3], [-1, 1, 0]], np.float32)
    truth, dynamic = np.array([0, 0, 1, 0, 255], np.uint8), np.array([1, 1, 0, 0, 1], np.bool_)
    places = SpatialCells(5.0)
    places.add(3, xyz, outcomes(truth, dynamic), np.array([6, 1, 1, 1, 1]))
    keys, frames, counts, heights = places.rows()
    assert (counts.tolist(), frames.tolist(), heights.tolist()) == ([[6, 1]], [3], [4.0])
    np.testing.assert_array_equal(places.corners(keys), [[0, 0]])


@given(
    st.lists(st.tuples(st.integers(-20000, 20000), st.integers(-20000, 20000)), min_size=1, max_size=20, unique=True)
)
def test_columns_keep_their_place(cells: list[tuple[int, int]]) -> None:
    places = SpatialCells(5.0)
    xyz = np.array([[5 * x + 2.5, 5 * y + 2.5, 0] for x, y in cells], np.float32)
    places.add(0, xyz, np.full(len(cells), Outcome.FALSE_POSITIVE, np.uint8), np.ones(len(cells), np.int64))
    corners = places.corners(places.rows()[0])
    assert {tuple(corner) for corner in corners.tolist()} == {(5.0 * x, 5.0 * y) for x, y in cells}


def test_answers_to_other_points_are_refused() -> None:
    first, _, _ = drive(0, 3, 30)
    other, _, _ = drive(1, 3, 30)
    with pytest.raises(ValueError, match="in frame 0 the ground truth differs"):
        count_agreement(first, other)
    with pytest.raises(ValueError, match="shorter"):
        count_agreement(first, first[:2])


def counted(seed: int, frames: int, drift: float) -> np.ndarray:
    """(F, 2, 4) counts of two runs of which the second is the better one; its lead comes and goes slowly."""
    random = np.random.default_rng(seed)
    lead = 0.3 + drift * np.sin(np.arange(frames) * 2 * np.pi / 60)
    share = np.clip(lead + random.normal(0, 0.05, frames), 0, 1)
    counts = np.zeros((frames, 2, 4), np.int64)
    counts[:, 0, BOTH], counts[:, 1, BOTH] = 900, 60
    counts[:, 0, SECOND], counts[:, 1, SECOND] = (100 * share).astype(int), (40 * share).astype(int)
    counts[:, 0, FIRST] = 5
    return counts


def test_intervals_are_those_of_frames_drawn_in_blocks() -> None:
    counts, draws = counted(0, 11, 0.2), 50
    length = block_length(11)
    random = np.random.default_rng(0)
    differences = []
    for starts in random.integers(0, 11, (draws, 4)):  # 11 frames in blocks of 3
        frames = [(start + k) % 11 for start in starts for k in range(length)]
        a, b = scores(counts[frames].sum(0))
        differences.append(float(b["AA"] - a["AA"]))
    assert length == 3
    np.testing.assert_allclose(intervals(counts, draws)["AA"], np.quantile(differences, [0.025, 0.975]))


def test_on_independent_frames_intervals_agree_with_scipy() -> None:
    ratios = []
    for seed in range(10, 20):
        counts = counted(seed, 225, 0.0)

        def difference(at: np.ndarray, axis: int = -1, counts: np.ndarray = counts) -> np.ndarray:
            a, b = scores(counts[at].sum(at.ndim - 1))
            return b["AA"] - a["AA"]

        random = np.random.default_rng(seed)
        theirs = bootstrap((np.arange(225),), difference, method="percentile", n_resamples=400, rng=random)
        low, high = intervals(counts, 1000)["AA"] or (0, 0)
        ratios.append((high - low) / (theirs.confidence_interval.high - theirs.confidence_interval.low))
        assert (low + high) / 2 == pytest.approx(sum(theirs.confidence_interval) / 2, rel=0.05)
    assert np.mean(ratios) == pytest.approx(1, abs=0.2)


def test_frames_that_resemble_their_neighbours_widen_the_interval() -> None:
    counts = counted(2, 225, 0.3)
    low, high = intervals(counts)["AA"] or (0, 0)
    shuffled = intervals(counts[np.random.default_rng(0).permutation(225)])["AA"] or (0, 0)
    assert high - low > 2 * (shuffled[1] - shuffled[0])


def test_no_interval_of_a_single_frame() -> None:
    assert set(intervals(counted(0, 1, 0.0)).values()) == {None}
