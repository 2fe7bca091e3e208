from __future__ import annotations

import math

import numpy as np
import pytest

from dynaviz_methods.octomap.filters import ground_plane, outliers

pytestmark = pytest.mark.boundscheck


def random(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def tilted(angle: float, points: int = 600, seed: int = 0) -> np.ndarray:
    """A square of 20 m around (100, -50, 3), tilted by an angle, with 1 cm of noise."""
    x, y = random(seed).uniform(-10, 10, (2, points))
    flat = np.stack([x * math.cos(angle), y, x * math.sin(angle)], 1) + np.array([100, -50, 3])
    return (flat + random(seed + 1).normal(0, 0.01, (points, 3))).astype(np.float32)


@pytest.mark.parametrize("angle", [0.0, 0.1, -0.14])
def test_a_floor_among_clutter_is_found_and_fitted(angle):
    clutter = random(5).uniform((90, -60, 3), (110, -40, 8), (400, 3)).astype(np.float32)
    found, plane = ground_plane(np.concatenate([tilted(angle), clutter]), 0.04, 0.15, random())
    assert found[:600].mean() > 0.97
    assert found[600:].mean() < 0.1
    assert math.acos(plane.normal[2]) == pytest.approx(abs(angle), abs=0.01)
    assert plane.normal @ (100, -50, 3) == pytest.approx(plane.offset, abs=0.02)
    assert 9 < plane.radius < 16


@pytest.mark.plain
@pytest.mark.parametrize("angle", [0.3, 1.0, math.pi / 2])
def test_steep_planes_are_not_ground(angle):
    found, plane = ground_plane(tilted(angle), 0.04, 0.15, random())
    assert plane is None
    assert not found.any()


def test_the_larger_of_two_floors_wins():
    upper = tilted(0.0, points=200) + np.float32([0, 0, 2])
    found, _ = ground_plane(np.concatenate([tilted(0.0), upper]), 0.04, 0.15, random())
    assert found[:600].mean() > 0.97
    assert not found[600:].any()


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 3)),
        tilted(0.0, points=49),
        np.zeros((80, 3)),
        np.outer(np.arange(80), (1, 2, 0)),
    ],
    ids=["none", "too few", "all the same", "on a line"],
)
def test_too_few_or_degenerate_points_have_no_plane(points):
    found, plane = ground_plane(points.astype(np.float32), 0.04, 0.15, random())
    assert plane is None
    assert found.shape == (len(points),)
    assert not found.any()


def test_results_depend_on_the_seed_only():
    points = random(3).uniform((-9, -9, -0.2), (9, 9, 0.2), (800, 3)).astype(np.float32)
    first, again, other = (ground_plane(points, 0.04, 0.15, random(seed))[0] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


@pytest.mark.plain
def test_outliers_match_the_formula():
    points = np.concatenate(
        [random().normal(0, 1, (500, 3)), random(1).uniform(-20, 20, (30, 3))]
    ).astype(np.float32)
    apart = np.linalg.norm(points[:, None].astype(float) - points[None], axis=2)
    mean = np.sort(apart, axis=1)[:, 1:51].mean(1)
    expected = mean > mean.mean() + 1.0 * math.sqrt(((mean - mean.mean()) ** 2).sum() / 529)
    np.testing.assert_array_equal(outliers(points, 50, 1.0), expected)
    assert expected.any()


@pytest.mark.plain
def test_few_points_have_fewer_neighbours():
    assert outliers(np.zeros((0, 3), np.float32), 50, 1.0).tolist() == []
    assert outliers(np.zeros((1, 3), np.float32), 50, 1.0).tolist() == [False]
    line = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [99, 0, 0]], np.float32)
    assert outliers(line, 50, 1.0).tolist() == [False, False, False, True]
