"""Evidence at a place: the rays of all scans that ended there, and those that passed through it. Pure geometry."""

from __future__ import annotations

from collections.abc import Sequence as Several
from dataclasses import dataclass, field

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I64, U8, Intp
from dynaviz.contracts.scan import Scan, Sequence, SequenceSlice, stream
from dynaviz.spatial.surface import surface_normal

HIT, CROSSED, GRAZED = 1, 2, 3  # classes of rays
NAMES = {
    HIT: "hit: evidence for static",
    CROSSED: "crossed: evidence for dynamic",
    GRAZED: "grazed the surface: weak evidence for dynamic",
}
REACH = 50.0  # metres between the sensor and a place; scans from farther away are not searched
SCANS = 40  # scans that are searched at most, evenly spread over those within reach
STRIPS = 60  # rays drawn per place
ABOUT = 1.0  # metres: a place reaches this far from the middle of its points along each axis
MARGIN = 0.1  # metres around the points of a place, about half a voxel
GRAZING = np.sin(np.radians(10.0))  # a ray that meets the surface at a smaller angle only grazes it


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A box with the points to explain.

    Attributes:
        low, high: (3,) float64, metres, world frame.
        normal: (3,) float64, unit length: of the surface through the points; None if they do not lie on one.
    """

    low: F64
    high: F64
    normal: F64 | None

    @classmethod
    def of(cls, points: F32) -> Place:
        """The place in the middle of (N, 3) finite points, metres, world frame; N >= 1."""
        wide = points.astype(np.float64)
        middle = wide[np.argmin(((wide - np.median(wide, axis=0)) ** 2).sum(1))]
        chosen = wide[(np.abs(wide - middle) <= ABOUT).all(1)]
        return cls(chosen.min(0) - MARGIN, chosen.max(0) + MARGIN, surface_normal(chosen))


@dataclass(slots=True, eq=False)
class Witnesses:
    """The rays that touched a place.

    Attributes:
        rays, scans: number of rays of each class, and of scans that have such rays.
        searched: number of scans searched.
        frames: (K,) positions in the run, kinds: (K,) classes, strips: (K, 2, 3) float32, metres, world frame, from
            the sensor to the end of each ray: at most ``STRIPS`` rays, spread over scans.
    """

    rays: dict[int, int] = field(default_factory=lambda: dict.fromkeys(NAMES, 0))
    scans: dict[int, int] = field(default_factory=lambda: dict.fromkeys(NAMES, 0))
    searched: int = 0
    frames: I64 = field(default_factory=lambda: np.empty(0, np.int64))
    kinds: U8 = field(default_factory=lambda: np.empty(0, np.uint8))
    strips: F32 = field(default_factory=lambda: np.empty((0, 2, 3), np.float32))

    def text(self) -> str:
        """The evidence in a sentence or two, as Markdown."""
        if not any(self.rays.values()):
            return f"No ray of {self.searched} scans hit or crossed its middle."
        scans = f"{self.scans[HIT]} scan{'s' * (self.scans[HIT] != 1)}"
        static = f"{self.rays[HIT]:,} rays of {scans} hit its middle: evidence for static"
        passed = self.rays[CROSSED] + self.rays[GRAZED]
        if not passed:
            return f"{static}; none of the {self.searched} scans saw through it."
        share = f", {100 * self.rays[GRAZED] / passed:.0f} % of them at less than 10° to its surface"
        return f"{static}; {passed:,} rays crossed it{share if self.rays[GRAZED] else ''}: evidence for dynamic."


def find(sequence: Sequence, positions: F64, places: Several[Place]) -> list[Witnesses]:
    """Search the scans for rays that touch places, in one walk.

    Args:
        sequence: the frames of the run.
        positions: (frames, 3) metres, world frame: the sensor's positions.
        places: at most ``kernels.witnesses.MOST``.

    Returns:
        The witnesses of each place.

    Raises:
        DataError: for a scan that cannot be read.
    """
    found = [Witnesses() for _ in places]
    drawn: list[list[_Strips]] = [[] for _ in places]
    low, high = (np.array([getattr(place, side) for place in places]).reshape(-1, 3) for side in ("low", "high"))
    near = np.linalg.norm(positions[:, None] - (low + high) / 2, axis=2) < REACH
    frames = _spread(np.flatnonzero(near.any(1)))
    searched = SequenceSlice(sequence, frames, sequence.sensor, sequence.name)
    for frame, scan in zip(frames, stream(searched), strict=True):
        here = np.flatnonzero(near[frame])
        hit, crossed = kernels.witnesses.touched(scan.points, scan.origins, low[here], high[here])
        touching = np.flatnonzero(hit | crossed)
        hit, crossed = hit[touching], crossed[touching]
        for bit, place in enumerate(here.tolist()):
            ends, passes = (touching[(mask >> np.uint32(bit) & 1).astype(bool)] for mask in (hit, crossed))
            found[place].searched += 1
            drawn[place].append(_count(found[place], frame, scan, ends, passes, places[place].normal))
    for witnesses, strips in zip(found, drawn, strict=True):
        _choose(witnesses, strips)
    return found


_Strips = tuple[I64, U8, F32]  # frames, kinds and strips, as in ``Witnesses``
SAMPLES = 6  # rays of each side that a scan offers for drawing


def _spread(frames: Intp) -> range:
    """At most about ``SCANS`` frames, evenly spread from the first to the last of these."""
    if not len(frames):
        return range(0)
    return range(int(frames[0]), int(frames[-1]) + 1, 1 + int(frames[-1] - frames[0]) // SCANS)


def _count(found: Witnesses, frame: int, scan: Scan, ends: Intp, passes: Intp, normal: F64 | None) -> _Strips:
    """Count the rays of a scan, and offer some of them for drawing."""
    kinds = np.full(len(passes), CROSSED, np.uint8)
    if normal is not None:
        along = scan.points[passes] - _origins(scan, passes)
        kinds[np.abs(along @ normal) < GRAZING * np.linalg.norm(along, axis=1)] = GRAZED
    for kind, count in ((HIT, len(ends)), *((k, int((kinds == k).sum())) for k in (CROSSED, GRAZED))):
        found.rays[kind] += count
        found.scans[kind] += count > 0
    few_ends, few_passes = _evenly(len(ends), SAMPLES), _evenly(len(passes), SAMPLES)
    rays = np.concatenate([ends[few_ends], passes[few_passes]])
    kinds = np.concatenate([np.full(len(few_ends), HIT, np.uint8), kinds[few_passes]])
    strips = np.empty((len(rays), 2, 3), np.float32)
    strips[:, 0], strips[:, 1] = _origins(scan, rays), scan.points[rays]
    return np.full(len(rays), frame), kinds, strips


def _choose(found: Witnesses, offered: list[_Strips]) -> None:
    """Keep ``STRIPS`` rays: half of them hits, if there are enough of each side, spread over scans."""
    if not offered:
        return
    frames, kinds, strips = (np.concatenate(parts) for parts in zip(*offered, strict=True))
    hits, passes = np.flatnonzero(kinds == HIT), np.flatnonzero(kinds != HIT)
    many = min(len(hits), max(STRIPS // 2, STRIPS - len(passes)))
    hits, passes = hits[_evenly(len(hits), many)], passes[_evenly(len(passes), STRIPS - many)]
    chosen = np.sort(np.concatenate([hits, passes]))
    found.frames, found.kinds, found.strips = frames[chosen], kinds[chosen], strips[chosen]


def _evenly(count: int, most: int) -> Intp:
    """At most ``most`` indices below ``count``, evenly spread."""
    if count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).round().astype(np.intp)  # more than 1 apart: all differ


def _origins(scan: Scan, rays: Intp) -> F64:
    """(1, 3) or (K, 3): the origins of some rays."""
    return scan.origins if len(scan.origins) == 1 else scan.origins[rays]
