from __future__ import annotations

import dataclasses
import math
from functools import cache

import numpy as np
import pytest
from helpers.reference.freedom import Reference
from helpers.worlds import pose

from dynaviz import kernels
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.params import resolve
from dynaviz.contracts.probe import SILENT, MemoryProbe
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.errors import UsageError
from dynaviz_methods.freedom.method import REASONS, Freedom, FreedomParams, image_of
from dynaviz_methods.shared.sky import DepthImage

pytestmark = pytest.mark.boundscheck

NAME = [reason.name for reason in REASONS]
SENSOR = Sensor(rings=16, elevation=(-40.0, 40.0))
COARSE = {
    "sub_voxel": 0.1,
    "min_range": 0.5,
    "counts_to_free": 2,
    "counts_to_revert": 3,
    "ray_range": 6.0,
    "max_range": 8.0,
}
LOW, HIGH = np.array([-3.0, -3.0, 0.0]), np.array([4.0, 3.0, 3.0])  # of the room


@cache
def busy_room(frames: int = 9, rays: int = 2200, seed: int = 0) -> list[Scan]:
    """Rays from a moving sensor to the walls of a room, to a box that moves for some frames and a
    box that leaves.
    """
    random, scans = np.random.default_rng(seed), []
    for frame in range(frames):
        origin = np.array([0.1 * frame - 0.4, -1.6, 1.2])  # on borders of voxels in some frames
        direction = random.normal(size=(rays, 3))
        surfaces = [
            np.where(direction > 0, (HIGH - origin) / direction, (LOW - origin) / direction).min(1)
        ]
        for centre in (
            (0.6 * min(frame, 6) - 2.2, 1.0, 1.2),
            (2.8, 0.5, 0.7) if frame < 3 else (9.0, 9.0, 9.0),
        ):
            near, far = np.sort(
                [(np.array(centre) + s - origin) / direction for s in (-0.4, 0.4)], axis=0
            )
            surfaces.append(
                np.where((near.max(1) > 0) & (near.max(1) < far.min(1)), near.max(1), np.inf)
            )
        points = origin + direction * np.min(surfaces, axis=0)[:, None]
        points = np.concatenate([points, [origin + 0.1, [-9.0, 0.0, 1.0]]])
        scans.append(Scan(10 + frame, points.astype(np.float32), pose(*origin)))
    return scans


def run(scans, probe=SILENT, extent=None, sensor=SENSOR, **values) -> Freedom:
    method = Freedom(FreedomParams(**values))
    method.begin(Context(extent or Extent.of(*scans), sensor, probe))
    for scan in scans:
        method.observe(scan)
    return method


def reasons(method, scans) -> list[list[str]]:
    return [[NAME[code] for code in method.label(scan).reasons] for scan in scans]


@pytest.mark.parametrize(
    "values",
    [{}, {"port": True}, {"counts_to_free": 1, "counts_to_revert": 1, "ray_max_height": 1.0}],
    ids=str,
)
def test_reasons_and_levels_match_the_reference(values):
    values = COARSE | {"sky": False} | values
    scans = busy_room()
    method, reference = run(scans, **values), Reference(FreedomParams(**values))
    own = [reference.observe(scan) for scan in scans]
    assert reasons(method, scans) == [
        reference.label(*pair) for pair in zip(scans, own, strict=True)
    ]
    alone = run(scans, own_scan=True, **values)
    for scan, levels in zip(scans, own, strict=True):
        np.testing.assert_array_equal(alone.label(scan).dynamic, np.array(levels) > 0)


@pytest.mark.plain
def test_every_reason_occurs_in_the_small_world():
    scans, found = busy_room(), set()
    for values in ({}, {"counts_to_free": 1, "counts_to_revert": 1}):
        found |= {name for scan in reasons(run(scans, **COARSE | values), scans) for name in scan}
    assert found == set(NAME) - {"out_of_reach"}


@pytest.mark.plain
def test_a_box_that_leaves_is_taken_back():
    """The box at the wall is static while it is there.

    Its points are removed once rays pass through its place.
    """
    scans = busy_room()
    box = [np.linalg.norm(scan.points - (2.8, 0.5, 0.7), axis=1) < 0.6 for scan in scans[:3]]
    shorter, longer = run(scans[:3], **COARSE), run(scans, **COARSE)
    removed = [
        np.mean(
            [method.label(scan).dynamic[b].mean() for scan, b in zip(scans[:3], box, strict=True)]
        )
        for method in (shorter, longer)
    ]
    assert removed[0] < 0.1
    assert removed[1] > 0.7


def test_online_the_scans_so_far_decide():
    scans = busy_room(6)
    method = run([], extent=Extent.of(*scans), **COARSE)
    for n, scan in enumerate(scans, 1):
        method.observe(scan)
        assert reasons(method, [scan]) == reasons(
            run(scans[:n], extent=Extent.of(*scans), **COARSE), [scan]
        )


