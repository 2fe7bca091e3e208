"""What scans of a source do not carry: attributes of points, points without a pose, and the offset
of a world frame that is far away.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F32, F64

Attributes = Mapping[str, NDArray[Any]]
"""(N,) integers or floats by name, such as ``intensity`` or ``ring``, in the types of the source.
"""

FAR = 10_000.0
"""Metres from the origin beyond which float32 coordinates are coarser than 1 mm."""

STEP = 1000.0
"""Metres. World frames are shifted by multiples of it, so that voxels keep their place in the
world."""


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


def precision_of(given: F32 | F64 | None) -> Precision | None:
    """Of the coordinates of a frame, (N, 3), metres; None for sources that do not state them."""
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
