"""What a sequence knows beyond its scans.

Attributes, exact coordinates, points without a pose, offset of its world.

Scans carry none of it, so that methods run at the same speed with and without. A second pass over
the source reads it when a map is written.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F32, F64
from dynaviz.contracts.scan import Scan, Sequence, SequenceSlice, SequenceView

Attributes = Mapping[str, NDArray[Any]]
"""(N,) integers or floats by name, such as ``intensity`` or ``ring``, in the types of the source.
"""

FAR = 10_000.0
"""Metres from the origin beyond which float32 coordinates are coarser than 1 mm."""

STEP = 1000.0
"""Metres. World frames are shifted by multiples of it, so that voxels keep their place in the
world."""


@runtime_checkable
class HasAttributes(Protocol):
    """A sequence whose points have attributes."""

    def attributes(self, position: int) -> Attributes:
        """Attributes of the frame at a position, in the order of its points.

        Empty if it has none.
        """
        ...


@runtime_checkable
class HasOrigin(Protocol):
    """A sequence whose world frame was moved, because its coordinates are far from zero."""

    @property
    def origin(self) -> F64:
        """(3,) float64, metres: add it to points and poses to get the coordinates of the source."""
        ...


@runtime_checkable
class HasCoordinates(Protocol):
    """A sequence whose source states the coordinates of points in the world frame, so that maps can
    repeat them.
    """

    def coordinates(self, position: int) -> F32 | F64 | None:
        """(N, 3), metres, in the world of the source.

        With ``origin``, and float64 if the source is.

        None if the points of the scan tell as much.
        """
        ...


@dataclass(frozen=True, eq=False)
class Unposed:
    """Points of a source that no pose covers: no frame contains them, and no method judges them.

    Attributes:
        number: of points.
        xyz: (number, 3) float64, metres, as in the source; None if they are not in the world frame.
        attributes: of these points.
    """

    number: int
    xyz: F64 | None = None
    attributes: Attributes = field(default_factory=dict)


@runtime_checkable
class HasUnposed(Protocol):
    """A sequence whose source may have points that no pose covers."""

    def unposed(self) -> Iterator[Unposed]:
        """These points, piece by piece."""
        ...


@runtime_checkable
class HasLasFile(Protocol):
    """A sequence in the world frame of a LAS file."""

    @property
    def las_file(self) -> Path | None:
        """The file, whose header a LAS map takes over: coordinate system, scales and offsets.

        None without one.
        """
        ...


def unposed_of(sequence: Sequence) -> Iterator[Unposed]:
    """Points that no pose covers; none for selected frames."""
    if isinstance(sequence, SequenceSlice):
        if len(sequence.positions) == len(sequence.whole):
            yield from unposed_of(sequence.whole)
    elif isinstance(sequence, HasUnposed):
        yield from sequence.unposed()
    elif isinstance(sequence, SequenceView):
        yield from unposed_of(sequence.whole)


def coordinates_of(sequence: Sequence, position: int) -> F32 | F64 | None:
    """(N, 3), metres: coordinates of a frame as in its source, in its type.

    None if they follow from its points.
    """
    if isinstance(sequence, SequenceSlice):
        return coordinates_of(sequence.whole, sequence.positions[position])
    return sequence.coordinates(position) if isinstance(sequence, HasCoordinates) else None


def exact_points(sequence: Sequence, position: int, scan: Scan) -> F64:
    """(N, 3) float64, metres, in the world of the source.

    As the source states them, otherwise the points of a scan.
    """
    given = coordinates_of(sequence, position)
    return (
        scan.points.astype(np.float64) + origin_of(sequence)
        if given is None
        else given.astype(np.float64)
    )


def las_file_of(sequence: Sequence) -> Path | None:
    """A LAS file in the world frame of a sequence; None without one."""
    if isinstance(sequence, SequenceSlice | SequenceView):
        return las_file_of(sequence.whole)
    return sequence.las_file if isinstance(sequence, HasLasFile) else None


def attributes_of(sequence: Sequence, position: int) -> Attributes:
    """Attributes of the points of a frame; empty for sequences that have none."""
    if isinstance(sequence, SequenceSlice):
        return attributes_of(sequence.whole, sequence.positions[position])
    return sequence.attributes(position) if isinstance(sequence, HasAttributes) else {}


def origin_of(sequence: Sequence) -> F64:
    """(3,) float64, metres: what to add to coordinates of a sequence to get those of its source."""
    if isinstance(sequence, SequenceSlice):
        return origin_of(sequence.whole)
    return sequence.origin if isinstance(sequence, HasOrigin) else np.zeros(3)


def far_origin(position: F64) -> F64:
    """The origin for a world whose first pose is at a position.

    Zero within ``FAR``, otherwise whole kilometres.

    Args:
        position: (3,) float64, metres.

    Returns:
        (3,) float64, metres: multiples of ``STEP``.
    """
    if not (np.abs(position) > FAR).any():
        return np.zeros(3)
    rounded: F64 = np.round(position / STEP) * STEP
    return rounded
