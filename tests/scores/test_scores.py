"""Scores from counts, for numbers and arrays, against the formulas in plain Python."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dynaviz.scores.scores import SCORES, accuracies, harmonic_mean, percent, percentage_points_lost

COUNT = st.integers(0, 10**12)


def by_formula(
    static_kept: int, static_removed: int, dynamic_removed: int, dynamic_kept: int
) -> list[float]:
    """SA, DA, AA and HA in the arithmetic of Python's own numbers."""
    static, dynamic = static_kept + static_removed, dynamic_removed + dynamic_kept
    SA = 100.0 * static_kept / static if static else math.nan
    DA = 100.0 * dynamic_removed / dynamic if dynamic else math.nan
    HA = 0.0 if SA + DA == 0 else 2 * SA * DA / (SA + DA)
    return [SA, DA, math.sqrt(SA * DA), HA]


@given(st.lists(st.tuples(COUNT, COUNT, COUNT, COUNT), min_size=1, max_size=20))
def test_arrays_and_numbers_equal_the_formulas_to_the_bit(rows):
    kept, removed, right, left = np.array(rows, np.int64).T
    found = accuracies(kept, kept + removed, right, right + left)
    assert tuple(found) == SCORES
    np.testing.assert_array_equal(
        np.stack(list(found.values()), 1), [by_formula(*row) for row in rows]
    )
    a, b, c, d = rows[0]
    for name, value in accuracies(a, a + b, c, c + d).items():
        np.testing.assert_array_equal(value, found[name][0])


def test_undefined_scores_are_nan():
    found = accuracies([3, 0, 0], [4, 0, 5], [0, 3, 0], [0, 4, 5])
    assert found["SA"].tolist()[::2] == [75, 0]
    assert [np.isnan(found[name]).tolist() for name in SCORES] == [
        [False, True, False],
        [True, False, False],
        [True, True, False],
        [True, True, False],
    ]
    assert found["HA"][2] == found["AA"][2] == 0


def test_percent_of_numbers():
    assert (float(percent(1, 4)), float(harmonic_mean(90.0, 60.0))) == (25.0, 72.0)


@given(st.lists(COUNT, min_size=1, max_size=5), COUNT)
def test_costs_add_up_to_the_missing_percentage_points(wrong, correct):
    total = sum(wrong) + correct
    lost = percentage_points_lost(wrong, total)
    if total:
        np.testing.assert_allclose(lost.sum(), 100 - float(percent(correct, total)), atol=1e-9)
    else:
        assert np.isnan(lost).all()
