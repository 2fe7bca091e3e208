"""Judge interpretations of a source by the same measures, on a few pairs of scans.

- *Overlap*: with the right interpretation, a scan lies on the surfaces of another one.
- *Hidden*: seen from where it was measured, a scan hides few of its own points.
- *Crossed*: rays do not pass through surfaces, so few points are behind surfaces of another scan.
- *Ground*: the ground is below the sensor, never above or beside it.
- *Smooth*: a sensor moves smoothly from scan to scan.

An interpretation wins if it is clearly better than each other one that places the scans elsewhere,
and if it is good by itself. Otherwise the answer is that nobody can tell, with the measures.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynaviz.arrays import F64
from dynaviz.contracts.scan import Scan
from dynaviz.sources.hypotheses.views import ScanView, comparable, ground_below, hidden
from dynaviz.spatial import geometry
from dynaviz.spatial.sensor_height import FLAT

PAIRS = 4  # of scans that are compared
CLEAR = 0.06  # difference of two fits from which the better one is clear
GOOD = 0.45  # fit of an interpretation that is good by itself
OVERLAPS = 0.4  # share of a scan on the surfaces of another, of a good one
SAME = 0.02  # metres by which two readings of a pair may differ and be the same
GROUND = 0.25  # what ground below the sensor in every scan is worth, as a share of points
ROUGH = 0.5  # metres; a smooth way changes its step by less than this
FAR_ENOUGH = 0.8  # metres between the two scans of a pair
MOST_APART = 30  # frames between them, at most
UPS = {"below": (0, 0, 1), "above": (0, 0, -1), "left": (0, 1, 0), "right": (0, -1, 0)}

Points = Callable[[int], F64]


@dataclass(frozen=True)
class Measures:
    """What speaks for an interpretation, in shares.

    Attributes:
        overlap: share of a scan's points on surfaces of the other scan of its pair.
        hidden: share of its points behind its own surfaces.
        crossed: share of its points behind surfaces of the other.
        below: share of scans with the ground below the sensor; beside: with ground above it or
            on a side instead.
        rough: metres by which the step changes from scan to scan, median.
    """

    overlap: float
    hidden: float
    crossed: float
    below: float
    beside: float
    rough: float = 0.0

    @property
    def fit(self) -> float:
        """All measures in one number; at most 1.25."""
        rough = min(self.rough / ROUGH, 1.0) * GROUND
        ground = GROUND * (self.below - self.beside)
        return self.overlap - self.hidden - self.crossed + ground - rough

    @property
    def good(self) -> bool:
        """Whether the interpretation is plausible by itself."""
        return self.fit >= GOOD and self.overlap >= OVERLAPS and self.beside < 0.5

    def __str__(self) -> str:
        parts = [f"overlap {self.overlap:.0%}", f"crossed {self.crossed:.1%}"]
        if self.beside >= 0.5:
            parts.append("ground above or beside the sensor")
        elif self.below >= 0.5:
            parts.append("ground below")
        return ", ".join(parts)


@dataclass(frozen=True)
class ReadingChoice:
    """Which interpretation holds.

    Attributes:
        best: name of the one with the best fit.
        sure: whether it is clearly better than the others, and good by itself.
        measures: of all of them by name.
    """

    best: str
    sure: bool
    measures: Mapping[str, Measures]

    @property
    def figures(self) -> str:
        """The measures of all interpretations in words."""
        return "; ".join(f"{name}: {each}" for name, each in self.measures.items())


@dataclass(frozen=True)
class Reading:
    """One interpretation of a drive.

    Attributes:
        poses: (N, 4, 4) float64, metres: T_world_sensor of each scan.
        points: reads the points of a scan in the sensor frame, (M, 3), metres.
    """

    poses: F64
    points: Points


def judge(readings: Mapping[str, Reading]) -> ReadingChoice:
    """Compare readings of the same scans on the same pairs.

    Args:
        readings: by name; all have the same number of scans.

    Raises:
        DataError: for scans that cannot be read.
    """
    chosen = pairs_of([each.poses for each in readings.values()])
    measures = {name: measure(each, chosen) for name, each in readings.items()}
    best = max(measures, key=lambda name: measures[name].fit)
    others = [
        name
        for name in readings
        if name != best and not _alike(readings[name], readings[best], chosen)
    ]
    lead = min(
        (measures[best].fit - measures[name].fit for name in others),
        default=1.0,
    )
    return ReadingChoice(best, bool(chosen) and measures[best].good and lead >= CLEAR, measures)


def pairs_of(ways: Sequence[F64]) -> list[tuple[int, int]]:
    """Pairs of scans, spread over the drive, between which the sensor moves in most readings."""
    frames = min(len(way) for way in ways)
    found = []
    for first in np.unique(np.linspace(0, max(frames - 2, 0), PAIRS).astype(int)).tolist():
        last = min(first + MOST_APART, frames - 1)
        for other in range(first + 1, last + 1):
            moved = [np.linalg.norm(way[other, :3, 3] - way[first, :3, 3]) for way in ways]
            if np.median(moved) >= FAR_ENOUGH:
                last = other
                break
        if last > first:
            found.append((first, last))
    return found


def measure(reading: Reading, pairs: Sequence[tuple[int, int]]) -> Measures:
    """The measures of a reading on pairs of its scans."""
    rows = []
    seen: dict[int, ScanView] = {}
    for first, last in pairs:
        for row in (first, last):
            if row not in seen:
                seen[row] = _view(reading, row)
        a = seen[first]
        b = seen[last]
        if comparable((a, b)):
            here = b.T[None, :3, 3]
            points = b.points[::2] if len(b.points) > 6000 else b.points
            rows.append(
                (
                    a.surface.overlap(points),
                    hidden(b.sample, here),
                    hidden(b.sample, here, a.sample),
                )
            )
    if not rows:
        return Measures(0.0, 0.0, 0.0, 0.0, 0.0)
    overlap, own, other = np.mean(rows, axis=0)
    below, beside = ground_sides([view for view in seen.values() if comparable([view])])
    return Measures(
        float(overlap), float(own), float(other), below, beside, roughness(reading.poses)
    )


def ground_sides(views: Sequence[ScanView]) -> tuple[float, float]:
    """Share of scans that show the ground below the sensor, and above or beside it instead."""
    below = beside = 0
    for view in views:
        flat = {name: ground_below(view, np.array(up, float))[1] for name, up in UPS.items()}
        side = max(flat.values())
        if flat["below"] >= FLAT:
            below += 1
        elif side >= FLAT and side > 1.5 * flat["below"]:
            beside += 1
    number = max(len(views), 1)
    return below / number, beside / number


def roughness(poses: F64) -> float:
    """Median change of the step from scan to scan, metres."""
    if len(poses) < 4:
        return 0.0
    steps = np.diff(poses[:, :3, 3], axis=0)
    changes = np.linalg.norm(np.diff(steps, axis=0), axis=1)
    return float(np.median(changes))


def _view(reading: Reading, row: int) -> ScanView:
    T = reading.poses[row]
    points = geometry.transform(T, np.asarray(reading.points(row)))
    return ScanView(Scan(row, points, T))


def _alike(a: Reading, b: Reading, pairs: Sequence[tuple[int, int]]) -> bool:
    """Whether two readings place the scans of all pairs alike, up to the whole world."""
    if a.points is not b.points or not pairs:
        return False
    for first, last in pairs:
        moves = [geometry.inverse(each.poses[first]) @ each.poses[last] for each in (a, b)]
        lever = 20.0 * np.abs(moves[0][:3, :3] - moves[1][:3, :3]).max()
        if max(float(np.abs(moves[0] - moves[1])[:3, 3].max()), lever) > SAME:
            return False
    ups = [each.poses[pairs[0][0]][2, :3] for each in (a, b)]
    return bool(np.abs(ups[0] - ups[1]).max() < 0.1)


def near_zero(reading: Reading) -> Reading:
    """The reading in a world whose origin is its first pose."""
    poses = reading.poses.copy()
    poses[:, :3, 3] -= poses[0, :3, 3]
    return replace(reading, poses=poses)
