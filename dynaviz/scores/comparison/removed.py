"""What one run removed and the other kept, where there is no ground truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dynaviz.scores.comparison.counts import FIRST, REMOVED_BY, SECOND, AgreementCounts
from dynaviz.scores.comparison.frame_answers import BAND_NAMES
from dynaviz.scores.scores import percent

ReasonNames = Mapping[int, str]  # by code


@dataclass(frozen=True, slots=True)
class RemovedBy:
    """Points that neither run, only the first, only the second, or both removed."""

    neither: int
    only_first: int
    only_second: int
    both: int

    @property
    def shares(self) -> tuple[float, float]:
        """Points removed by the first and by the second run, percent; NaN without points."""
        total = self.neither + self.only_first + self.only_second + self.both
        return float(percent(self.only_first + self.both, total)), float(percent(self.only_second + self.both, total))


@dataclass(frozen=True, slots=True)
class RangeRemovedBy:
    """Removed points within a band of ranges from the sensor."""

    band: str
    points: RemovedBy


@dataclass(frozen=True, slots=True)
class RemovalReasons:
    """Points that only one run removed (``only_first`` or ``only_second``), by the reasons of both runs."""

    removed_by: str
    first_reason: str
    second_reason: str
    points: int


@dataclass(frozen=True, slots=True)
class RemovalComparison:
    """Removed points of two runs, of a sequence without ground truth.

    Attributes:
        points: by which run removed them.
        by_range: the same, by range from the sensor.
        by_reason: points that only one run removed, most points first.
    """

    points: RemovedBy
    by_range: tuple[RangeRemovedBy, ...]
    by_reason: tuple[RemovalReasons, ...]


def compare_removals(counts: AgreementCounts, names: tuple[ReasonNames, ReasonNames]) -> RemovalComparison | None:
    """Compare what two runs removed; None if there is ground truth.

    Args:
        counts: agreement of the runs.
        names: of their reason codes.
    """
    if counts.points.any():
        return None
    rows = [
        RemovalReasons(REMOVED_BY[by], names[0].get(i, str(i)), names[1].get(j, str(j)), points)
        for by in (FIRST, SECOND)
        for i, j in np.argwhere(counts.removed_reasons[by]).tolist()
        for points in [int(counts.removed_reasons[by, i, j])]
    ]
    bands = counts.removed_bands
    return RemovalComparison(
        RemovedBy(*bands.sum(1).tolist()),
        tuple(RangeRemovedBy(name, RemovedBy(*bands[:, i].tolist())) for i, name in enumerate(BAND_NAMES)),
        tuple(sorted(rows, key=lambda row: -row.points)),
    )
