"""The ground of one scan: reflections, ramps, roofs, other floors, nothing below the sensor."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.reflections import KINDS, SENSORS, below, road

from dynaviz.spatial.scan_ground import EDGE, REACH, ScanGround
from dynaviz.spatial.sensor_height import sensor_height
from dynaviz.testing.world import SLOPE, crossing


def heights(
    points: np.ndarray, position: tuple[float, float, float] = (0.0, 0.0, 1.8)
) -> np.ndarray:
    points = points.astype(np.float32)
    return ScanGround.of(points, np.array(position)).heights(points)


def plane(low: float, high: float, step: float, z: float = 0.0) -> np.ndarray:
    x, y = (a.ravel() for a in np.meshgrid(np.arange(low, high, step), np.arange(low, high, step)))
    return np.stack([x, y, np.full(len(x), z)], 1)


def test_reflections_below_the_road_are_not_its_ground() -> None:
    mirrored = plane(4.0, 9.0, 0.3, -3.0) + np.random.default_rng(0).normal(0, 0.4, (289, 3))
    found = heights(np.concatenate([plane(-12, 12, 0.1), mirrored]))
    assert np.abs(found[:-289]).max() < 0.05
    assert found[-289:].max() < -1.0


def test_scattered_reflections_below_a_slope_are_not_its_ground() -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform(-20, 20, (20_000, 2))
    ground = np.c_[xy, 0.05 * xy[:, 0] + rng.normal(0, 0.02, len(xy))]
    posts, below = ground[:50] + np.array([0, 0, 1.5]), ground[50:80] - np.array([0, 0, 4.0])
    found = heights(np.concatenate([ground, posts, below]))
    assert np.abs(found[: len(ground)]).max() < 0.3
    assert found[len(ground) : -30] == pytest.approx(1.5, abs=0.2)
    assert (found[-30:] < -3).all()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sensor", SENSORS)
def test_returns_from_beyond_the_road_do_not_change_its_ground(sensor: str, kind: str) -> None:
    """Of any number, place and depth, with and without the height of the sensor in earlier scans.

    Sensors that look forward do not see the road under themselves.
    """
    height = SENSORS[sensor][2]
    changed = []
    for seed in range(8):
        rng = np.random.default_rng([seed, KINDS.index(kind)])
        points, flat = road(rng, sensor)
        more = below(rng, points, flat, height, kind)
        both = np.concatenate([points, more]).astype(np.float32)
        without = ScanGround.of(points.astype(np.float32), np.zeros(3)).heights(both)
        for before in (height, -np.inf):
            found = ScanGround.of(both, np.zeros(3), height_before=before).heights(both)
            changed.append((np.abs(found - without)[: len(points)] > 0.3).mean())
    known = changed[::2]
    assert np.mean(known) < 0.03
    assert np.median(known) < 0.01
    assert np.mean(changed[1::2]) < 0.1


def test_ground_is_where_it_was_if_more_cells_show_a_mirrored_ceiling() -> None:
    """A quarter of the rays to it pass below ground that is seen: enough at the height before."""
    seen = plane(-6, 6, 0.1)
    mirrored = plane(-24, 24, 0.4, -4.0)
    mirrored = mirrored[np.abs(mirrored[:, :2]).max(1) > 12]
    points = np.concatenate([seen, mirrored]).astype(np.float32)
    position = np.array([0.0, 0.0, 1.8])
    found = ScanGround.of(points, position, height_before=1.8)
    assert found.sensor_height == pytest.approx(1.8, abs=0.1)
    assert np.abs(found.heights(points)[: len(seen)]).max() < 0.05


@pytest.mark.parametrize("height", [0.3, 1.0, 5.0, 12.0])
def test_a_sensor_that_was_lifted_or_lowered_finds_the_ground(height: float) -> None:
    points = plane(-20, 20, 0.2).astype(np.float32)
    found = ScanGround.of(points, np.array([0.0, 0.0, height]), height_before=1.8)
    assert found.sensor_height == pytest.approx(height, abs=0.1)
    assert np.abs(found.heights(points)).max() < 0.05


@pytest.mark.parametrize("before", [1.8, -np.inf])
def test_a_road_next_to_a_bridge_does_not_lower_it(
    before: float,
) -> None:
    """Rays to the road pass over the edge of the bridge, which hides what is nearer."""
    bridge = plane(-6, 6, 0.1)
    road = plane(-30, 30, 0.4, -6.0)
    road = road[(road[:, 0] > 26) & (np.abs(road[:, 1]) < 3)]
    points = np.concatenate([bridge, road]).astype(np.float32)
    found = ScanGround.of(points, np.array([0.0, 0.0, 1.8]), height_before=before).heights(points)
    assert np.abs(found[: len(bridge)]).max() < 0.05


@pytest.mark.parametrize("slope", [0.08, -0.08, 0.15])
def test_a_ramp_is_ground(slope: float) -> None:
    flat = plane(-12, 30, 0.15)
    flat[:, 2] += slope * np.maximum(flat[:, 0] - 4.0, 0.0)
    assert np.quantile(np.abs(heights(flat)), 0.99) < 0.15


@pytest.mark.parametrize("reach", [REACH, 2 * REACH])
def test_points_beyond_the_raster_are_measured_from_the_ground_at_its_border(reach: int) -> None:
    rise = plane(-90, 90, 0.4)
    rise[:, 2] = 0.05 * np.maximum(rise[:, 0] - 20.0, 0.0)
    points = rise.astype(np.float32)
    found = ScanGround.of(points, np.array([0.0, 0.0, 1.8]), reach).heights(points)
    beyond = 0.05 * np.maximum(rise[:, 0] - (reach - 0.5) * EDGE, 0.0)
    inside = (np.abs(rise[:, :2]) < 88).all(1)  # cells at the edge of the plane are not full
    np.testing.assert_allclose(found[inside], beyond[inside], atol=0.1)


def test_ground_under_a_roof_is_the_ground_next_to_it() -> None:
    around = plane(-12, 12, 0.1)
    around = around[(np.abs(around[:, 0] - 5) > 2) | (np.abs(around[:, 1] - 5) > 2)]
    found = heights(np.concatenate([around, plane(3.0, 7.0, 0.1, 1.4)]))
    assert np.abs(found[: len(around)]).max() < 0.1
    assert np.abs(found[len(around) : len(around) + 1600] - 1.4).max() < 0.1


def test_no_ground_is_known_without_points_below_the_sensor() -> None:
    assert np.isinf(heights(plane(-3, 3, 0.1, 4.0))).all()
    assert heights(np.zeros((0, 3))).shape == (0,)


def test_points_that_are_not_finite_are_infinitely_high() -> None:
    points = plane(-5, 5, 0.1)
    points[7, 0], points[8, 2] = np.nan, -np.inf
    assert np.flatnonzero(np.isinf(heights(points))).tolist() == [7, 8]


def test_heights_do_not_depend_on_the_origin_of_the_world() -> None:
    """Exact in float32, here and at whole cells far away."""
    rng = np.random.default_rng(1)
    xy = np.round(rng.uniform(-20, 20, (3000, 2)) * 64) / 64
    ground = np.c_[xy, np.round(0.05 * xy[:, 0] * 64) / 64]
    offset = np.array([5120 * EDGE, -1280 * EDGE, 50.0])
    assert (offset == np.round(offset)).all()
    moved = heights(ground + offset, tuple(offset + np.array([0.0, 0.0, 1.8])))
    np.testing.assert_allclose(moved, heights(ground), atol=1e-3)


def test_the_height_of_a_sensor_is_its_distance_from_sloping_ground() -> None:
    exact = [
        SLOPE @ (0.6 * frame - 3.0, 0.05 * frame, 1.8) / np.linalg.norm(SLOPE)
        for frame in range(12)
    ]
    found = [sensor_height(scan.points - scan.position) for scan in crossing()]
    assert [height for height, _ in found] == pytest.approx(exact, abs=0.02)
    assert min(share for _, share in found) > 0.9


def test_neither_walls_nor_few_points_are_ground() -> None:
    wall = np.stack(
        [np.linspace(-9, 9, 4000), np.full(4000, 3.0), np.tile(np.linspace(-1.7, 3.0, 100), 40)], 1
    )
    assert sensor_height(wall)[1] < 0.3
    assert sensor_height(plane(-2, 2, 0.1, -1.8)) == (0.0, 0.0)
