"""Filters of a scan, as in PCL: its ground plane by RANSAC and a fit to the inliers.

Outliers (Rusu et al. 2008).
"""

from __future__ import annotations

import math

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, Bool
from dynaviz.contracts.probe import Plane

KERNELS = kernels.load("dynaviz_methods.octomap.kernels")

LEAST = 50  # minimum number of points
SAMPLES = 50  # maximum number of RANSAC iterations, PCL's default
CONFIDENCE = 0.99  # of having found the best plane, PCL's default


def ground_plane(
    points: F32, distance: float, angle: float, random: np.random.Generator
) -> tuple[Bool, Plane | None]:
    """Find the near-horizontal plane with the most points, and its points.

    Args:
        points: (N, 3) float32, metres, world frame; finite.
        distance: inlier distance from the plane, metres.
        angle: maximum angle between the plane's normal and the world's z axis, radians.
        random: generator of the samples.

    Returns:
        (N,) bool: points on the plane; and the plane. All False and None for fewer than ``LEAST``
        points, and if the fitted plane is too steep.
    """
    none = np.zeros(len(points), np.bool_)
    if len(points) < LEAST:
        return none, None
    samples = random.integers(len(points), size=(SAMPLES, 3))
    found, most = KERNELS.plane.from_samples(
        kernels.as_readonly(points, np.float32),
        kernels.as_readonly(samples, np.int64),
        distance,
        math.cos(angle),
        CONFIDENCE,
    )
    if not most:
        return none, None
    plane = _fit(points[_near(points, found[:3], found[3], distance)])
    if abs(plane.normal[2]) < math.cos(angle):
        return none, None
    return _near(points, plane.normal, plane.offset, distance), plane


def _near(points: F32, normal: F64, offset: float, distance: float) -> Bool:
    # Not with @, whose last bits depend on the machine and on the number of threads.
    x, y, z = points.T.astype(np.float64)
    near: Bool = np.abs(normal[0] * x + normal[1] * y + normal[2] * z - offset) < distance
    return near


def _fit(points: F32) -> Plane:
    """Least-squares plane: its normal is the direction in which the points spread least."""
    centre = points.mean(0, dtype=np.float64)
    spread = points - centre
    moments = np.array([[(a * b).sum() for b in spread.T] for a in spread.T])
    normal = np.linalg.eigh(moments)[1][:, 0]
    normal = np.copysign(1.0, normal[2]) * normal  # upwards
    radius = float(np.sqrt((spread**2).sum(1).max()))
    return Plane(normal, float(normal @ centre), centre, radius)


def outliers(points: F32, neighbours: int, stddev: float) -> Bool:
    """Find points whose mean distance to their nearest neighbours is far above average.

    Args:
        points: (N, 3) float32, metres; finite.
        neighbours: number of nearest neighbours, not counting the point itself; all others if there
            are fewer.
        stddev: threshold above the mean over all points, standard deviations.

    Returns:
        (N,) bool: outliers.
    """
    neighbours = min(neighbours, len(points) - 1)
    if neighbours < 1:
        return np.zeros(len(points), np.bool_)
    from scipy.spatial import cKDTree

    # The fastest options for scans: a tree without medians, and queries in the order of its leaves.
    tree = cKDTree(points, balanced_tree=False)
    means = np.empty(len(points))
    distances, _ = tree.query(
        points[tree.indices], neighbours + 1, workers=kernels.threads_in_use()
    )
    # the point itself is among them, at distance 0
    means[tree.indices] = np.sum(distances, 1) / neighbours
    far: Bool = means > means.mean() + stddev * means.std(ddof=1)
    return far
