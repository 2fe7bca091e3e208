"""The comparison of two runs: laws, and a plain reference."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest
from helpers.two_runs import REASONS, TwoRuns, any_two_runs, compared, two_runs
from hypothesis import given, settings

from dynaviz.scores.comparison.counts import AGREEMENT, TRUTHS
from dynaviz.scores.comparison.frame_answers import BAND_NAMES
from dynaviz.scores.comparison.pair import (
    AgreementByTruth,
    ComparedRun,
    RangeAgreement,
    ReasonPair,
    WrongPointCounts,
)
from dynaviz.scores.comparison.tables import LISTED, sections
from dynaviz.scores.sections import Runtime


def by_truth(points: AgreementByTruth | RangeAgreement) -> dict[tuple[str, str], int]:
    """Points by truth and agreement."""
    return {(t, who): getattr(getattr(points, t), who) for t in TRUTHS for who in AGREEMENT}


@settings(deadline=None, max_examples=40)
@given(any_two_runs)
def test_a_run_does_not_differ_from_itself(runs: TwoRuns) -> None:
    first, _, xyz = runs
    found = compared(first, first, xyz)
    for _, score in found.scores.items():
        assert score.delta in (0, None)
        assert score.interval in ((0, 0), None)
    assert all(
        n == 0
        for (_, who), n in by_truth(found.right).items()
        if who in ("only_first", "only_second")
    )
    assert found.frames == found.places == ()


@settings(deadline=None, max_examples=40)
@given(any_two_runs)
def test_swapping_the_runs_negates_every_difference(runs: TwoRuns) -> None:
    first, second, xyz = runs
    there, back = compared(first, second, xyz), compared(second, first, xyz)
    for (_, score), (_, other) in zip(there.scores.items(), back.scores.items(), strict=True):
        assert (other.first, other.second) == (score.second, score.first)
        if score.delta is not None:
            assert other.delta == -score.delta
        if score.interval is not None:
            np.testing.assert_allclose(other.interval, np.negative(score.interval)[::-1], atol=1e-9)
    assert Counter(-row.gain for row in there.frames) == Counter(row.gain for row in back.frames)
    assert Counter(-row.gain for row in there.places) == Counter(row.gain for row in back.places)
    swap = {"only_first": "only_second", "only_second": "only_first", "neither": "neither"}
    swapped = [
        ReasonPair(r.truth, swap[r.right], r.second_reason, r.first_reason, r.points)
        for r in back.by_reason
    ]
    assert Counter(swapped) == Counter(there.by_reason)


@settings(deadline=None, max_examples=40)
@given(any_two_runs)
def test_counts_add_up_to_all_points(runs: TwoRuns) -> None:
    first, second, xyz = runs
    found = compared(first, second, xyz)
    totals = by_truth(found.right)
    for code, truth in enumerate(TRUTHS):
        assert sum(totals[truth, who] for who in AGREEMENT) == sum(
            int((a.truth == code).sum()) for a in first
        )
    for (truth, who), total in totals.items():
        assert sum(by_truth(band)[truth, who] for band in found.by_range) == total
        explained = sum(
            row.points for row in found.by_reason if (row.truth, row.right) == (truth, who)
        )
        assert explained == (0 if who == "both" else total)


@pytest.mark.parametrize("seed", range(4))
def test_against_a_count_point_by_point(seed: int) -> None:
    first, second, xyz = two_runs(seed, 7, 60)
    found = compared(first, second, xyz)
    right, bands, reasons = Counter[Any](), Counter[Any](), Counter[Any]()
    wrong: dict[Any, list[int]] = {}
    for a, b, points in zip(first, second, xyz, strict=True):
        for i in np.flatnonzero(a.truth != 255):
            correct = [bool(run.dynamic[i] == a.truth[i]) for run in (a, b)]
            who = AGREEMENT[correct[0] + 2 * correct[1]]
            truth = TRUTHS[a.truth[i]]
            right[truth, who] += 1
            bands[BAND_NAMES[a.bands[i]], truth, who] += 1
            names = [
                None if ok else REASONS[run.reasons[i]]
                for ok, run in zip(correct, (a, b), strict=True)
            ]
            if who != "both":
                reasons[truth, who, *names] += 1
            x, y = np.floor(points[i, :2] / 5) * 5
            for side, ok in enumerate(correct):
                row = wrong.setdefault((x, y), [0, 0, 0, 0])
                row[2 * side + a.truth[i]] += not ok
    assert right == +Counter(by_truth(found.right))
    assert bands == +Counter(
        {(band.band, *key): n for band in found.by_range for key, n in by_truth(band).items()}
    )
    assert reasons == {
        (r.truth, r.right, r.first_reason, r.second_reason): r.points for r in found.by_reason
    }
    assert len(found.places) == 10
    for place in found.places:
        counts = wrong[place.low]
        assert (place.first, place.second) == (
            WrongPointCounts(*counts[:2]),
            WrongPointCounts(*counts[2:]),
        )
        assert place.high == tuple(low + 5 for low in place.low)
    totals = [sum(right[t, w] for w in AGREEMENT) for t in TRUTHS]
    cost = {
        key: 100 * (w[0] - w[2]) / totals[0] + 100 * (w[1] - w[3]) / totals[1]
        for key, w in wrong.items()
    }
    largest = sorted((abs(c) for c in cost.values()), reverse=True)[:10]
    np.testing.assert_allclose([abs(place.gain) for place in found.places], largest)
    for place in found.places:
        by_frame = []
        for a, b, points in zip(first, second, xyz, strict=True):
            here = (np.floor(points[:, :2] / 5) * 5 == place.low).all(1) & (a.truth != 255)
            change = (b.dynamic == a.truth)[here].astype(int) - (a.dynamic == a.truth)[here]
            by_frame.append(
                sum(100 * n / totals[t] for n, t in zip(change, a.truth[here], strict=True))
            )
        most = max(np.sign(place.gain) * np.array(by_frame))
        assert by_frame[place.frame] * np.sign(place.gain) == pytest.approx(most)


def test_the_tables_show_what_was_counted() -> None:
    pair = compared(*two_runs(3, 6, 80))
    runs = [
        ComparedRun(
            letter,
            name,
            "",
            "",
            name,
            name,
            "errors",
            "mask",
            False,
            0,
            {},
            pair.scores,
            Runtime(),
            False,
            "",
        )
        for letter, name in (("A", "octomap"), ("B", "dufomap"))
    ]
    tables = {section.title: section.rows for section in sections(runs, [pair])}
    rows = {
        row[0]: row[1:] for row in tables["Correctly labelled points, by range from the sensor"]
    }
    kinds = ("only_first", "only_second", "neither", "both")
    expected = {("all", truth): getattr(pair.right, truth) for truth in TRUTHS}
    expected |= {
        (band.band, truth): getattr(band, truth) for band in pair.by_range for truth in TRUTHS
    }
    assert rows == {
        f"{truth}, {of}": tuple(str(getattr(n, k)) for k in kinds)
        for (of, truth), n in expected.items()
    }
    assert [(int(row[0]), row[1]) for row in tables["Frames that change most"]] == [
        (row.frame, "B" if row.gain > 0 else "A") for row in pair.frames
    ]
    assert [row[-1] for row in tables["Errors by reason"]] == [
        str(row.points) for row in pair.by_reason[:LISTED]
    ]
