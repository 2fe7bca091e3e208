"""The surfaces through points of a scan, and the angles at which rays meet them."""

from __future__ import annotations

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64

# metres: points of the same scan this close to a point are tried as its surface
REACHES = (
    0.4,
    0.8,
    1.6,
)
LEAST = 4  # points of a surface
FLAT = 0.07  # metres: standard deviation across a surface; more is no surface
WIDE = 0.15  # metres: least standard deviation along it
# Degrees: a ray that meets a surface at a smaller angle is a grazing ray. At this angle it passes
# through the last three cells of the surface's own layer before it ends (cot 20 is 2.7).
GRAZING = 20.0
# Degrees: a surface that its own ray meets at a smaller angle is none, but points that lie along a
# single ring.
ALONG_RAY = 1.0


def surface_normals(points: F32, asked: F32, origins: F64) -> F64:
    """The normals of the surfaces through points, from the points around them.

    Args:
        points: (N, 3) float32, metres, world frame: of a scan.
        asked: (K, 3) float32, metres, world frame: some of them.
        origins: (K, 3) or (1, 3), metres, world frame: of their rays.

    Returns:
        (K, 3) float64; NaN for points that lie on no surface.
    """
    found = np.full((len(asked), 3), np.nan)
    sums = np.zeros((len(asked), 10))
    inner = -1.0
    points = kernels.as_readonly(points, np.float32)
    for reach in REACHES:
        left = np.flatnonzero(np.isnan(found[:, 0]))
        places = kernels.as_readonly(asked[left], np.float32)
        sums[left] += kernels.surfaces.moments(points, places, inner, reach)
        inner = reach
        left = left[sums[left, 0] >= LEAST]
        count, first, second = np.split(sums[left], [1, 4], axis=1)
        products = second[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
        mean = first / count
        spread, axes = np.linalg.eigh(
            (products - first[:, :, None] * mean[:, None]) / (count[:, None] - 1)
        )
        across, along = np.sqrt(np.maximum(spread[:, :2], 0)).T
        flat = (across < FLAT) & (along > WIDE)
        found[left[flat]] = axes[flat, :, 0]
    found[~(angles(asked - origins, found) >= ALONG_RAY)] = np.nan
    return found


def angles(rays: F64, normals: F64) -> F64:
    """(K,) degrees, between rays and surfaces, given (K, 3) directions and normals.

    NaN if any is unknown.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        sines = np.abs((rays * normals).sum(1)) / np.linalg.norm(rays, axis=1)
        found: F64 = np.degrees(np.arcsin(np.minimum(sines, 1.0)))
    return found
