"""Rays without a return.

With regular rings and azimuths, their directions follow from the gaps between returns.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dynaviz.arrays import F64, I64, Bool, Intp

BIN = 0.04  # degrees; width of an elevation bin when beams are searched
# beams
FEWEST = 4
MOST = 160
RETURNS = 20  # a ring with fewer returns is not filled
REGULAR = 0.7  # share of azimuth steps within a quarter of the median step
BACK = 20.0  # degrees; where the azimuth falls back by more than this, another ring begins
NARROW = 3  # rays; a gap up to this width is one of lost returns, not of sky
LEVEL = -3.0  # degrees; beams below this are expected to return from the ground
# degrees; bins of the coverage
COVER_ELEVATION = 1.0
COVER_AZIMUTH = 2.0


@dataclass(frozen=True, eq=False)
class Rings:
    """The returns of one lidar in one sweep, sorted by ring and azimuth; all arrays (M,).

    Attributes:
        rows: rows of the points.
        ring: ring number.
        azimuth, elevation: degrees, in the lidar frame.
        range: metres.
        gap: degrees to the next return of the ring, around the circle.
        next: position in these arrays of that return.
    """

    rows: Intp
    ring: I64
    azimuth: F64
    elevation: F64
    range: F64
    gap: F64
    next: Intp

    @property
    def step(self) -> float:
        """Median azimuth step, degrees."""
        return float(np.median(self.gap))

    @property
    def regular(self) -> bool:
        """Whether most azimuth steps are alike."""
        if len(self.gap) < RETURNS:
            return False
        return bool((np.abs(self.gap / self.step - 1) < 0.25).mean() >= REGULAR)


@dataclass(frozen=True, eq=False)
class Pattern:
    """The regular pattern of a lidar.

    Attributes:
        beams: (B,) float64, degrees: elevations of the beams; empty if points are stored ring by
            ring.
        coverage: bool, by elevation and azimuth bin: whether the lidar ever returned a point there.
    """

    beams: F64
    coverage: Bool = field(default_factory=lambda: np.zeros((180, 180), np.bool_))

    @classmethod
    def infer(cls, scans: list[F64]) -> Pattern | None:
        """Infer the pattern from some sweeps, each (N, 3) float64, metres, lidar frame.

        None if it is not regular.
        """
        angles = [spherical(points) for points in scans]
        beams = np.empty(0)
        if not all(_stored_ring_by_ring(azimuth) is not None for azimuth, _, _ in angles):
            found = find_beams(np.concatenate([elevation for _, elevation, _ in angles]))
            if found is None:
                return None
            beams = found
        pattern = cls(beams)
        for points, (azimuth, elevation, _) in zip(scans, angles, strict=True):
            rings = pattern.rings(points)
            if rings is None or not rings.regular:
                return None
            pattern.coverage[_bins(azimuth, elevation)] = True
        return pattern

    def rings(self, points: F64) -> Rings | None:
        """Sort the points of a sweep, (N, 3) metres in the lidar frame, into rings.

        None if they do not fit.
        """
        azimuth, elevation, distance = spherical(points)
        number = (
            _nearest_beam(elevation, self.beams)
            if len(self.beams)
            else _stored_ring_by_ring(azimuth)
        )
        if number is None or not len(points):
            return None
        rows = np.lexsort((azimuth, number))
        rows = rows[(number[rows] >= 0) & (distance[rows] > 0)]
        if not len(rows):
            return None
        ring = number[rows]
        azimuth = azimuth[rows]
        starts = np.flatnonzero(np.diff(ring, prepend=-1))
        counts = np.diff(starts, append=len(ring))
        following = np.arange(1, len(ring) + 1)
        following[starts + counts - 1] = starts
        gap = (azimuth[following] - azimuth) % 360
        return Rings(rows, ring, azimuth, elevation[rows], distance[rows], gap, following)

    def missing(self, rings: Rings) -> tuple[F64, F64, Intp]:
        """The rays that have no return.

        Gaps between two returns of a ring are filled at equal steps. Azimuths at which the lidar
        never returns a point are left out: they are beyond its field of view. So are directions
        below the horizon that never return a point: the vehicle itself hides them. A ray in a
        narrow gap or well below the horizon lost its return on a surface, which hides what is
        behind it, so the ray is free up to the nearer end of the gap.

        Returns:
            (K, 3) unit directions in the lidar frame; (K,) metres up to which each is free,
            infinite before the sky; (K,) row of the return before the gap.
        """
        per_ring = np.bincount(rings.ring)
        count = np.rint(rings.gap / rings.step).astype(np.int64) - 1
        count[per_ring[rings.ring] < RETURNS] = 0
        count = np.maximum(count, 0)
        first = np.repeat(np.arange(len(count)), count)
        share = (np.arange(len(first)) - np.repeat(np.cumsum(count) - count, count) + 1) / (
            count[first] + 1
        )
        azimuth = rings.azimuth[first] + share * rings.gap[first]
        elevation = (1 - share) * rings.elevation[first] + share * rings.elevation[
            rings.next[first]
        ]
        row, column = _bins(azimuth, elevation)
        own = self.coverage[row, column]
        anywhere: Bool = np.any(self.coverage, axis=0, keepdims=True)[0]
        kept = np.where(elevation < LEVEL, own, anywhere[column])
        a = np.radians(azimuth[kept])
        e = np.radians(elevation[kept])
        nearer = np.minimum(rings.range, rings.range[rings.next])
        limit = np.where((count[first] <= NARROW) | (elevation < LEVEL), nearer[first], np.inf)
        directions = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)
        return directions, limit[kept], rings.rows[first[kept]]


def spherical(points: F64) -> tuple[F64, F64, F64]:
    """Azimuth and elevation in degrees and range in metres of (N, 3) points."""
    x, y, z = points.T
    planar = np.hypot(x, y)
    return np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, planar)), np.hypot(planar, z)


def find_beams(elevation: F64) -> F64 | None:
    """The elevations, degrees, at which nearly all points lie.

    None if the points do not form beams.
    """
    if len(elevation) < 100:
        return None
    edges = np.arange(-90, 90 + BIN, BIN)
    counts, _ = np.histogram(elevation, edges)
    wide = np.convolve(counts, np.ones(3), "same")
    peak = (
        (counts >= np.roll(counts, 1))
        & (counts > np.roll(counts, -1))
        & (wide > 1e-3 * len(elevation))
    )
    beams: F64 = (edges[:-1] + BIN / 2)[peak]
    if not FEWEST <= len(beams) <= MOST or np.diff(beams).min() < 4 * BIN:
        return None
    return beams if (_nearest_beam(elevation, beams) >= 0).mean() > 0.95 else None


def _nearest_beam(elevation: F64, beams: F64) -> I64:
    """(N,) number of the beam of each point, -1 if none is within one and a half bins."""
    after = np.clip(np.searchsorted(beams, elevation), 1, len(beams) - 1)
    near = np.where(
        np.abs(beams[after - 1] - elevation) < np.abs(beams[after] - elevation), after - 1, after
    )
    return np.where(np.abs(beams[near] - elevation) <= 1.5 * BIN, near, -1).astype(np.int64)


def _stored_ring_by_ring(azimuth: F64) -> I64 | None:
    """(N,) ring number if the points are stored ring after ring, each in one turn.

    None if they are not.
    """
    if len(azimuth) < 100:
        return None
    step = (np.diff(azimuth) + 180) % 360 - 180
    if (np.abs(step) < 2.0).mean() < 0.95:
        return None
    turned = (azimuth - azimuth[0]) * (1 if np.median(step) > 0 else -1) % 360
    starts = np.flatnonzero(np.diff(turned) < -BACK) + 1
    starts = starts[np.diff(starts, prepend=0) >= RETURNS]
    if not FEWEST <= len(starts) + 1 <= MOST:
        return None
    ring = np.zeros(len(azimuth), np.int64)
    ring[starts] = 1
    return np.cumsum(ring)


def _bins(azimuth: F64, elevation: F64) -> tuple[I64, I64]:
    row = np.clip((elevation + 90) / COVER_ELEVATION, 0, 179).astype(np.int64)
    return row, ((azimuth + 180) % 360 / COVER_AZIMUTH).astype(np.int64) % 180
