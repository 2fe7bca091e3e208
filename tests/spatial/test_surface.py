"""Surfaces of a scan, and the angles at which rays meet them."""

import numpy as np
import pytest

from dynaviz.spatial.surface import GRAZING, angles, surface_normals

pytestmark = [pytest.mark.plain, pytest.mark.boundscheck]


def patch(normal, middle, count=200):
    """Points on a disc of 0.6 m with noise of 1 cm across it."""
    rng, axes = np.random.default_rng(0), np.linalg.svd(np.array([normal], float))[2]
    flat = (
        rng.uniform(-0.35, 0.35, (count, 2)) @ axes[1:] + rng.normal(0, 0.01, (count, 1)) * axes[0]
    )
    return (flat + middle).astype(np.float32)


@pytest.mark.parametrize("sine", [0.05, 0.3, 0.5, 1.0])
def test_the_angle_is_that_between_ray_and_surface(sine):
    middle = np.array([20.0, -5.0, 1.0])
    ray = middle / np.linalg.norm(middle)
    across = np.cross(ray, [0, 0, 1]) / np.linalg.norm(np.cross(ray, [0, 0, 1]))
    points = patch(sine * ray + np.sqrt(1 - sine**2) * across, middle)
    asked = np.concatenate([points[:3], [[900, 0, 0], [np.nan, 0, 0]]]).astype(np.float32)
    normals = surface_normals(
        np.concatenate([points, points + 50, [[np.nan] * 3]]), asked, np.zeros((1, 3))
    )
    found = angles(asked.astype(float), normals)
    np.testing.assert_allclose(found[:3], np.degrees(np.arcsin(sine)), atol=3)
    assert np.isnan(found[3:]).all()
    assert (found[:3] < GRAZING).all() == (sine < 0.34)


def test_the_points_of_a_single_ring_are_no_surface():
    turn = np.linspace(0, 0.2, 60)
    away = 10 + np.random.default_rng(0).uniform(-0.3, 0.3, 60)  # leaves at different ranges
    ring = np.stack([away * np.cos(turn), away * np.sin(turn), -0.1 * away], 1).astype(np.float32)
    assert np.isnan(surface_normals(ring, ring, np.zeros((1, 3)))).all()
    assert np.isnan(surface_normals(ring[:3], ring, np.zeros((1, 3)))).all()
    assert surface_normals(ring, ring[:0], np.zeros((1, 3))).shape == (0, 3)
