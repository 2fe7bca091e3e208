"""The height of the ground under a map: reflections, slopes, objects on it, and places where it is not seen."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.reference.seethrough import Reference
from helpers.worlds import pose
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from dynaviz import kernels
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.scan import Scan
from dynaviz_methods.clear_grid import ClearGrid
from dynaviz_methods.ground_height import AROUND, SLOPE, STEEP, GroundHeight
from dynaviz_methods.seethrough import SeeThroughParams

pytestmark = pytest.mark.boundscheck


def plane(low: float, high: float, incline: float = 0.0) -> np.ndarray:
    """Points every 0.2 m on a square that rises along x."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(low, high, 0.2), np.arange(low, high, 0.2)))
    return np.stack([x, y, incline * x], 1)


def heights(points: np.ndarray) -> np.ndarray:
    """(N,) heights of the points of one scan above its ground, metres."""
    points = points.astype(np.float32)
    grid = ClearGrid(Extent.of(Scan(0, points, pose(0, 0, 1.8))), 0.1)
    ground, voxels = GroundHeight(grid.blocks, 0.1), grid.locate(points)
    ground.add(points, voxels)
    return ground.height(points, voxels, np.zeros(3))


def test_stray_returns_far_below_the_ground_do_not_lower_it() -> None:
    ground = plane(6.0, 13.0)
    stray = [[4.0, 4.0, -20.0], [4.02, 4.02, -20.0], [4.04, 4.04, -20.0]]
    assert np.abs(heights(np.concatenate([ground, stray]))[:-3]).max() < 0.13


def test_reflections_below_the_ground_do_not_lower_it() -> None:
    random, slope = np.random.default_rng(0), plane(-3.0, 13.0, 0.1)
    below = np.column_stack([random.uniform(-3, 13, (40, 2)), random.uniform(-4, -0.5, 40)])
    height = heights(np.concatenate([slope, below, [[2.0, 2.0, 1.0]]]))
    assert np.abs(height[: len(slope)][(slope[:, :2] < 12).all(1)]).max() < 0.13, (
        "half a column's width up or down the slope, plus the limit on the slope"
    )
    assert height[-1] == pytest.approx(0.8, abs=0.13)


def test_reflections_next_to_each_other_do_not_lower_the_ground() -> None:
    """Four columns of a wet road, seen from one side: a quarter of the columns that are known around them."""
    seen, deep = plane(0.0, 4.0), plane(0.0, 1.6) + np.array([4.0, 0.0, 0.0])
    deep[:, 2] = -21.2 - np.floor(deep[:, 0] / 0.8 + 2 * np.floor(deep[:, 1] / 0.8))
    assert np.abs(heights(np.concatenate([seen, deep]))[: len(seen)]).max() < 0.13


def test_slopes_are_ground_and_what_is_steeper_stands_on_it() -> None:
    slope = plane(-20.0, 20.0, 0.17)
    box = plane(0.0, 4.0) + np.array([0.0, 0.0, 1.5])
    under = (slope[:, :2] > -0.2).all(1) & (slope[:, :2] < 4.2).all(1)
    height = heights(np.concatenate([slope[~under], box]))
    inside = (np.abs(slope[~under][:, :2]) < 19).all(1)
    assert np.abs(height[: (~under).sum()][inside]).max() < 0.1
    assert height[-len(box) :].min() > 0.5


def test_ground_that_is_not_seen_around_the_sensor_does_not_rise_to_what_stands_there() -> None:
    """A sensor whose lowest rays are 7 degrees below the horizon sees no ground within 11 m, only the top of a box."""
    far = plane(-20.0, 20.0)
    far = far[np.linalg.norm(far[:, :2], axis=1) > 11]
    box = plane(3.0, 4.0) + np.array([0.0, 0.0, 1.0])
    assert heights(np.concatenate([far, box]))[-len(box) :].min() > 0.2


@pytest.mark.parametrize(("ground", "lift"), [(400, 0.2), (1200, 0.2), (200, 0.0)])
def test_the_densest_layer_of_a_cell_is_its_ground_if_it_has_enough_points(ground: int, lift: float) -> None:
    random = np.random.default_rng(0)
    height = random.uniform(-3, 3, 4000).astype(np.float32)
    height[:ground] = random.normal(0.2, 0.02, ground)
    cell = np.column_stack([random.uniform(0.1, 9.9, (4000, 2)), height]).astype(np.float32)
    points = np.concatenate([cell, cell - np.array([10, 0, 0], np.float32)])  # in the second cell, the ground is right
    heights = np.concatenate([height, height - 0.2]).astype(np.float32)
    layer = (0.1, 0.06, 0.3), 50, 0.1
    found = kernels.ground_height.aligned(heights, points, np.ones(8000, bool), np.zeros(3), 30.0, 10.0, *layer)
    assert (heights - found)[:4000] == pytest.approx(lift, abs=0.02)
    assert (found == heights)[4000:].all()


@given(
    arrays.arrays(np.float64, (7, 6), elements=st.integers(0, 40).map(lambda n: n / 20 if n < 38 else math.inf)),
    st.tuples(st.integers(-40, 40), st.integers(-40, 40)),
)
@settings(max_examples=40, deadline=None)
def test_the_lowered_surface_equals_a_plain_one(surface: np.ndarray, first: tuple[int, int]) -> None:
    reference, edge = Reference(SeeThroughParams()), 0.8
    cells = {(first[0] + x, first[1] + y): surface[x, y] for x, y in np.ndindex(surface.shape)}
    wanted = np.array(list(reference.pressed(cells).values())).reshape(surface.shape)
    low = np.array(first, np.int64)
    incline = kernels.ground_height.inclines(surface, low, AROUND, STEEP * edge, SLOPE * edge)
    assert np.hypot(*incline.reshape(-1, 2).T).max() <= SLOPE * edge * 1.0001
    lowered = surface.copy()
    kernels.ground_height.lower(lowered, incline, SLOPE * edge)
    np.testing.assert_allclose(lowered, wanted, atol=1e-6)
