"""Comparisons without ground truth: what one run removed and the other kept."""

from __future__ import annotations

import json
from collections import Counter

import msgspec
import numpy as np
from helpers.two_runs import REASONS, TwoRuns, compared, two_runs
from hypothesis import given, settings
from hypothesis import strategies as st

from dynaviz.scores.comparison.frame_answers import BAND_NAMES
from dynaviz.scores.comparison.pair import ComparedRun, RemovalComparison
from dynaviz.scores.comparison.summary import Comparison
from dynaviz.scores.comparison.tables import sections
from dynaviz.scores.sections import Runtime, SequenceInfo

KINDS = ("neither", "only_first", "only_second", "both")


def counted(
    runs: TwoRuns,
) -> tuple[Counter[str], Counter[tuple[str, str]], Counter[tuple[str, str, str]]]:
    """The same numbers, point by point: by kind, by band and kind, and by kind and reasons."""
    kinds: Counter[str] = Counter()
    bands: Counter[tuple[str, str]] = Counter()
    reasons: Counter[tuple[str, str, str]] = Counter()
    for a, b in zip(runs[0], runs[1], strict=True):
        for i in range(len(a)):
            kind = KINDS[int(a.dynamic[i]) + 2 * int(b.dynamic[i])]
            kinds[kind] += 1
            bands[BAND_NAMES[a.bands[i]], kind] += 1
            if kind in KINDS[1:3]:
                reasons[kind, REASONS[a.reasons[i]], REASONS[b.reasons[i]]] += 1
    return kinds, bands, reasons


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32), frames=st.integers(1, 4), points=st.integers(0, 30))
def test_removed_points_are_counted_by_range_and_reason(seed, frames, points):
    runs = two_runs(seed, frames, points, (255,))
    removed = compared(*runs).removed
    assert removed is not None
    kinds, bands, reasons = counted(runs)
    assert all(getattr(removed.points, kind) == kinds[kind] for kind in KINDS)
    for row in removed.by_range:
        assert all(getattr(row.points, kind) == bands[row.band, kind] for kind in KINDS)
    found = {
        (row.removed_by, row.first_reason, row.second_reason): row.points
        for row in removed.by_reason
    }
    assert found == reasons
    assert [row.points for row in removed.by_reason] == sorted(reasons.values(), reverse=True)


def test_with_ground_truth_there_is_no_such_comparison():
    assert compared(*two_runs(1, 3, 20, (0, 255))).removed is None


def test_the_verdict_and_the_tables_claim_nothing_that_is_unknown():
    pair = compared(*two_runs(5, 4, 40, (255,)))
    runs = tuple(
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
    )
    comparison = Comparison(SequenceInfo("street", "", 4, 60), runs, (pair,))
    (verdict,) = comparison.verdicts()
    assert pair.removed is not None
    shares = pair.removed.points.shares
    assert verdict.startswith("There is no ground truth, so neither run is known to be better.")
    assert f"A octomap removes {shares[0]:.2f} % of the points" in verdict
    assert f"B dufomap removes {shares[1]:.2f} % of the points" in verdict
    titles = [section.title for section in sections(runs, (pair,))]
    assert titles[:2] == [
        "Removed points, by range from the sensor",
        "What one run removed and the other kept",
    ]
    assert len(titles) == 3
    text = str(comparison)
    assert "SA" not in text
    assert "correct" not in text
    assert f"{pair.removed.by_reason[0].points}" in text
    plain = comparison.to_dict()["pairs"][0]["removed"]
    assert msgspec.convert(json.loads(json.dumps(plain)), RemovalComparison) == pair.removed
    assert np.isclose(
        sum(plain["points"].values()), sum(len(a) for a in two_runs(5, 4, 40, (255,))[0])
    )
