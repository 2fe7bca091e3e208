"""Nearest-neighbour distances, compared with all pairs and with a k-d tree."""

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial import cKDTree

from dynaviz.spatial.nearest import Nearest, nearest_distance

pytestmark = pytest.mark.boundscheck

COORDINATE = st.floats(-100, 100, width=32) | st.integers(-3, 3).map(
    float
)  # the latter make ties and duplicates
CLOUD = hnp.arrays(np.float32, st.tuples(st.integers(1, 70), st.just(3)), elements=COORDINATE)


def brute_force(query, reference, limit):
    d = query[:, None, :] - reference[None, :, :]
    squared = d[..., 0] * d[..., 0] + d[..., 1] * d[..., 1] + d[..., 2] * d[..., 2]
    distance = np.sqrt(squared.min(1))
    return np.where(distance <= np.float32(limit), distance, np.inf)


def street(n, seed):
    """Dense ground with a hole, thin walls, and a few points far away."""
    rng = np.random.default_rng(seed)
    ground = np.c_[rng.uniform(-40, 40, n), rng.normal(0, 8, n), rng.normal(0, 0.02, n)]
    wall = np.c_[rng.uniform(-40, 40, n // 2), np.full(n // 2, 15.0), rng.uniform(0, 8, n // 2)]
    far = rng.uniform(-5000, 5000, (5, 3))
    return np.concatenate([ground, wall, far]).astype(np.float32)


@pytest.mark.plain
@settings(deadline=None)
@given(CLOUD, CLOUD, st.sampled_from([0.5, 1.0, 30.0, np.inf]))
def test_equals_the_minimum_over_all_pairs(query, reference, limit):
    np.testing.assert_array_equal(
        nearest_distance(query, reference, limit), brute_force(query, reference, limit)
    )


@pytest.mark.parametrize("limit", [0.05, 2.0, np.inf])
def test_equals_a_kd_tree(limit):
    query, reference = street(6000, 1), street(9000, 2)
    reference = reference[np.abs(reference[:, 0]) > 5]
    expected, _ = cKDTree(reference.astype(float)).query(query.astype(float))
    found = nearest_distance(query, reference, limit)
    inside = expected <= limit
    assert inside.any()
    assert np.isinf(limit) or not inside.all()
    np.testing.assert_array_equal(np.isfinite(found), inside)
    np.testing.assert_allclose(found[inside], expected[inside], rtol=1e-5, atol=1e-6)


@pytest.mark.plain
def test_the_limit_itself_is_found():
    query, reference = np.zeros((1, 3), np.float32), np.array([[0.05, 0, 0]], np.float32)
    assert nearest_distance(query, reference, 0.05) == np.float32(0.05)
    assert np.isinf(nearest_distance(query, reference, 0.0499))


@settings(deadline=None, max_examples=40)
@given(CLOUD, CLOUD, st.sampled_from([0.0, 1e-30, 0.05, 1.0, 30.0, 1e30, np.inf]))
def test_within_is_whether_the_distance_is_in_the_limit(query, reference, limit):
    tree = Nearest(reference)
    expected = np.isfinite(brute_force(query, reference, limit))
    np.testing.assert_array_equal(tree.within(query, limit), expected)
    np.testing.assert_array_equal(np.isfinite(tree.distance(query, limit)), expected)


@settings(deadline=None, max_examples=40)
@given(CLOUD, CLOUD, st.data())
def test_a_limit_that_is_a_distance_is_within(query, reference, data):
    exact = brute_force(query, reference, np.inf)
    k = data.draw(st.integers(0, len(query) - 1))
    tree, just_below = Nearest(reference), np.nextafter(exact[k], np.float32(0))
    assert tree.within(query[k : k + 1], exact[k]).all()
    assert tree.within(query[k : k + 1], just_below).any() == (exact[k] == 0)


def test_one_tree_answers_many_queries():
    query, reference = street(4000, 5), street(3000, 6)
    tree, whole = Nearest(reference), nearest_distance(query, reference)
    parts = [tree.distance(query[k : k + 700]) for k in range(0, len(query), 700)]
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    assert len(tree) == len(reference)


def test_empty_inputs():
    none, one = np.zeros((0, 3), np.float32), np.zeros((1, 3), np.float32)
    assert nearest_distance(none, one).shape == (0,)
    assert np.isinf(nearest_distance(one, none)).all()
    assert not Nearest(none).within(one, 1.0).any()
    assert Nearest(one).within(none, 1.0).shape == (0,)


def test_same_on_one_and_many_threads():
    query, reference = street(5000, 3), street(5000, 4)
    threads = numba.get_num_threads()
    many = nearest_distance(query, reference)
    numba.set_num_threads(1)
    try:
        np.testing.assert_array_equal(nearest_distance(query, reference), many)
    finally:
        numba.set_num_threads(threads)
