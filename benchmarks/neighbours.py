"""The kernel for mean neighbour distances against scipy's ``cKDTree``: ``python benchmarks/neighbours.py [ROUNDS]``.

Both build a tree of one scan and compute each point's mean distance to its 50 nearest neighbours, as OctoMap's noise
filter does in every frame. Scans of a simulated street have about 30, 60 and 120 thousand points. The rounds alternate
on the same inputs, on all threads and on one; the best round counts. The results must agree to 1e-12, and the noise
masks must be the same.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np
from scenes import street
from scipy.spatial import cKDTree

from dynaviz import kernels
from dynaviz.arrays import F32, F64, Bool

NEIGHBOURS, STDDEV = 50, 1.0  # defaults of OctoMap's noise filter
SIZES = (30_000, 60_000, 120_000)  # points in a scan
AZIMUTHS = 1915 / 120_000  # columns of the simulated scan, per point


def by_kernel(points: F32, threads: int) -> F64:
    """(N,) float64, metres: mean distances by ``kernels/neighbours.py``."""
    tree = kernels.neighbours.tree(kernels.as_readonly(points, np.float32))
    means: F64 = kernels.neighbours.mean_distances(*tree, NEIGHBOURS, threads)
    return means


def by_scipy(points: F32, threads: int) -> F64:
    """(N,) float64, metres: mean distances by scipy; the point itself is the first neighbour, at distance 0.

    Of scipy's options the fastest for scans: cells split in the middle, queries in the order of the tree's leaves.
    """
    tree, means = cKDTree(points, balanced_tree=False), np.empty(len(points))
    distances, _ = tree.query(points[tree.indices], NEIGHBOURS + 1, workers=threads)
    means[tree.indices] = distances.sum(1) / NEIGHBOURS
    return means


def noise(means: F64) -> Bool:
    """(N,) bool: points that the noise filter removes."""
    far: Bool = means > means.mean() + STDDEV * means.std(ddof=1)
    return far


def seconds(call: Callable[[F32, int], F64], points: F32, threads: int) -> float:
    """Wall seconds of one call."""
    start = time.perf_counter()
    call(points, threads)
    return time.perf_counter() - start


def main(rounds: int) -> None:
    every = kernels.set_threads(None)
    scans = [street(1, round(size * AZIMUTHS))[0].points for size in SIZES]
    for points in scans:  # also compiles the kernel
        kernel, scipy = by_kernel(points, every), by_scipy(points, every)
        np.testing.assert_allclose(kernel, scipy, rtol=1e-12, atol=1e-12)
        np.testing.assert_array_equal(noise(kernel), noise(scipy))
    print(f"mean distance to the {NEIGHBOURS} nearest neighbours, best of {rounds} rounds")
    for threads in sorted({1, every}, reverse=True):
        kernels.set_threads(threads)
        for points in scans:
            pairs = [(seconds(by_kernel, points, threads), seconds(by_scipy, points, threads)) for _ in range(rounds)]
            kernel, scipy = np.min(pairs, axis=0)
            print(f"{len(points):>8,} points, {threads} threads: kernel {kernel * 1e3:7.1f} ms, "
                  f"cKDTree {scipy * 1e3:7.1f} ms, ratio {scipy / kernel:.2f}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 7)
