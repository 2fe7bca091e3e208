"""What a sequence knows beyond its scans.

Attributes, exact coordinates, points without a pose, offset of its world.

Scans carry none of it, so that methods run at the same speed with and without. A second pass over
the source reads it when a map is written.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F32, F64
from dynaviz.contracts.scan import HasScanFiles, Scan, Sequence, SequenceSlice, SequenceView
from dynaviz.spatial.trajectory import HasTrajectories, PosesOverTime

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


@runtime_checkable
class HasFacts(Protocol):
    """A sequence with further facts."""

    @property
    def facts(self) -> Mapping[str, str]:
        """The facts by name."""
        ...


@runtime_checkable
class HasExactPoses(Protocol):
    """A sequence that states whether its poses and its sensor are exact."""

    @property
    def exact(self) -> bool:
        """Whether they are, as in a simulated scene; they are neither estimated nor checked."""
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


P = TypeVar("P")


def knowing(sequence: Sequence, what: type[P]) -> P | None:
    """What knows a property of a sequence: the sequence, or the one that it was made of.

    None if neither does. A sequence that changes a property states its own.

    Args:
        sequence: any sequence.
        what: the protocol of the property, which does not depend on the position of a frame.
    """
    layer = sequence
    while not isinstance(layer, what):
        if not isinstance(layer, SequenceSlice | SequenceView):
            return None
        layer = layer.whole
    return layer


def facts_of(sequence: Sequence) -> Mapping[str, str]:
    """Further facts of a sequence, by name; empty for sequences that have none."""
    known = knowing(sequence, HasFacts)  # type: ignore[type-abstract]  # a protocol
    return {} if known is None else known.facts


def scan_file_of(sequence: Sequence, index: int) -> Path | None:
    """The file of a frame, by its number; None if the format does not keep one file per frame."""
    known = knowing(sequence, HasScanFiles)  # type: ignore[type-abstract]  # a protocol
    return None if known is None else known.scan_file(index)


def trajectories_of(sequence: Sequence) -> Mapping[int, PosesOverTime]:
    """T_world_sensor over time of each lidar; empty for sequences that know poses of scans only."""
    known = knowing(sequence, HasTrajectories)  # type: ignore[type-abstract]  # a protocol
    return {} if known is None else known.trajectories


def is_exact(sequence: Sequence) -> bool:
    """Whether the poses and the sensor of a sequence are exact, so that nobody estimates or checks
    them.
    """
    known = knowing(sequence, HasExactPoses)  # type: ignore[type-abstract]  # a protocol
    return known is not None and known.exact


def unposed_of(sequence: Sequence) -> Iterator[Unposed]:
    """Points that no pose covers; none for selected frames."""
    if isinstance(sequence, HasUnposed):
        yield from sequence.unposed()
    elif isinstance(sequence, SequenceSlice):
        if len(sequence.positions) == len(sequence.whole):
            yield from unposed_of(sequence.whole)
    elif isinstance(sequence, SequenceView):
        yield from unposed_of(sequence.whole)


def coordinates_of(sequence: Sequence, position: int) -> F32 | F64 | None:
    """(N, 3), metres: coordinates of a frame as in its source, in its type.

    None if they follow from its points.
    """
    if isinstance(sequence, HasCoordinates):
        return sequence.coordinates(position)
    if isinstance(sequence, SequenceSlice):
        return coordinates_of(sequence.whole, sequence.positions[position])
    return coordinates_of(sequence.whole, position) if isinstance(sequence, SequenceView) else None


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
    known = knowing(sequence, HasLasFile)  # type: ignore[type-abstract]  # a protocol
    return None if known is None else known.las_file


def attributes_of(sequence: Sequence, position: int) -> Attributes:
    """Attributes of the points of a frame; empty for sequences that have none."""
    if isinstance(sequence, HasAttributes):
        return sequence.attributes(position)
    if isinstance(sequence, SequenceSlice):
        return attributes_of(sequence.whole, sequence.positions[position])
    return attributes_of(sequence.whole, position) if isinstance(sequence, SequenceView) else {}


@dataclass(frozen=True)
class Precision:
    """Of the coordinates in a source.

    Attributes:
        dtype: their type, or float32 if it holds all of them.
        step: (3,) float64, metres: the smallest difference in x, y and z that it can hold there.
    """

    dtype: str
    step: F64

    def __str__(self) -> str:
        coarse = f", in steps of {self.step.max():.2g} m" if self.step.max() > 1e-4 else ""
        return f"{self.dtype}{coarse}"


def precision_of(sequence: Sequence, position: int) -> Precision | None:
    """Of the coordinates of a frame; None for sources that do not state them."""
    given = coordinates_of(sequence, position)
    if given is None:
        return None
    known = given[np.isfinite(given).all(1)]
    if not len(known):
        return None
    single = known.astype(np.float32)
    farthest = np.abs(known).max(0)
    if (single == known).all():
        return Precision("float32", np.spacing(farthest.astype(np.float32)).astype(np.float64))
    return Precision(f"{given.dtype}", np.spacing(farthest.astype(given.dtype)).astype(np.float64))


def origin_of(sequence: Sequence) -> F64:
    """(3,) float64, metres: what to add to coordinates of a sequence to get those of its source."""
    known = knowing(sequence, HasOrigin)  # type: ignore[type-abstract]  # a protocol
    return np.zeros(3) if known is None else known.origin


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
