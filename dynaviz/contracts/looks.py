"""Looks: what every scan of a drive saw at some places, the same for every method.

A look is one scan at one place. The scan's returns nearest to the direction from its sensor to the
place answer: they ended there, or beyond, or before; or there were none. A metric that implements
``AsksLooks`` gets the looks at its places after the last scan.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol, runtime_checkable

import numpy as np

from dynaviz.arrays import F32, I32, I64, Bool


class Look(IntEnum):
    """What one scan saw at one place."""

    HIT = 0  # a ray ended there
    THROUGH = 1  # a ray passed through it, and ended beyond
    GRAZING = 2  # the same, at less than 20 degrees to the surface of the place
    HIDDEN = 3  # all rays in its direction ended before it
    BETWEEN = 4  # it lies between rays
    OUTSIDE = 5  # no return around its direction: out of the field of view, or nothing reflects


MARGIN = 0.3  # metres: a ray that ends nearer to a place ends there
AROUND = 3.0  # degrees: returns in this angle around a direction surround it
CLOSE = 1.0  # metres: a ray through a place that ends nearer behind it


@dataclass(frozen=True, slots=True, eq=False)
class AskedPlaces:
    """Places at which a metric asks what every scan saw.

    Attributes:
        points: (K, 3) float32, metres, world frame; finite.
        frames: (K,) int64: position in the run of the scan that measured each point. Its own look
            is not counted.
        groups: (K,) int64: places of one number, from 0, are also counted together, by frame; -1
            for none.
    """

    points: F32
    frames: I64
    groups: I64

    @classmethod
    def none(cls) -> AskedPlaces:
        """No places."""
        return cls(np.empty((0, 3), np.float32), np.empty(0, np.int64), np.empty(0, np.int64))

    @classmethod
    def of(cls, parts: list[AskedPlaces]) -> AskedPlaces:
        """The places of several, in this order; their groups are numbered one after the other."""
        points = []
        frames = []
        groups = []
        first = 0
        for part in [cls.none(), *parts]:
            points.append(part.points)
            frames.append(part.frames)
            groups.append(np.where(part.groups < 0, -1, part.groups + first))
            first += int(part.groups.max(initial=-1)) + 1
        return cls(*(np.concatenate(every) for every in (points, frames, groups)))

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True, slots=True, eq=False)
class CountedLooks:
    """What every other scan saw at each place.

    Attributes:
        counts: (K, 6) int32: number of scans by ``Look``.
        first_hit, last_hit: (K,) int32: the first and the last frame with a hit, its own included.
        before: (K,) int32: scans that saw through it before the first hit; after: since the last.
        close: (K,) int32: scans that saw through it, with a ray that ended within ``CLOSE`` behind.
        mover: (K,) float32, metres: to the nearest dynamic point of its own scan; infinite without.
        mover_ever: (K,) float32, metres, to 0.35 m: to the nearest dynamic point of any scan.
        by_frame: (groups, frames, 6) int32: number of places of each group by frame and ``Look``.
        angle_known: (K,) bool: whether it lies on a surface, so that an angle is known.
    """

    counts: I32
    first_hit: I32
    last_hit: I32
    before: I32
    after: I32
    close: I32
    mover: F32
    mover_ever: F32
    by_frame: I32
    angle_known: Bool

    @property
    def through(self) -> I32:
        """(K,) int32: number of other scans that saw through each place, at any angle."""
        through: I32 = self.counts[:, Look.THROUGH] + self.counts[:, Look.GRAZING]
        return through

    def part(self, places: slice, groups: slice) -> CountedLooks:
        """Some of the places, and some of the groups."""
        return CountedLooks(
            self.counts[places],
            self.first_hit[places],
            self.last_hit[places],
            self.before[places],
            self.after[places],
            self.close[places],
            self.mover[places],
            self.mover_ever[places],
            self.by_frame[groups],
            self.angle_known[places],
        )


@runtime_checkable
class AsksLooks(Protocol):
    """A metric that asks what every scan saw at some places."""

    def places(self) -> AskedPlaces:
        """The places; called once, after the last scan and before ``finish``."""
        ...

    def looked(self, seen: CountedLooks) -> None:
        """Receive the looks at these places."""
        ...
