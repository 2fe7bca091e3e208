"""Whether estimated poses hold.

They place neighbouring scans on each other. If not quite, other starts are tried: registration of
the same scans from another guess, and the odometry from the middle of the drive.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F64
from dynaviz.contracts.scan import Scan
from dynaviz.sources.hypotheses.judge import Points
from dynaviz.sources.hypotheses.registration import register
from dynaviz.sources.hypotheses.views import ScanView, comparable
from dynaviz.spatial import geometry

PAIRS = 5  # of neighbouring scans
SURE = 0.85  # share of a scan on the surfaces of the one before, of poses that hold
OVERLAPS = 0.4  # the same, of poses that may hold
BETTER = 0.1  # of this share, from another guess, in most pairs, of poses that do not hold
POINTS = 2000  # of a scan that are registered
AHEAD = np.arange(-4.0, 4.1, 0.5)  # metres of other guesses, along the sensor's way
ASIDE = (-0.5, 0.0, 0.5)
RESTART = 10  # sweeps of the second start
APART = 0.3  # metres by which a second start may differ
OF_WAY = 0.15  # the same, as a share of its way


@dataclass(frozen=True)
class PoseCheck:
    """What speaks for estimated poses.

    Attributes:
        overlap: share of a scan on the surfaces of the one before, mean of some pairs.
        better: share of the pairs that fit clearly better from another guess.
        other: the same as overlap, from the best guesses.
        apart: metres by which a second start from the middle ends elsewhere.
        way: metres that the sensor moves from there.
    """

    overlap: float
    better: float = 0.0
    other: float = 0.0
    apart: float = 0.0
    way: float = 0.0

    @property
    def sure(self) -> bool:
        """Whether nothing else needs to be tried."""
        return self.overlap >= SURE

    @property
    def holds(self) -> bool:
        """Whether the poses are plausible."""
        agrees = self.apart <= max(APART, OF_WAY * self.way)
        return self.sure or (self.overlap >= OVERLAPS and self.better < 0.5 and agrees)

    def __str__(self) -> str:
        return (
            f"{self.overlap:.0%} of a scan lies on the one before, from another guess "
            f"{self.other:.0%}, and a second start differs by {self.apart:.2f} m after "
            f"{self.way:.1f} m"
        )


def restart_frames(frames: int) -> tuple[int, int]:
    """First frame of the second start, and the frame after its last."""
    first = frames // 2
    return first, min(first + RESTART, frames)


def check_poses(poses: F64, points: Points, restart: Callable[[], F64]) -> PoseCheck:
    """Check estimated poses.

    Args:
        poses: (N, 4, 4) float64, metres, of all sweeps.
        points: reads a sweep, (M, 3), metres, in its sensor frame, compensated for motion.
        restart: estimates the poses of ``restart_frames`` again, (K, 4, 4), in the frame of the
            first; called only if needed.
    """
    rows = []
    pairs = np.unique(np.linspace(0, len(poses) - 2, PAIRS).astype(int)).tolist()
    views = [(_view(poses, points, k), _view(poses, points, k + 1)) for k in pairs]
    views = [pair for pair in views if comparable(pair)]
    if not views:
        return PoseCheck(1.0)
    given = [a.surface.overlap(b.points) for a, b in views]
    found = PoseCheck(float(np.mean(given)))
    if found.sure:
        return found
    rows = [_from_other_guesses(a, b) for a, b in views]
    better = float(np.mean(np.array(rows) > np.array(given) + BETTER))
    again = restart()
    first, end = restart_frames(len(poses))
    way = geometry.inverse(poses[first]) @ poses[end - 1]
    apart = float(np.linalg.norm(again[-1][:3, 3] - way[:3, 3]))
    return PoseCheck(
        found.overlap, better, float(np.mean(rows)), apart, float(np.linalg.norm(way[:3, 3]))
    )


def _view(poses: F64, points: Points, row: int) -> ScanView:
    return ScanView(Scan(row, geometry.transform(poses[row], points(row)), poses[row]))


def _from_other_guesses(a: ScanView, b: ScanView) -> float:
    """Share of b on the surfaces of a after registration from the best other guess."""
    few = b.points[:: 1 + len(b.points) // POINTS]
    ahead = b.T[:3, 0]
    aside = b.T[:3, 1]
    guesses = [x * ahead + y * aside for x in AHEAD.tolist() for y in ASIDE]
    guesses.sort(key=lambda shift: -a.surface.overlap(few[::4] + shift))
    best = 0.0
    for shift in guesses[:2]:
        T = register(a.surface, few + shift)
        placed = geometry.apply(T, b.points + shift)
        best = max(best, a.surface.overlap(placed))
    return best
