"""Check whether poses drift.

Places seen twice, after some metres or minutes, must coincide without registration.

Errors of poses that grow slowly do not show between neighbouring scans. They show where the sensor
has moved on by ``AWAY``, where it stood still or was in slow traffic, and where it came back.
There, one scan is registered to the other: if it then lies on surfaces that it misses with the
given poses, the poses have moved, and not the scene.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F64
from dynaviz.diagnosis.alignment import GAIN
from dynaviz.diagnosis.finding import SHOWN, Confidence, Finding
from dynaviz.sources.hypotheses.registration import register
from dynaviz.sources.hypotheses.views import ON_SURFACE, ScanView, angle
from dynaviz.spatial import geometry

DRIFT = "poses drift"  # name of the finding
# metres between the two scans of a pair: to most surfaces near a mover, and at least
AWAY = 10.0
SHORTEST = 3.0
# metres between two looks at a place from the same position, and frames between them, at least
BACK = 5.0
LATER = 20
POINTS = 6_000  # of a scan, at most, which are registered
# metres across a surface, and share of the points that registration moves so far
ACROSS = 0.2
MOVED = 0.2
SEEN_AGAIN = (
    0.3  # share of a scan that must lie on the other after registration: fewer points fit by chance
)


@dataclass(frozen=True)
class Drift:
    """How far poses drift from one scan to another.

    Attributes:
        a, b: the scans.
        metres, vertical, degrees: by which registration moves the sensor of b: in space, along z,
            and its rotation.
        given, registered: share of the points of b on surfaces of a, with given poses and after
            registration.
        moved: share of the latter that registration moves by more than ``ACROSS`` across the
            surface.
    """

    a: ScanView
    b: ScanView
    metres: float
    vertical: float
    degrees: float
    given: float
    registered: float
    moved: float

    @classmethod
    def between(cls, a: ScanView, b: ScanView) -> Drift:
        """Register a scan to another."""
        points = b.points[:: 1 + len(b.points) // POINTS]
        T = register(a.surface, points)
        shift = (geometry.compose(T, b.T) - b.T)[:3, 3]
        placed = geometry.apply(T, points)
        heights, normals = a.surface.heights(placed)
        on = np.abs(heights) < ON_SURFACE
        across = np.abs(((placed - points) * normals).sum(1))[on] > ACROSS
        shares = (
            a.surface.overlap(points),
            float(on.mean()),
            float(across.mean()) if on.any() else 0.0,
        )
        return cls(a, b, float(np.linalg.norm(shift)), float(shift[2]), angle(T), *shares)

    @property
    def clear(self) -> bool:
        """Whether registration moves much of the scan from beside surfaces onto them."""
        gain = self.registered - self.given
        return self.registered > SEEN_AGAIN and self.moved > MOVED and gain > GAIN


def looks(
    positions: Sequence[int], poses: Sequence[F64], usable: Sequence[bool], number: int
) -> Iterator[tuple[int, int]]:
    """Pairs of scans that see a place from a distance of ``AWAY``, and again later from near the
    same position.

    Args:
        positions, poses, usable: of the scans.
        number: of scans, spread over the sequence, to which others are compared.

    Yields:
        Rows of the arguments.
    """
    rows = np.flatnonzero(usable)
    where = np.array([poses[row][:3, 3] for row in rows.tolist()]).reshape(-1, 3)
    frame = np.asarray(positions)[rows]
    for k in np.unique(np.linspace(0, max(len(rows) - 2, 0), number).astype(int)):
        distances = np.linalg.norm(where[k + 1 :] - where[k], axis=1)
        away = np.flatnonzero((distances >= AWAY) & (distances < 2 * AWAY))
        ends = (
            away[:1]
            if len(away)
            else np.flatnonzero((distances >= SHORTEST) & (distances < AWAY))[-1:]
        )
        back = np.flatnonzero((distances <= BACK) & (frame[k + 1 :] - frame[k] >= LATER))[-1:]
        for other in {*ends.tolist(), *back.tolist()}:
            yield int(rows[k]), int(rows[k + 1 + other])


def check_drift(views: Iterable[tuple[ScanView, ScanView]]) -> Iterator[Finding]:
    """A finding if a place that is seen twice lies elsewhere by the given poses than after
    registration.
    """
    found = [drift for a, b in views if (drift := Drift.between(a, b)).clear]
    if not found:
        return
    worst = max(found, key=lambda each: each.metres)
    frames = sorted({index for each in found for index in (each.a.index, each.b.index)})
    problem = (
        f"from frame {worst.a.index} to {worst.b.index} the poses drift by {worst.metres:.2f} m "
        f"({worst.vertical:+.2f} m along z) and {worst.degrees:.1f} degrees: {worst.given:.0%} of "
        "a scan lies on "
        f"the surfaces of the other, after registration {worst.registered:.0%}"
    )
    fix = "Estimate the poses from the scans: --poses small-gicp"
    confidence = Confidence.CERTAIN if len(found) > 1 else Confidence.LIKELY
    yield Finding(DRIFT, confidence, problem, fix, tuple(frames[:SHOWN]), len(frames))
