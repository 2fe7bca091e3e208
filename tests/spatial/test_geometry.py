"""Laws of rigid transforms, with scipy's rotations as the oracle."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from dynaviz.spatial import geometry

numbers = st.floats(-100, 100, allow_subnormal=False)
quaternions = hnp.arrays(np.float64, 4, elements=st.floats(-1, 1)).filter(
    lambda q: np.linalg.norm(q) > 1e-3
)
poses = st.builds(geometry.pose, hnp.arrays(np.float64, 3, elements=numbers), quaternions)
clouds = hnp.arrays(
    np.float32, st.tuples(st.integers(0, 20), st.just(3)), elements=st.floats(-100, 100, width=32)
)


def oracle(q: Any) -> Rotation:
    return Rotation.from_quat(q, scalar_first=True)


@given(quaternions)
def test_the_matrix_of_a_quaternion_is_scipys(q: Any) -> None:
    np.testing.assert_allclose(geometry.matrix(q), oracle(q).as_matrix(), atol=1e-12)


@given(quaternions)
def test_the_quaternion_of_a_matrix_is_the_same_rotation(q: Any) -> None:
    back = geometry.quaternion(oracle(q).as_matrix())
    assert back[0] >= 0
    assert np.linalg.norm(back) == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose(geometry.matrix(back), oracle(q).as_matrix(), atol=1e-12)


@pytest.mark.parametrize("axis", range(3))
def test_half_turns_have_quaternions(axis: int) -> None:
    R = -np.eye(3)
    R[axis, axis] = 1
    np.testing.assert_array_equal(geometry.quaternion(R)[1:], np.eye(3)[axis])


@pytest.mark.parametrize(
    "q", [(0, 0, 0, 0), (0, 1e-9, 0, 0), (1e200, 0, 0, 0), (np.nan, 0, 0, 1), (np.inf, 0, 0, 1)]
)
def test_invalid_quaternions_are_rejected(q: Any) -> None:
    with pytest.raises(ValueError, match="invalid quaternion"):
        geometry.matrix(q)


@given(poses)
def test_a_pose_and_its_inverse_cancel(T_a_b: Any) -> None:
    np.testing.assert_allclose(
        geometry.compose(T_a_b, geometry.inverse(T_a_b)), np.eye(4), atol=1e-10
    )


@given(poses, poses)
def test_composition_is_the_product_of_matrices(T_a_b: Any, T_b_c: Any) -> None:
    np.testing.assert_allclose(geometry.compose(T_a_b, T_b_c), T_a_b @ T_b_c, atol=1e-10)


def test_stacks_are_inverted_and_composed_elementwise() -> None:
    random = np.random.default_rng(0)
    stack = np.array(
        [geometry.pose(random.normal(size=3), random.normal(size=4)) for _ in range(5)]
    )
    for k, (T, T_inverse, T_twice) in enumerate(
        zip(stack, geometry.inverse(stack), geometry.compose(stack[0], stack), strict=True)
    ):
        np.testing.assert_array_equal(T_inverse, geometry.inverse(T), err_msg=str(k))
        np.testing.assert_array_equal(T_twice, geometry.compose(stack[0], T), err_msg=str(k))


@given(poses, poses, clouds)
def test_points_are_transformed_by_the_composed_pose(T_a_b: Any, T_b_c: Any, points: Any) -> None:
    step_by_step = geometry.apply(T_a_b, geometry.apply(T_b_c, points))
    np.testing.assert_allclose(
        geometry.apply(geometry.compose(T_a_b, T_b_c), points), step_by_step, atol=1e-9
    )


@given(poses, clouds)
def test_each_point_is_transformed_independently(T_a_b: Any, points: Any) -> None:
    together = geometry.transform(T_a_b, points)
    assert together.dtype == np.float32
    alone = [geometry.transform(T_a_b, point[None])[0] for point in points]
    np.testing.assert_array_equal(together, np.reshape(alone, (-1, 3)))
