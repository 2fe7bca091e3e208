"""The surface through points."""

from __future__ import annotations

import numpy as np

from dynaviz.arrays import F64

FLAT = 0.07  # metres: standard deviation across a surface; more is no surface
WIDE = 0.15  # metres: least standard deviation along it


def surface_normal(points: F64) -> F64 | None:
    """The normal, (3,) float64, of the surface through points (N, 3), metres; None if they do not lie on one."""
    if len(points) < 4:
        return None
    spread, axes = np.linalg.eigh(np.cov(points.T))
    across, along = np.sqrt(np.maximum(spread[:2], 0))
    normal: F64 = axes[:, 0]
    return normal if across < FLAT and along > WIDE else None
