"""Four counts of points, and the percentages derived from them (paper, "Metric"; eval/README.md)."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynaviz.arrays import U8
from dynaviz.contracts.scan import Outcome
from dynaviz.scores.scores import SCORES, associated_accuracy, harmonic_mean, percent


@dataclass(frozen=True, slots=True)
class Counts:
    """Numbers of points by ground truth and answer. Add the counts of frames or sequences to combine them.

    Percentages are NaN where undefined: without dynamic ground truth there is no DA, and hence no AA and no HA.
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
        return Counts(*(a + b for a, b in zip(dataclasses.astuple(self), dataclasses.astuple(other), strict=True)))

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
        return float(percent(self.dynamic_removed, self.dynamic_removed + self.static_removed + self.dynamic_kept))

    def metrics(self) -> dict[str, float | None]:
        """All percentages as plain JSON values, None where undefined."""
        values = {name: getattr(self, name) for name in (*SCORES, "precision", "IoU")}
        return {name: None if math.isnan(value) else value for name, value in values.items()}

    def row(self) -> dict[str, float | None]:
        """Counts and accuracies in one dictionary, as in the rows of a breakdown."""
        metrics = self.metrics()
        return {**dataclasses.asdict(self), **{name: metrics[name] for name in SCORES}}
