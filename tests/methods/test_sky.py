"""Rays into the sky, where a scan has no return.

Their image, their origins, and what SeeThrough removes with them.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.worlds import pose
from hypothesis import given, settings
from hypothesis import strategies as st

from dynaviz.blocks.blocks import voxels_of
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz_methods.seethrough import SeeThrough, SeeThroughParams
from dynaviz_methods.seethrough.clear_grid import ClearGrid, _by_sensor, _distinct
from dynaviz_methods.shared.sky import _nearest, sensor_image

SENSOR = Sensor(rings=65, elevation=(-32.0, 32.0))


def directions(low: float = -32.0, high: float = 32.0) -> np.ndarray:
    """Unit vectors through the centre of each pixel between two elevations."""
    azimuth, elevation = np.radians(
        np.meshgrid(np.arange(-179.5, 180.0), np.arange(low, high + 0.1))
    )
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], 2).reshape(
        -1, 3
    )


def ground(x: float = 0.0) -> np.ndarray:
    """What a sensor 2 m above flat ground sees of it, up to 18 m away."""
    rays = directions(high=-6.0)
    return rays * (-2.0 / rays[:, 2:]) + [x, 0.0, 2.0]


def truck(y: float) -> np.ndarray:
    """What the sensor sees of the side of a truck 8 m away, above the horizon as well."""
    rays = directions()
    rays = rays[rays[:, 0] > 0.1]
    points = rays * (8.0 / rays[:, :1]) + [0.0, 0.0, 2.0]
    return points[
        (points[:, 1] > y) & (points[:, 1] < y + 3) & (points[:, 2] > 0.3) & (points[:, 2] < 4)
    ]


def above(points: np.ndarray, z: float) -> np.ndarray:
    return points[points[:, 2] > z]


def scan(frame: int, *things: np.ndarray) -> Scan:
    return Scan(frame, np.concatenate(things).astype(np.float32), pose(0.0, 0.0, 2.0))


@pytest.mark.parametrize("sensor", [SENSOR, None])
def test_what_is_in_front_of_the_sky_alone_is_removed_if_the_field_of_view_is_known(
    sensor: Sensor | None,
) -> None:
    scans = [
        scan(k, ground(), above(truck(y), 2.2)) for k, y in enumerate(np.linspace(-9.0, 6.0, 12))
    ]
    method = SeeThrough(SeeThroughParams())
    method.begin(Context(Extent.of(*scans), sensor or Sensor()))
    for each in scans:
        method.observe(each)
    removed = method.label(scans[6]).dynamic
    high = scans[6].points[:, 2] > 2.2
    assert removed[: len(ground())].mean() < 0.01
    assert removed[high].mean() > 0.9 if sensor else not removed[high].any()


def test_rays_into_the_sky_cross_voxels_but_hit_none() -> None:
    """Next to a wall without sky above it, they are as long as the points around the
    hole are far.
    """
    seen = scan(0, ground(), truck(-1.5))
    grid = [
        ClearGrid(Extent.of(seen, scan(1, truck(-8.0))), 0.1, sensor=sensor)
        for sensor in (None, SENSOR)
    ]
    marks = [each.mark_once(seen, each.locate(seen.points)) for each in grid]
    hits, crossed = ([voxels_of(of.blocks, of.bits[:, k : k + 8]) for of in marks] for k in (8, 0))
    assert set(hits[0]) == set(hits[1])
    more = np.setdiff1d(crossed[1], crossed[0])
    assert len(more) > 100
    assert ((grid[0].keys(more)[:, 2] + 0.5) * 0.1 > 0.3).all(), "the ground has returns"
    assert set(crossed[0]) <= set(crossed[1])


def test_each_sensor_of_a_merged_scan_has_its_own_sky() -> None:
    parts = [ground(-3.0), ground(3.0)]
    origins = np.repeat([[-3.0, 0.0, 2.0], [3.0, 0.0, 2.0]], [len(part) for part in parts], 0)
    merged = Scan(0, np.concatenate(parts).astype(np.float32), pose(0.0, 0.0, 2.0), origins=origins)
    found = _by_sensor(merged, *_distinct(merged.origins))
    assert [each.position.tolist() for each in found] == [[-3.0, 0.0, 2.0], [3.0, 0.0, 2.0]]
    for each, part in zip(found, parts, strict=True):
        np.testing.assert_array_equal(each.points, part.astype(np.float32))
    moving = Scan(
        0,
        merged.points,
        merged.T_world_sensor,
        origins=np.linspace([0, 0, 2], [1, 0, 2], len(merged)),
    )
    assert _by_sensor(moving, *_distinct(moving.origins)) == [moving]


def test_rays_into_the_sky_end_before_the_points_next_to_it() -> None:
    image = sensor_image(SENSOR, 80.0)
    assert image is not None
    depth, hole = (
        np.full((image.rows, image.columns), 200, np.uint8),
        np.zeros((image.rows, image.columns), np.uint8),
    )
    depth[:40, 100:120], hole[:40, 100:120] = 255, 255
    depth[10:20, 99] = 20  # a sign next to the sky
    filled, chosen = image.sky(depth, hole)
    metres = image.farthest / 255
    assert chosen.sum() == 800
    assert (filled[9:21, 100] < 20 * metres).all()
    assert filled[20:38, 105:115].min() > 100 * metres


@pytest.mark.parametrize(
    ("sensor", "rows", "around"),
    [
        (Sensor(rings=64, elevation=(-24.8, 2.0)), 28, 1),
        (Sensor(rings=16, elevation=(-15.0, 15.0)), 31, 2),
        (Sensor(elevation=(-10.0, 30.0), points_per_sweep=14400), 40, 1),
        (Sensor(rings=10, elevation=(-30.67, 5.33)), 37, 4),
        (Sensor(rings=16), 0, 0),
        (Sensor(), 0, 0),
    ],
)
def test_pixels_are_a_degree_high_or_as_high_as_points_allow(
    sensor: Sensor, rows: int, around: int
) -> None:
    """No hole is deeper than the points up to one ring away."""
    image = sensor_image(sensor, 80.0)
    assert ((image.rows, image.around) if image else (0, 0)) == (rows, around)
    assert image is None or image.pixel > math.radians(0.98)


@pytest.mark.plain
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1.0))
@settings(max_examples=25)
def test_holes_are_as_deep_as_the_nearest_pixel_with_a_point(seed: int, share: float) -> None:
    random = np.random.default_rng(seed)
    depth, known = random.integers(0, 255, (9, 14)).astype(np.uint8), random.random((9, 14)) < share
    filled = _nearest(depth, np.where(known, 0, 255).astype(np.uint8))
    if not known.any():
        assert (filled == 255).all()
        return
    points = np.argwhere(known)
    for pixel in np.ndindex(9, 14):
        away = np.linalg.norm(points - pixel, axis=1)
        near = points[away <= 1.05 * away.min()]  # OpenCV's distances are a few per cent off
        assert filled[pixel] in depth[near[:, 0], near[:, 1]]
