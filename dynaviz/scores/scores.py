"""The scores of a labelled map and the cost of wrong points, from counts of points.

Defined here and nowhere else.

All functions take numbers or arrays. Results are NaN where undefined: without dynamic ground truth
there is no DA, and hence no AA and no HA.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynaviz.arrays import F64, U8
from dynaviz.contracts.scan import Outcome

SCORES = ("SA", "DA", "AA", "HA")
# metres from the sensor: scores and counts by range use the bins between these
RANGE_EDGES = (
    10.0,
    20.0,
    30.0,
    50.0,
)


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
    SA = percent(static_kept, static)
    DA = percent(dynamic_removed, dynamic)
    return dict(
        zip(SCORES, (SA, DA, associated_accuracy(SA, DA), harmonic_mean(SA, DA)), strict=True)
    )


def percentage_points_lost(wrong: Any, total: Any) -> F64:
    """(...) float64: what wrong points cost, in percentage points of SA (static points) or DA
    (dynamic points).

    Costs add up: those of all wrong points are 100 - SA and 100 - DA.

    Args:
        wrong: (...) wrong points of one ground truth.
        total: (...) all points of that ground truth.
    """
    return percent(wrong, total)


@dataclass(frozen=True, slots=True)
class Counts:
    """Numbers of points by ground truth and answer.

    Add the counts of frames or sequences to combine them.

    Percentages are NaN where undefined: without dynamic ground truth there is no DA, and hence no
    AA and no HA.
    """

    static_kept: int = 0
    static_removed: int = 0
    dynamic_removed: int = 0
    dynamic_kept: int = 0
    unlabelled: int = 0

    @classmethod
    def of(cls, outcome: U8) -> Counts:
        """Count (N,) uint8 outcomes."""
        return cls.of_histogram(np.bincount(outcome, minlength=len(Outcome)))

    @classmethod
    def of_histogram(cls, by_outcome: Any) -> Counts:
        """Counts from the numbers of points by ``Outcome``, (6,) integers."""
        n = [int(count) for count in by_outcome]
        return cls(
            static_kept=n[Outcome.STATIC_KEPT],
            static_removed=n[Outcome.FALSE_POSITIVE],
            dynamic_removed=n[Outcome.DYNAMIC_REMOVED],
            dynamic_kept=n[Outcome.FALSE_NEGATIVE],
            unlabelled=n[Outcome.UNLABELLED_KEPT] + n[Outcome.UNLABELLED_REMOVED],
        )

    def __add__(self, other: Counts) -> Counts:
        return Counts(
            *(
                a + b
                for a, b in zip(dataclasses.astuple(self), dataclasses.astuple(other), strict=True)
            )
        )

    @property
    def SA(self) -> float:
        """Static accuracy, percent: share of the static points that were kept."""
        return float(percent(self.static_kept, self.static_kept + self.static_removed))

    @property
    def DA(self) -> float:
        """Dynamic accuracy, percent: share of the dynamic points that were removed."""
        return float(percent(self.dynamic_removed, self.dynamic_removed + self.dynamic_kept))

    @property
    def AA(self) -> float:
        """Associated accuracy, percent: geometric mean of SA and DA (paper, equation 2)."""
        return float(associated_accuracy(self.SA, self.DA))

    @property
    def HA(self) -> float:
        """Harmonic accuracy, percent: harmonic mean of SA and DA; 0 where both are 0, its limit."""
        return float(harmonic_mean(self.SA, self.DA))

    @property
    def precision(self) -> float:
        """Share of the removed labelled points that are dynamic, percent."""
        return float(percent(self.dynamic_removed, self.dynamic_removed + self.static_removed))

    @property
    def IoU(self) -> float:
        """Intersection over union of the dynamic class, percent."""
        return float(
            percent(
                self.dynamic_removed, self.dynamic_removed + self.static_removed + self.dynamic_kept
            )
        )

    def metrics(self) -> dict[str, float | None]:
        """All percentages as plain JSON values, None where undefined."""
        values = {name: getattr(self, name) for name in (*SCORES, "precision", "IoU")}
        return {name: None if math.isnan(value) else value for name, value in values.items()}

    def row(self) -> dict[str, Any]:
        """Counts and accuracies in one dictionary, as in the rows of a breakdown."""
        metrics = self.metrics()
        return {**dataclasses.asdict(self), **{name: metrics[name] for name in SCORES}}
