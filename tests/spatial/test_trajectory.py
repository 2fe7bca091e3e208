"""Interpolated poses, and deskewed sweeps of a moving spinning sensor.

Known walls, independent formulas.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from dynaviz.spatial.trajectory import Trajectory, deskew, point_times, unit_of

SPEED, RATE = 12.0, 0.8  # m/s along a circle, rad/s about the vertical
LOW, HIGH = np.array([-25.0, -15.0, -1.8]), np.array([30.0, 20.0, 6.0])


def driven(seconds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) positions and (N,) headings on a circle."""
    yaw = RATE * seconds
    radius = SPEED / RATE
    return np.column_stack([radius * np.sin(yaw), radius * (1 - np.cos(yaw)), 0 * yaw]), yaw


def poses(seconds: np.ndarray) -> np.ndarray:
    position, yaw = driven(seconds)
    T = np.tile(np.eye(4), (len(seconds), 1, 1))
    T[:, :3, :3] = Rotation.from_euler("z", yaw[:, None]).as_matrix()
    T[:, :3, 3] = position
    return T


def sweep(start: float, columns: int = 900, rings: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """Points of one turn of 0.1 s in the sensor's frame at their own time, and these times in
    seconds.
    """
    seconds = np.repeat(start + np.linspace(0, 0.1, columns, endpoint=False), rings)
    azimuth = np.repeat(np.linspace(-np.pi, np.pi, columns, endpoint=False), rings)
    elevation = np.tile(np.radians(np.linspace(-12, 8, rings)), columns)
    position, yaw = driven(seconds)
    c, s = np.cos(elevation), np.sin(elevation)
    ahead = np.column_stack([c * np.cos(azimuth + yaw), c * np.sin(azimuth + yaw), s])
    with np.errstate(divide="ignore"):
        reach = np.where(ahead > 0, (HIGH - position) / ahead, (LOW - position) / ahead).min(1)
    return reach[:, None] * np.column_stack([c * np.cos(azimuth), c * np.sin(azimuth), s]), seconds


def off_wall(points: np.ndarray) -> np.ndarray:
    """(N,) metres between each point and the nearest plane of the room."""
    return np.minimum(np.abs(points - LOW), np.abs(points - HIGH)).min(1)


def ns(seconds: np.ndarray) -> np.ndarray:
    return np.round(seconds * 1e9).astype(np.int64)


@pytest.mark.parametrize(("rate", "millimetres"), [(100, 1.0), (10, 25.0)])
def test_deskewed_points_lie_on_the_walls(rate: int, millimetres: float) -> None:
    knots = np.arange(0, 1.001, 1 / rate)
    path = Trajectory.of(ns(knots), poses(knots))
    points, seconds = sweep(0.5)
    T = path.at(ns(np.array([0.5])))[0]
    skewed = points @ T[:3, :3].T + T[:3, 3]
    straight, origins = deskew(points, ns(seconds), path)
    assert np.quantile(off_wall(skewed), 0.9) > 0.3
    assert off_wall(straight).max() < millimetres / 1000
    np.testing.assert_allclose(origins, driven(seconds)[0], atol=millimetres / 1000)


def test_poses_are_extrapolated_after_the_last_one() -> None:
    knots = np.arange(0, 0.5001, 0.01)
    points, seconds = sweep(0.5)
    straight, _ = deskew(points, ns(seconds), Trajectory.of(ns(knots), poses(knots)))
    assert off_wall(straight).max() < 0.06  # more than half a metre without


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1), st.integers(2, 30))
def test_interpolation_agrees_with_scipy(seed: int, knots: int) -> None:
    random = np.random.default_rng(seed)
    times = 1_700_000_000_000_000_000 + np.sort(random.choice(10**9, knots, replace=False))
    turns, positions = Rotation.random(knots, rng=random), random.normal(size=(knots, 3)) * 50
    T = np.tile(np.eye(4), (knots, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = turns.as_matrix(), positions
    path = Trajectory.of(times, T)
    asked = random.integers(times[0], times[-1], 20, endpoint=True)
    found = path.at(asked)
    expected = Slerp(times - times[0], turns)(asked - times[0]).as_matrix()
    np.testing.assert_allclose(found[:, :3, :3], expected, atol=1e-7)
    for axis in range(3):
        np.testing.assert_allclose(
            found[:, axis, 3],
            np.interp(asked - times[0], times - times[0], positions[:, axis]),
            atol=1e-9,
        )
    np.testing.assert_array_equal(path.at(times), T)  # bit-identical at given poses


def test_the_order_of_poses_does_not_matter_and_the_last_of_two_is_used() -> None:
    T = poses(np.array([0.3, 0.1, 0.2, 0.1]))
    path = Trajectory.of([30, 10, 20, 10], T)
    np.testing.assert_array_equal(path.times, [10, 20, 30])
    np.testing.assert_array_equal(path.poses, T[[3, 2, 0]])


def test_a_single_pose_is_constant() -> None:
    path = Trajectory.of([5], poses(np.array([1.0])))
    assert path.span == (-np.inf, np.inf)
    np.testing.assert_array_equal(path.at([-100, 5, 10**18]), np.repeat(path.poses, 3, 0))


STAMP = 1_700_000_000_123_456_789
OFFSETS = np.linspace(0, 0.0999, 1000)


@pytest.mark.parametrize(
    ("values", "first"),
    [
        pytest.param(np.round(OFFSETS * 1e9).astype(np.uint32), 0, id="Ouster: t, ns, uint32"),
        pytest.param(OFFSETS.astype(np.float32), 0, id="Velodyne: time, s, float32"),
        pytest.param(
            (OFFSETS - 0.0999).astype(np.float32), -99_900_000, id="Velodyne: time before the stamp"
        ),
        pytest.param(STAMP / 1e9 + OFFSETS, 0, id="Hesai: timestamp, s of the day, float64"),
        pytest.param(STAMP + OFFSETS * 1e9, 0, id="Livox: timestamp, ns since 1970, float64"),
        pytest.param(
            (STAMP + np.round(OFFSETS * 1e9)).astype(np.uint64), 0, id="ns since 1970, uint64"
        ),
        pytest.param((OFFSETS * 1e3).astype(np.float32), 0, id="ms, float32"),
        pytest.param(np.round(OFFSETS * 1e6).astype(np.int32), 0, id="us, int32"),
        pytest.param(4321.0 + OFFSETS, 0, id="since the sensor was switched on"),
    ],
)
def test_times_of_all_drivers(values: np.ndarray, first: int) -> None:
    unit = unit_of(values)
    assert unit is not None
    times = point_times(values, unit, STAMP)
    np.testing.assert_allclose((times - STAMP - first) / 1e9, OFFSETS, atol=2e-6)


def test_times_that_do_not_span_a_sweep_have_no_unit() -> None:
    for values in (
        np.zeros(5),
        np.full(5, np.nan),
        np.empty(0),
        np.array([0.0, 1e-13]),
        np.array([0, 3e9]),
    ):
        assert unit_of(values) is None


def test_a_point_without_time_gets_the_stamp() -> None:
    times = point_times(np.array([0.0, np.nan, 0.05]), 1e9, STAMP)
    assert (times - STAMP).tolist() == [0, 0, 50_000_000]
    assert (point_times(np.full(2, np.nan), 1e9, STAMP) == STAMP).all()
