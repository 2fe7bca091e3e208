"""Check whether two drives are in one world frame: static surfaces that both see must coincide."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F64
from dynaviz.contracts.scan import Scan, Sequence
from dynaviz.diagnosis.drift import AWAY, SEEN_AGAIN, Drift
from dynaviz.errors import DataError
from dynaviz.sources.hypotheses.views import ScanView, comparable

PLACES = 6  # at which a scan of each drive is compared
COARSE = 48  # scans of each drive among which places are looked for first
_HINT = (
    "Register both drives in one world frame first: in one session of a SLAM system, or with its "
    "localisation"
)


@dataclass(frozen=True)
class DriveAgreement:
    """How well two drives agree.

    Attributes:
        places: number of pairs of scans that were compared.
        apart: of these, the pairs that registration moves from beside surfaces onto them.
        median_m: median distance of points of the second drive from surfaces of the first, metres,
            at the median place.
    """

    places: int
    apart: int
    median_m: float

    def __str__(self) -> str:
        places = f"{self.places} place{'s' * (self.places != 1)}"
        beside = (
            f"; at {self.apart} of them, registration moves one onto the other"
            if self.apart
            else ""
        )
        return f"the drives agree within {100 * self.median_m:.1f} cm at {places}{beside}"


def compare_drives(first: Sequence, second: Sequence) -> DriveAgreement:
    """Compare scans of two drives at places that both pass.

    Raises:
        DataError: if the drives do not pass the same place, or do not agree at most places.
    """
    found = [Drift.between(a, b) for a, b in _pairs(first, second)]
    names = f"{first.name} and {second.name}"
    if not found:
        raise DataError(
            names, f"pass no common place within {2 * AWAY:.0f} m of each other", hint=_HINT
        )
    apart = [each for each in found if each.clear]
    given = float(np.median([each.given for each in found]))
    if 2 * len(apart) > len(found) or given < SEEN_AGAIN:
        worst = max(apart or found, key=lambda each: each.metres)
        problem = (
            f"do not agree at {len(apart) or len(found)} of {len(found)} places: at the median "
            f"place, {given:.0%} of a "
            f"scan lies on surfaces of the other drive"
        )
        if apart:
            problem += (
                f". From frame {worst.a.index} to {worst.b.index}, registration moves the scan by "
                f"{worst.metres:.2f} m "
                f"({worst.vertical:+.2f} m along z) and {worst.degrees:.1f} degrees"
            )
        raise DataError(names, problem, hint=_HINT)
    return DriveAgreement(
        len(found), len(apart), float(np.median([_distance(each) for each in found]))
    )


def _distance(found: Drift) -> float:
    """Median distance of the points of a scan from surfaces of the other, metres.

    Without points that it lacks.
    """
    heights = np.abs(found.a.surface.heights(found.b.points)[0])
    return float(np.median(heights[np.isfinite(heights)])) if np.isfinite(heights).any() else np.inf


def _pairs(first: Sequence, second: Sequence) -> Iterator[tuple[ScanView, ScanView]]:
    """Scans of the first drive, spread over it, and the scan of the second that was measured
    nearest to each.
    """
    way = _Way(first)
    other = _Way(second)
    near = [k for k in range(len(way.places)) if way.distances(other)[k] < 2 * AWAY + other.step_m]
    for k in np.unique(np.linspace(0, len(near) - 1, PLACES).astype(int)).tolist() if near else []:
        a = first[way.positions[near[k]]]
        b = other.nearest(a.position)
        if np.linalg.norm(a.position - b.position) < 2 * AWAY:
            views = ScanView(a), ScanView(b)
            if comparable(views):
                yield views


class _Way:
    """Some of the places that the sensor passes in a drive."""

    def __init__(self, drive: Sequence) -> None:
        self._drive = drive
        self._step = max(1, len(drive) // COARSE)
        self.positions = range(0, len(drive), self._step)
        self.places = np.array([drive[position].position for position in self.positions])
        self.step_m = float(np.linalg.norm(np.diff(self.places, axis=0), axis=1).max(initial=0.0))

    def distances(self, other: _Way) -> F64:
        """(K,) metres: from each place to the nearest one of another drive."""
        nearest: F64 = np.linalg.norm(self.places[:, None] - other.places, axis=2).min(1)
        return nearest

    def nearest(self, place: F64) -> Scan:
        """The scan that was measured nearest to a place, (3,) metres, or close to that one."""
        away = np.linalg.norm(self.places - place, axis=1)
        best = self.positions[int(np.argmin(away))]
        least = float(away.min())
        step = self._step
        while step > 1:
            step //= 2
            for position in (best - step, best + step):
                if 0 <= position < len(self._drive):
                    distance = float(np.linalg.norm(self._drive[position].position - place))
                    if distance < least:
                        best = position
                        least = distance
        return self._drive[best]
