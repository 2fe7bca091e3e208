"""The scores of a labelled map and the cost of wrong points, from counts of points. Defined here and nowhere else.

All functions take numbers or arrays. Results are NaN where undefined: without dynamic ground truth there is no DA, and
hence no AA and no HA.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dynaviz.arrays import F64

SCORES = ("SA", "DA", "AA", "HA")
RANGE_EDGES = (10.0, 20.0, 30.0, 50.0)  # metres from the sensor: scores and counts by range use the bins between these


def percent(part: Any, whole: Any) -> F64:
    """(...) float64: share of a whole in percent; NaN where both are 0."""
    with np.errstate(invalid="ignore", divide="ignore"):
        share: F64 = 100.0 * np.asarray(part) / np.asarray(whole)
    return share


def associated_accuracy(SA: Any, DA: Any) -> F64:
    """(...) float64: AA, the geometric mean of SA and DA, in percent (paper, equation 2)."""
    AA: F64 = np.sqrt(np.multiply(SA, DA))
    return AA


def harmonic_mean(a: Any, b: Any) -> F64:
    """(...) float64: HA for SA and DA; 0 where both are 0, its limit."""
    with np.errstate(invalid="ignore", divide="ignore"):
        total = np.add(a, b)
        return np.where(total == 0, 0.0, 2 * np.asarray(a) * b / total)


def accuracies(static_kept: Any, static: Any, dynamic_removed: Any, dynamic: Any) -> dict[str, F64]:
    """SA, DA, AA and HA in percent, (...) float64 each.

    Args:
        static_kept, dynamic_removed: (...) points with a correct answer.
        static, dynamic: (...) all points of that ground truth.
    """
    SA, DA = percent(static_kept, static), percent(dynamic_removed, dynamic)
    return dict(zip(SCORES, (SA, DA, associated_accuracy(SA, DA), harmonic_mean(SA, DA)), strict=True))


def percentage_points_lost(wrong: Any, total: Any) -> F64:
    """(...) float64: what wrong points cost, in percentage points of SA (static points) or DA (dynamic points).

    Costs add up: those of all wrong points are 100 - SA and 100 - DA.

    Args:
        wrong: (...) wrong points of one ground truth.
        total: (...) all points of that ground truth.
    """
    return percent(wrong, total)
