"""Compared runs and what differs between two of them, as typed values.

Field names are the keys of ``--json``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dynaviz.arrays import F64, I64
from dynaviz.scores.comparison.counts import (
    AGREEMENT,
    BOTH,
    FIRST,
    REMOVED_BY,
    SECOND,
    TRUTHS,
    AgreementCounts,
    ByScore,
    SpatialGains,
    frame_gains,
    intervals,
    largest,
    scores,
)
from dynaviz.scores.comparison.frame_answers import BAND_NAMES
from dynaviz.scores.comparison.objects import ObjectChange, object_changes
from dynaviz.scores.comparison.settings import (
    RuntimeRatio,
    SettingChange,
    runtime_ratio,
    setting_changes,
)
from dynaviz.scores.comparison.surfaces import SurfaceChange, surface_changes
from dynaviz.scores.looks import Ceiling
from dynaviz.scores.movers import change_intervals
from dynaviz.scores.result import Result
from dynaviz.scores.scores import percent
from dynaviz.scores.sections import Runtime

MOST = 10  # frames, places and objects listed, at most

ReasonNames = Mapping[int, str]  # by code

Scores = ByScore[float | None]  # None where undefined


@dataclass(frozen=True, slots=True)
class ComparedRun:
    """One of the compared runs.

    Attributes:
        letter: A, B, ... in the order given.
        name: the method, and the settings that distinguish it from the other runs.
        path, sha256: its recording.
        method, title, scoring, online, seed, parameters, runtime, instrumented, command: as in its
            result.
        mode: how much its recording contains.
        scores: of the whole run.
        ceiling: what the drive showed of its moving objects, and what the run made of it, without
            single objects; None if unknown.
    """

    letter: str
    name: str
    path: str
    sha256: str
    method: str
    title: str
    mode: str
    scoring: str
    online: bool
    seed: int
    parameters: dict[str, Any]
    scores: Scores
    runtime: Runtime
    instrumented: bool
    command: str
    ceiling: Ceiling | None = None

    @property
    def label(self) -> str:
        """Letter and name, as in tables and in the viewer."""
        return f"{self.letter} {self.name}"


@dataclass(frozen=True, slots=True)
class ScoreChange:
    """A score of both runs; ``delta`` is second - first, ``interval`` its 95 % interval.

    None where undefined.
    """

    first: float | None
    second: float | None
    delta: float | None
    interval: tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class Agreement:
    """Points that neither run, only the first, only the second, or both labelled correctly, or
    removed.
    """

    neither: int
    only_first: int
    only_second: int
    both: int

    @property
    def shares(self) -> tuple[float, float]:
        """Points of the first and of the second run, percent; NaN without points."""
        total = self.neither + self.only_first + self.only_second + self.both
        return float(percent(self.only_first + self.both, total)), float(
            percent(self.only_second + self.both, total)
        )


@dataclass(frozen=True, slots=True)
class AgreementByTruth:
    """Agreement on static and on dynamic points."""

    static: Agreement
    dynamic: Agreement


@dataclass(frozen=True, slots=True)
class RangeAgreement:
    """Agreement within a band of ranges from the sensor."""

    band: str
    static: Agreement
    dynamic: Agreement


@dataclass(frozen=True, slots=True)
class ReasonPair:
    """Points by truth, agreement and the reasons of the runs that are wrong.

    The reason of a correct run is None.
    """

    truth: str
    right: str
    first_reason: str | None
    second_reason: str | None
    points: int


@dataclass(frozen=True, slots=True)
class WrongPointCounts:
    """Static points removed (FP) and dynamic points kept (FN)."""

    FP: int
    FN: int


@dataclass(frozen=True, slots=True)
class FrameChange:
    """A frame that changes the scores.

    Attributes:
        frame: position in the run.
        index: number in the data set.
        gain: sum of ``gain_SA`` and ``gain_DA``, percentage points; positive where the second run
            is better.
        first, second: wrong points of each run.
    """

    frame: int
    index: int
    gain: float
    gain_SA: float
    gain_DA: float
    first: WrongPointCounts
    second: WrongPointCounts


@dataclass(frozen=True, slots=True)
class PlaceChange:
    """A square column of the world that changes the scores.

    Attributes:
        low, high: corners in x and y, metres, world frame.
        height: mean z of the wrong points, metres.
        frame: the frame that contributes most.
        gain, gain_SA, gain_DA, first, second: as for ``FrameChange``.
    """

    low: tuple[float, float]
    high: tuple[float, float]
    height: float
    frame: int
    gain: float
    gain_SA: float
    gain_DA: float
    first: WrongPointCounts
    second: WrongPointCounts


@dataclass(frozen=True, slots=True)
class RangeRemoved:
    """Removed points within a band of ranges from the sensor."""

    band: str
    points: Agreement


@dataclass(frozen=True, slots=True)
class RemovalReasons:
    """Points that only one run removed (``only_first`` or ``only_second``), by the reasons of both
    runs.
    """

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

    points: Agreement
    by_range: tuple[RangeRemoved, ...]
    by_reason: tuple[RemovalReasons, ...]


@dataclass(frozen=True, slots=True)
class PairComparison:
    """What differs between two runs.

    Attributes:
        first, second: letters of the runs.
        scores: by score, with confidence intervals.
        right: labelled points by agreement.
        by_range: the same, by range from the sensor.
        by_reason: wrong points by reason, most points first.
        frames, places: those with the largest gains; places are None if a recording has no
            coordinates.
        places_note: what a place is, or why there are none.
        differ: settings that differ.
        runtime: ratio of runtimes.
        removed: what the runs removed, if there is no ground truth; else None.
        over_movers: 95 % intervals of the change of DA and AA if the movers are drawn again; empty
            if movers are few or unknown.
        objects: moving objects with a number of which they removed different shares, at most
            ``MOST``, those that change DA most first.
        surfaces: static surfaces of which they removed different numbers of points, by their listed
            cases, at most ``MOST``, those that change SA most first.
    """

    first: str
    second: str
    scores: ByScore[ScoreChange]
    right: AgreementByTruth
    by_range: tuple[RangeAgreement, ...]
    by_reason: tuple[ReasonPair, ...]
    frames: tuple[FrameChange, ...]
    places: tuple[PlaceChange, ...] | None
    places_note: str
    differ: tuple[SettingChange, ...]
    runtime: RuntimeRatio
    removed: RemovalComparison | None = None
    over_movers: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    objects: tuple[ObjectChange, ...] = ()
    surfaces: tuple[SurfaceChange, ...] = ()


def compare_pair(
    letters: tuple[str, str],
    results: tuple[Result, Result],
    counts: AgreementCounts,
    reasons: tuple[ReasonNames, ReasonNames],
    places: SpatialGains | None,
    places_note: str,
) -> PairComparison:
    """Build the comparison of two runs from their counts.

    Args:
        letters: of the runs.
        results: of the runs.
        counts: their agreement.
        reasons: names of their reason codes.
        places: gains by place; None if a recording has no coordinates.
        places_note: what a place is, or why there are none.
    """
    return PairComparison(
        *letters,
        scores=_score_changes(counts),
        right=AgreementByTruth(*_by_truth(counts.points)),
        by_range=tuple(
            RangeAgreement(name, *_by_truth(counts.bands[..., i]))
            for i, name in enumerate(BAND_NAMES)
        ),
        by_reason=_by_reason(counts.reasons, reasons),
        frames=_frame_changes(counts),
        places=None if places is None else _place_changes(places),
        places_note=places_note,
        differ=setting_changes(*results),
        runtime=runtime_ratio(*results),
        removed=_removals(counts, reasons),
        over_movers=change_intervals(*results),
        objects=object_changes(*results)[:MOST],
        surfaces=surface_changes(*results)[:MOST],
    )


def run_scores(points: I64) -> tuple[Scores, Scores]:
    """Scores of the first and of the second run; points (2, 4) by truth and agreement."""
    first, second = scores(points)
    return ByScore(*(_plain(v) for _, v in first.items())), ByScore(
        *(_plain(v) for _, v in second.items())
    )


def _score_changes(counts: AgreementCounts) -> ByScore[ScoreChange]:
    rows = zip(
        *(by.items() for by in (*scores(counts.points), intervals(counts.frames))), strict=True
    )
    return ByScore(
        *(
            ScoreChange(_plain(a), _plain(b), _plain(b - a), within)
            for (_, a), (_, b), (_, within) in rows
        )
    )


def _by_truth(points: I64) -> tuple[Agreement, Agreement]:
    static, dynamic = points.tolist()
    return Agreement(*static), Agreement(*dynamic)


def _by_reason(counts: I64, names: tuple[ReasonNames, ReasonNames]) -> tuple[ReasonPair, ...]:
    """Points by the reasons of the runs that are wrong, most points first."""
    rows: list[ReasonPair] = []
    for truth, kind in np.ndindex(len(TRUTHS), BOTH):
        points = counts[truth, kind]
        # Only errors are broken down by reason: sum over the reasons of a run that is right.
        points = points.sum(0, keepdims=True) if kind == FIRST else points
        points = points.sum(1, keepdims=True) if kind == SECOND else points
        for i, j in np.argwhere(points).tolist():
            first = None if kind == FIRST else names[0].get(i, str(i))
            second = None if kind == SECOND else names[1].get(j, str(j))
            rows.append(
                ReasonPair(TRUTHS[truth], AGREEMENT[kind], first, second, int(points[i, j]))
            )
    return tuple(sorted(rows, key=lambda row: -row.points))


def _removals(
    counts: AgreementCounts, names: tuple[ReasonNames, ReasonNames]
) -> RemovalComparison | None:
    """What the runs removed; None if there is ground truth."""
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
        Agreement(*bands.sum(1).tolist()),
        tuple(
            RangeRemoved(name, Agreement(*bands[:, i].tolist()))
            for i, name in enumerate(BAND_NAMES)
        ),
        tuple(sorted(rows, key=lambda row: -row.points)),
    )


def _frame_changes(counts: AgreementCounts) -> tuple[FrameChange, ...]:
    gain = frame_gains(counts)
    sides = scores(counts.frames)
    return tuple(
        FrameChange(
            int(f),
            int(counts.index[f]),
            *_gain(gain[f]),
            *(WrongPointCounts(int(side.FP[f]), int(side.FN[f])) for side in sides),
        )
        for f in largest(gain)[:MOST]
    )


def _place_changes(places: SpatialGains) -> tuple[PlaceChange, ...]:
    found = []
    for k in places.order()[:MOST]:
        x, y, height = places.low[k].tolist()
        first, second = (WrongPointCounts(*wrong) for wrong in places.wrong[k].tolist())
        high = (x + places.size, y + places.size)
        found.append(
            PlaceChange(
                (x, y), high, height, int(places.frame[k]), *_gain(places.gain[k]), first, second
            )
        )
    return tuple(found)


def _gain(gain: F64) -> tuple[float, float, float]:
    return float(gain.sum()), float(gain[0]), float(gain[1])


def _plain(value: F64) -> float | None:
    return float(value) if np.isfinite(value) else None
