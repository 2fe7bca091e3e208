from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.spatial import cKDTree

from dynaviz import kernels


def means(points, k, lanes=2):
    tree = kernels.neighbours.tree(kernels.as_readonly(points, np.float32))
    return kernels.neighbours.mean_distances(*tree, k, lanes)


def by_scipy(points, k):
    distances, _ = cKDTree(points.astype(np.float64)).query(points.astype(np.float64), k + 1)
    return distances.sum(1) / k


@given(
    arrays.arrays(
        np.float32,
        st.tuples(st.integers(2, 200), st.just(3)),
        elements=st.floats(-100, 100, width=32) | st.sampled_from([0, 1, 2]),
    ),
    st.integers(1, 60),
)
@settings(max_examples=60, deadline=None)
def test_means_are_exact(points, k):
    k = min(k, len(points) - 1)
    np.testing.assert_allclose(means(points, k), by_scipy(points, k), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("spread", [(1, 1, 1), (50, 50, 0.01), (100, 0, 0), (0, 0, 0)])
def test_means_of_many_points(spread):
    random = np.random.default_rng(0)
    points = (random.normal(size=(6000, 3)) ** 3 * spread).astype(np.float32)
    np.testing.assert_allclose(means(points, 50), by_scipy(points, 50), rtol=1e-12, atol=1e-12)


def test_lanes_decide_nothing():
    points = np.random.default_rng(0).normal(size=(5000, 3)).astype(np.float32)
    np.testing.assert_array_equal(means(points, 20, lanes=1), means(points, 20, lanes=7))


def test_the_tree_holds_every_point_once_and_its_boxes_hold_them():
    points = np.random.default_rng(0).normal(size=(3001, 3)).astype(np.float32)
    xyz, order, depth, boxes = kernels.neighbours.tree(kernels.as_readonly(points, np.float32))
    np.testing.assert_array_equal(np.sort(order), np.arange(3001))
    np.testing.assert_array_equal(points[order], xyz.T)
    for leaf in range(1 << depth):
        inside = xyz[:, (leaf * 3001) >> depth : ((leaf + 1) * 3001) >> depth]
        assert 0 < inside.shape[1] <= 33
        np.testing.assert_array_equal(boxes[(1 << depth) + leaf], [*inside.min(1), *inside.max(1)])
