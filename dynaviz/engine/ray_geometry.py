"""The rays of a scan that touch points: which, from where, at which angle, and how far they go on."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, Intp
from dynaviz.contracts.scan import Scan
from dynaviz.spatial.surface import surface_normal

SURFACES = (0.4, 0.8, 1.6)  # metres: points of the same scan this close to a point are tried as its surface


def touching(scan: Scan, cells: F64) -> Iterator[tuple[Intp, Intp]]:
    """For each of (K, 2, 3) cells the rays of a scan that end in it, and those that pass through it."""
    for first in range(0, len(cells), kernels.witnesses.MOST):
        low, high = (np.ascontiguousarray(cells[first : first + kernels.witnesses.MOST, side]) for side in (0, 1))
        hit, crossed = kernels.witnesses.touched(scan.points, scan.origins, low, high)
        touching = np.flatnonzero(hit | crossed)
        hit, crossed = hit[touching], crossed[touching]
        for k in range(len(low)):
            bit = np.uint32(1) << np.uint32(k)
            yield touching[hit & bit > 0], touching[crossed & bit > 0]


Geometry = tuple[tuple[float, float, float], float, float | None, int, int, float | None]


def geometry(scan: Scan, ends: Intp, passes: Intp, point: F32, normal: F64 | None) -> Geometry:
    """Origin, range, angle, numbers of rays, and how far crossing rays go on, as in ``LedgerEntry``."""
    touching = np.append(ends, passes)
    one = len(scan.origins) == 1 or not len(touching)
    origin = scan.origins[0] if one else scan.origins[touching[0]]
    ray = point - origin
    away = float(np.linalg.norm(ray))
    angle = None
    if normal is not None and away > 0:
        angle = float(np.degrees(np.arcsin(min(abs(ray @ normal) / away, 1.0))))
    behind = None
    if len(passes):
        origins = scan.origins if len(scan.origins) == 1 else scan.origins[passes]
        lengths = np.sort(np.linalg.norm(scan.points[passes] - origins, axis=1))
        behind = float(lengths[len(lengths) // 2] + lengths[~(len(lengths) // 2)]) / 2 - away  # the median
    x, y, z = origin.tolist()
    return (x, y, z), away, angle, len(ends), len(passes), behind


def normals(points: F32, asked: F32) -> list[F64 | None]:
    """The normal of the surface through each asked point, from its scan; None if it lies on no surface."""
    finite = asked[np.isfinite(asked).all(1)]
    if len(finite):
        around = (points >= finite.min(0) - SURFACES[-1]) & (points <= finite.max(0) + SURFACES[-1])
        points = points[around.all(1)]
    return [_normal_at(points, point) for point in asked]


def _normal_at(points: F32, point: F32) -> F64 | None:
    if not np.isfinite(point).all():
        return None
    x, y, z = (np.abs(points[:, axis] - point[axis]) for axis in range(3))  # much faster than reducing rows
    away = np.maximum(np.maximum(x, y), z)
    for radius in SURFACES:
        if (normal := surface_normal(points[away <= radius].astype(np.float64))) is not None:
            return normal
    return None
