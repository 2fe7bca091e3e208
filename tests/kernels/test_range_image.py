"""Pixels against numpy in double precision, also where single precision would give
another pixel.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dynaviz import kernels
from dynaviz_methods.shared.range_images import image_views, slices, whole

SHARED = kernels.load("dynaviz_methods.shared.kernels")

pytestmark = pytest.mark.boundscheck

RESOLUTIONS = (2.5, 0.7)
TURNS = {"none": np.eye(3), "some": Rotation.from_euler("xyz", (0.1, -0.2, 2.5)).as_matrix()}


@np.errstate(invalid="ignore", over="ignore")
def pixels(xyz, position, axes, view, clamp):
    """(M,) of float32 points (3, M); -1 outside."""
    away = xyz.astype(np.float64) - position[:, None]
    x, y, z = axes @ away
    row = np.floor(view[2] - np.arctan2(z, np.hypot(x, y)) * view[3] + 0.5)
    column = np.floor(view[4] + np.arctan2(y, x) * view[5] + 0.5)
    inside = (row >= 0) & (row <= view[0]) & (column >= 0) & (column <= view[1])
    row, column = np.clip(row, 0, view[0] - 1), np.clip(column, 0, view[1] - 1)
    r = np.linalg.norm(away.astype(np.float32), axis=0)
    pixel = np.where(
        (inside | clamp) & (r > 0) & np.isfinite(r), view[6] + row * view[1] + column, -1
    )
    return pixel.astype(int)


def near_borders(position, axes, view):
    """(3, M) float32: points on borders of pixels, behind, above, below and at the sensor, and not
    finite.
    """
    random = np.random.default_rng(0)
    columns = (random.integers(0, view[1] + 1, 4000) - 0.5 - view[4]) / view[5]
    rows = (view[2] - random.integers(0, view[0] + 1, 4000) + 0.5) / view[3]
    azimuth = np.concatenate(
        [columns, random.uniform(-np.pi, np.pi, 4000), np.repeat([np.pi, -np.pi, 0, 1], 400)]
    )
    elevation = np.concatenate(
        [random.uniform(-1.57, 1.57, 4000), rows, random.uniform(-1.57, 1.57, 1600)]
    )
    flat = np.cos(elevation)
    direction = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
    points = axes.T @ direction * random.uniform(0.5, 100, len(azimuth)) + position[:, None]
    behind = np.stack(
        [-np.linspace(1, 90, 500), random.normal(0, 1e-7, 500), random.normal(0, 1, 500)]
    )
    odd = np.array(
        [[0, 0, 9], [0, 0, -9], [0, 0, 0], [np.nan, 1, 1], [np.inf, 1, 1], [1e38, 1e38, 0]]
    ).T
    odd[:, :3] += position[:, None]
    return np.concatenate([points, axes.T @ behind + position[:, None], odd], 1).astype(np.float32)


@pytest.mark.parametrize("clamp", [False, True])
@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize(
    "span", [((-25.0, 15.0), (-180.0, 180.0)), ((-90.0, 90.0), (-60.0, 90.0))], ids=str
)
def test_pixels_are_those_of_double_precision(span, turn, clamp):
    position, axes = (
        kernels.as_readonly((311.7, -84.1, 5.3), np.float64),
        kernels.as_readonly(TURNS[turn], np.float64),
    )
    views = image_views(RESOLUTIONS, *span)
    xyz = kernels.as_readonly(near_borders(position, axes, views[0]), np.float32)
    for k, view in enumerate(views):
        expected = pixels(xyz, position, axes, view, clamp)
        found = np.full(len(expected), -2)
        for first in range(0, len(expected), 1024):
            last = min(first + 1024, len(expected))
            buffers = (
                np.empty((2, 1024), np.int32),
                np.empty(1024, np.float32),
                np.empty((3, 1024), np.float32),
            )
            SHARED.range_image._project(xyz, first, last, position, axes, views, clamp, *buffers)
            found[first:last] = buffers[0][k, : last - first]
        np.testing.assert_array_equal(found, expected)


@pytest.mark.plain
@pytest.mark.parametrize("lanes", [1, 2, 3, 7])
def test_the_nearest_point_of_a_pixel_wins_and_the_first_of_equals(lanes):
    random = np.random.default_rng(1)
    views = image_views(RESOLUTIONS, (-20.0, 20.0), (-180.0, 180.0))
    once = random.normal(0, (10, 10, 2), (3000, 3)).astype(np.float32)
    xyz = kernels.as_readonly(np.concatenate([once, once]).T, np.float32)
    position, axes = (
        kernels.as_readonly(np.zeros(3), np.float64),
        kernels.as_readonly(np.eye(3), np.float64),
    )
    camera, least = (position, axes, views, False), np.float32(3)
    ranges, indices = SHARED.range_image.nearest(xyz, *whole(xyz.shape[1]), *camera, lanes, least)
    distance = np.linalg.norm(xyz.astype(np.float64), axis=0)
    expected = np.full(len(indices), -1)
    for view in views:
        pixel = pixels(xyz, position, axes, view, False)
        for i in np.argsort(-distance[:3000], kind="stable"):
            if pixel[i] >= 0 and distance[i] >= least:
                expected[pixel[i]] = i
    np.testing.assert_array_equal(indices, expected)
    assert np.isinf(ranges[indices < 0]).all()
    np.testing.assert_allclose(ranges[indices >= 0], distance[indices[indices >= 0]], rtol=1e-6)
    assert [int(s.stop - s.start) for s in slices(views)] == [100 * 900, 28 * 252]


@pytest.mark.plain
def test_an_empty_cloud_makes_an_empty_image():
    views = image_views((1.0,), (-20.0, 20.0), (-180.0, 180.0))
    camera = (
        kernels.as_readonly(np.zeros(3), np.float64),
        kernels.as_readonly(np.eye(3), np.float64),
        views,
        False,
    )
    ranges, indices = SHARED.range_image.nearest(
        kernels.as_readonly(np.empty((3, 0)), np.float32), *whole(0), *camera, 2, np.float32(0)
    )
    assert np.isinf(ranges).all()
    assert (indices == -1).all()
