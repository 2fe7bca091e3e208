"""Whether scans are compensated for motion already, although their points have times.

Programs that deskew a cloud often keep its field of times. Deskewed twice, a map is as wrong as if
it was never deskewed. Both readings are tried on pairs of scans that see the same surfaces from
elsewhere: with the right one, the surfaces are thinner.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F64, I64, Bool
from dynaviz.contracts.scan import Scan
from dynaviz.sources.hypotheses.views import ScanView, comparable
from dynaviz.spatial.trajectory import PosesOverTime

PAIRS = 5  # of scans that are compared
WAY = (2.0, 6.0)  # metres that the sensor moves between the two scans of a pair
SHORTEST = 0.04  # metres of travel during a sweep, from which the readings differ
TURN = 0.004  # radians of rotation during a sweep, likewise
NEAR = 0.4  # metres from a surface of the other scan
CLEAR = 0.9  # factor by which the better reading must reduce the distance
MOST = 0.6  # share of the pairs in which it must do so
READ = 30_000  # points of a scan that are read, at random
POINTS = 3000  # of these that are compared

Read = Callable[[int], tuple[Scan, Scan]]


@dataclass(frozen=True)
class Sweeps:
    """Which reading of the sweeps fits.

    Attributes:
        deskewed: whether the points are compensated already; None if nobody can tell.
        centimetres: median distance from surfaces of other scans if the points are deskewed here,
            and if they are taken as they are; None if nothing was compared.
    """

    deskewed: bool | None
    centimetres: tuple[float, float] | None = None

    @property
    def words(self) -> str:
        """The measures in words."""
        if self.centimetres is None:
            return ""
        here, taken = self.centimetres
        return f"surfaces of other scans are {here:.1f} cm away with it, {taken:.1f} cm without it"


def judge_sweeps(read: Read, poses: F64, stamps: I64, path: PosesOverTime) -> Sweeps:
    """Compare both readings on some pairs of scans.

    Args:
        read: reads about ``READ`` points of a scan by its position, deskewed and as they are.
        poses: (N, 4, 4) float64, metres, of the scans; stamps: (N,) int64, nanoseconds.
        path: poses over time.
    """
    pairs = [pair for pair in _pairs(poses) if _moves(pair[1], stamps, path)]
    figures = [each for pair in pairs if (each := _distances(read, *pair)) is not None]
    if not figures:
        return Sweeps(None)
    here, taken = np.array(figures).T
    shown = 100 * float(np.median(here)), 100 * float(np.median(taken))
    if (taken < CLEAR * here).mean() >= MOST and shown[1] < CLEAR * shown[0]:
        return Sweeps(True, shown)
    if (here < CLEAR * taken).mean() >= MOST and shown[0] < CLEAR * shown[1]:
        return Sweeps(False, shown)
    return Sweeps(None, shown)


def _pairs(poses: F64) -> list[tuple[int, int]]:
    """Pairs of scans, spread over the drive, some metres apart."""
    found = []
    where = poses[:, :3, 3]
    for first in np.unique(np.linspace(0, max(len(poses) - 2, 0), 2 * PAIRS).astype(int)).tolist():
        way = np.linalg.norm(where[first + 1 :] - where[first], axis=1)
        far = np.flatnonzero((way >= WAY[0]) & (way <= WAY[1]))
        if len(far):
            found.append((first, first + 1 + int(far[len(far) // 2])))
    chosen = np.unique(np.linspace(0, len(found) - 1, PAIRS).astype(int)) if found else ()
    return [found[k] for k in chosen]


def _moves(position: int, stamps: I64, path: PosesOverTime) -> bool:
    """Whether the sensor moves or turns enough during a sweep for the readings to differ."""
    a, b = path.at(np.array([stamps[position], stamps[position] + 100_000_000]))
    turn = np.arccos(np.clip((np.trace(a[:3, :3].T @ b[:3, :3]) - 1) / 2, -1, 1))
    return bool(np.linalg.norm(b[:3, 3] - a[:3, 3]) > SHORTEST or turn > TURN)


def _distances(read: Read, first: int, last: int) -> tuple[float, float] | None:
    """Metres between a scan and surfaces of another one, deskewed and as it is."""
    found = []
    for scans in zip(read(first), read(last), strict=True):
        views = [ScanView(scan) for scan in scans]
        if not comparable(views):
            return None
        points = views[1].points
        points = points[:: 1 + len(points) // POINTS]
        heights = np.abs(views[0].surface.heights(points)[0])
        near = heights[heights < NEAR]
        if len(near) < 100:
            return None
        found.append(float(np.mean(near)))
    return found[0], found[1]


@dataclass(frozen=True)
class SweepTimes:
    """When a spinning sensor looks where: the time of a point in the sweep by its azimuth.

    Attributes:
        offsets: (BINS,) float64: units of the driver after the first point of the sweep; NaN where
            no point was seen.
        steady: whether all sweeps begin at the same azimuth, so that the table holds.
    """

    offsets: F64
    steady: bool

    @classmethod
    def of(cls, sweeps: Sequence[tuple[F64, F64]]) -> SweepTimes:
        """From some sweeps: points (N, 3) in the sensor frame, and times (N,) after the first."""
        sums = np.zeros(BINS)
        squares = np.zeros(BINS)
        counts = np.zeros(BINS)
        for points, times in sweeps:
            rows = _bins(points)
            counts += np.bincount(rows, minlength=BINS)
            sums += np.bincount(rows, times, BINS)
            squares += np.bincount(rows, times**2, BINS)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = sums / counts
            spread = np.sqrt(np.maximum(squares / counts - mean**2, 0.0))
        longest = max((float(np.ptp(times)) for _, times in sweeps if len(times)), default=0.0)
        known = np.isfinite(mean)
        steady = bool(known.any()) and longest > 0
        return cls(mean, steady and float(np.median(spread[known])) < 0.05 * longest)

    def at(self, points: F64) -> tuple[F64, Bool]:
        """Times of points, (N,), and whether each is known."""
        found = self.offsets[_bins(points)]
        return found, np.isfinite(found)


BINS = 360  # of azimuth


def _bins(points: F64) -> I64:
    azimuth = np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) + 0.5
    bins: I64 = np.clip(azimuth * BINS, 0, BINS - 1).astype(np.int64)
    return bins
