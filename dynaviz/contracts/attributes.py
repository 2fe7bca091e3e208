"""What a sequence knows about its points beyond their coordinates: attributes, and the offset of its world frame.

Scans carry neither, so that methods run at the same speed with and without them. A second pass over the source reads
them when a map is written.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F64
from dynaviz.contracts.scan import Sequence, SequenceSlice

Attributes = Mapping[str, NDArray[Any]]
"""(N,) integers or floats by name, such as ``intensity`` or ``ring``, in the types of the source."""

FAR = 10_000.0
"""Metres from the origin beyond which float32 coordinates are coarser than 1 mm."""

STEP = 1000.0
"""Metres. World frames are shifted by multiples of it, so that voxels keep their place in the world."""


@runtime_checkable
class HasAttributes(Protocol):
    """A sequence whose points have attributes."""

    def attributes(self, position: int) -> Attributes:
        """Attributes of the frame at a position, in the order of its points; empty if it has none."""
        ...


@runtime_checkable
class HasOrigin(Protocol):
    """A sequence whose world frame was moved, because its coordinates are far from zero."""

    @property
    def origin(self) -> F64:
        """(3,) float64, metres: add it to points and poses to get the coordinates of the source."""
        ...


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
    """The origin for a world whose first pose is at a position: zero within ``FAR``, else whole kilometres.

    Args:
        position: (3,) float64, metres.

    Returns:
        (3,) float64, metres: multiples of ``STEP``.
    """
    if not (np.abs(position) > FAR).any():
        return np.zeros(3)
    rounded: F64 = np.round(position / STEP) * STEP
    return rounded