def test_labels_do_not_depend_on_threads_the_probe_or_the_extent():
    scans = busy_room(6)
    wide = Extent(
        np.full(3, -10.0),
        np.full(3, 10.0),
        np.argwhere(np.ones((26, 26, 26))).astype(np.int32) - 13,
    )
    try:
        kernels.set_threads(1)
        alone = reasons(run(scans, **COARSE), scans)
        kernels.set_threads(None)
        assert reasons(run(scans, **COARSE, probe=MemoryProbe()), scans) == alone
        assert reasons(run(scans, **COARSE, extent=wide), scans) == alone
    finally:
        kernels.set_threads(None)


def test_states_match_the_labels():
    scans, probe = busy_room(), MemoryProbe()
    method = run(scans, probe=probe, **COARSE)
    assert set(probe.values) == {state.name for state in Freedom.info.emits}
    alone = run(scans, own_scan=True, **COARSE)
    free = 0
    for frame, scan in enumerate(scans):
        shown = {name: values[frame] for name, values in probe.values.items()}
        np.testing.assert_array_equal(shown["levels"].classes > 0, alone.label(scan).dynamic)
        free += len(shown["turned_free"].keys)
        assert shown["free_voxels"].value <= free
        assert np.isfinite(shown["depth"].ranges).any()
    assert method._map.resolution == pytest.approx(0.4)
    assert free > 100


def test_points_that_are_not_finite_or_too_far_are_kept():
    scan = busy_room(1)[0]
    points = np.array([[np.nan, 0, 0], [2e4, 0, 0], [0, -1.6, 1.25]], np.float32)
    odd = dataclasses.replace(scan, points=np.concatenate([scan.points, points]))
    method = run([odd], extent=Extent.of(scan), **COARSE)
    assert reasons(method, [odd])[0][-3:] == ["out_of_reach", "out_of_reach", "out_of_range"]


IMAGE = DepthImage(16, math.radians(40), math.radians(-40), 20.0, 3, 0)


def test_rays_into_the_sky_end_in_holes_at_the_upper_border():
    """Walls up to 10 degrees, and a window below that horizon which must stay closed."""
    random = np.random.default_rng(3)
    azimuth, elevation = (
        random.uniform(-np.pi, np.pi, 60000),
        np.radians(random.uniform(-42, 10, 60000)),
    )
    window = (np.abs(azimuth) < 0.3) & (np.abs(elevation + 0.2) < 0.12)
    azimuth, elevation = azimuth[~window], elevation[~window]
    away = np.stack(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ],
        1,
    )
    T = pose(3.0, -2.0, 1.5)
    T[:2, :2] = [[0.6, -0.8], [0.8, 0.6]]
    scan = Scan(0, (10 * away @ T[:3, :3].T + T[:3, 3]).astype(np.float32), T)
    depth, hole = IMAGE.of(scan)
    assert set(depth[hole == 0]) <= {126, 127}  # 10 m in units of 20 / 255 m
    filled, chosen = IMAGE.sky(depth, hole)
    assert chosen[:5].all()
    assert not chosen[7:].any()
    ends = (IMAGE.targets(scan, filled, chosen) - T[:3, 3]) @ T[:3, :3]
    ranges = np.linalg.norm(ends, axis=1)
    assert ranges.max() < 10
    assert ranges.min() > 8
    assert np.degrees(np.arcsin(ends[:, 2] / ranges)).min() > 9


def test_the_depth_image_follows_from_the_sensor_or_the_parameters():
    assert image_of(FreedomParams(), SENSOR).rows == 16
    assert image_of(
        FreedomParams(image_rows=9, lowest=-10, highest=6), SENSOR
    ).pixel == pytest.approx(math.radians(2))
    assert (
        image_of(FreedomParams(), Sensor(elevation=(-10.0, 30.0), points_per_sweep=14400)).rows
        == 40
    )
    with pytest.raises(UsageError, match="freedom needs the rows and the vertical field of view"):
        image_of(FreedomParams(), Sensor())


@pytest.mark.parametrize(
    "values",
    [
        {"sub_voxel": 0.0},
        {"max_range": 1.0},
        {"min_height": 1.0},
        {"ray_max_height": -1.0},
        {"counts_to_free": 0},
        {"image_rows": 1},
        {"highest": 91.0},
        {"inpaint": 0},
        {"erosion": -1},
    ],
    ids=str,
)
def test_invalid_parameters_are_rejected(values):
    with pytest.raises(ValueError, match=next(iter(values))):
        FreedomParams(**values)


def test_presets_have_the_published_values():
    published = {
        "kitti": (80.0, 6, 64, False),
        "kitti_01": (80.0, 3, 64, False),
        "helimos": (240.0, 3, 32, False),
        "semindoor": (40.0, 3, 0, False),
        "port": (80.0, 6, 64, True),
    }
    for preset, expected in published.items():
        p = resolve(Freedom, preset).params
        assert (p.max_range, p.counts_to_free, p.image_rows, p.port) == expected
