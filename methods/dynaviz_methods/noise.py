"""Statistical outlier removal (Rusu et al. 2008), as in PCL."""

from __future__ import annotations

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, Bool


def outliers(points: F32, neighbours: int, stddev: float) -> Bool:
    """Find points whose mean distance to their nearest neighbours is far above average.

    Args:
        points: (N, 3) float32, metres; finite.
        neighbours: number of nearest neighbours, not counting the point itself; all others if there are fewer.
        stddev: threshold above the mean over all points, standard deviations.

    Returns:
        (N,) bool: outliers.
    """
    neighbours = min(neighbours, len(points) - 1)
    if neighbours < 1:
        return np.zeros(len(points), np.bool_)
    from scipy.spatial import cKDTree

    # The fastest options for scans: a tree without medians, and queries in the order of its leaves.
    tree, means = cKDTree(points, balanced_tree=False), np.empty(len(points))
    distances, _ = tree.query(points[tree.indices], neighbours + 1, workers=kernels.threads_in_use())
    means[tree.indices] = np.sum(distances, 1) / neighbours  # the point itself is among them, at distance 0
    far: Bool = means > means.mean() + stddev * means.std(ddof=1)
    return far
