from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from reference_dynablox import Reference
from worlds import pose

from dynaviz import kernels
from dynaviz.errors import UsageError
from dynaviz.method import Context
from dynaviz.probe import SILENT, MemoryProbe, PointClasses, Voxels
from dynaviz.scan import Scan
from dynaviz.sensors import Sensor, load_sensor
from dynaviz.survey import Extent
from dynaviz_methods.dynablox import REASONS, STATES, Dynablox, DynabloxParams, view_of

SENSOR = Sensor(rings=20, elevation=(-40.0, 50.0))
# Coarse enough for the plain reference, and so that the few rays of the room fill the image.
COARSE = DynabloxParams(
    resolution=0.4,
    image_columns=60,
    truncation=0.7,
    occupied_distance=0.4,
    burn_in=2,
    temporal_buffer=1,
    revoke_after=6,
    cluster_distance=0.5,
    min_cluster=5,
    max_cluster=200,
)
NAME = [reason.name for reason in REASONS]


def busy_room(frames: int = 11, rays: int = 2500, seed: int = 0) -> list[Scan]:
    """Rays from a sensor that moves, turns and pitches, to the walls of a room and to boxes that come and go."""
    random = np.random.default_rng(seed)
    low, high = np.array([-4.0, -4.0, 0.0]), np.array([5.0, 4.0, 4.0])
    boxes = [
        (first, first + stays, random.uniform((-2, -2, 1), (3, 2, 3))) for first, stays in ((5, 1), (6, 2), (7, 9))
    ]
    scans = []
    for frame in range(frames):
        T_world_sensor = pose(0.1 * frame, z=2.0) @ rotation(0.2 * frame, 0.1 * math.sin(frame))
        origin = T_world_sensor[:3, 3]
        direction = random.normal(size=(rays, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        reach = np.where(direction > 0, (high - origin) / direction, (low - origin) / direction).min(1)
        for first, last, centre in boxes:
            near, far = np.sort([(centre + side - origin) / direction for side in (-0.5, 0.5)], axis=0)
            enter = near.max(1)
            met = (first <= frame < last) & (enter > 0) & (enter < far.min(1))
            reach = np.where(met, np.minimum(reach, enter), reach)
        points = origin + direction * reach[:, None] + random.normal(0, 0.01, (rays, 3))
        scans.append(Scan(10 + frame, points.astype(np.float32), T_world_sensor))
    return scans


def rotation(yaw: float, pitch: float) -> np.ndarray:
    turn = np.eye(4)
    turn[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
    tilt = np.eye(4)
    tilt[::2, ::2][:2, :2] = [[math.cos(pitch), math.sin(pitch)], [-math.sin(pitch), math.cos(pitch)]]
    return turn @ tilt


def run(scans, params=COARSE, probe=SILENT, extent=None, sensor=SENSOR):
    method = Dynablox(params)
    method.begin(Context(extent or Extent.of(*scans), sensor, probe))
    for scan in scans:
        method.observe(scan)
    return method


def reasons(method, scans):
    return np.concatenate([method.explain(scan) for scan in scans])


def waiting(frames: int, arrives: int, params=COARSE) -> list[Scan]:
    """A wall all around; from a frame on a thing stands where it was free."""
    random = np.random.default_rng(0)
    azimuth = np.linspace(-np.pi, np.pi, 4000)
    elevation = random.uniform(-0.35, 0.35, len(azimuth))
    directions = np.stack([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)], 1)
    thing = np.abs(azimuth) < 0.15
    scans = []
    for index in range(frames):
        reach = np.where(thing & (index >= arrives), 3.1, 6.1)[:, None]
        T_world_sensor = np.eye(4)
        T_world_sensor[:3, 3] = 0.1, 0.1, 0.1
        scans.append(Scan(index, (0.1 + directions * reach).astype(np.float32), T_world_sensor))
    return scans


@pytest.mark.parametrize(
    ("changes", "seed"),
    [
        ({}, 0),
        ({"min_range": 1.5, "max_range": 5.0}, 1),
        ({"resolution": 0.45, "max_weight": 2, "revoke_after": 3}, 2),
        ({"resolution": 0.33, "burn_in": 1, "cluster_distance": 1.0, "min_cluster": 12}, 3),
        ({"resolution": 0.5, "truncation": 1.2, "occupied_distance": 0.6, "temporal_buffer": 2, "max_cluster": 30}, 4),
        ({"field_of_view": 60.0, "image_rows": 13, "burn_in": 0, "temporal_buffer": 0}, 5),
    ],
)
def test_agrees_with_the_plain_reference_point_by_point(changes, seed):
    params = dataclasses.replace(COARSE, **changes)
    scans = busy_room(seed=seed)
    method = Dynablox(params)
    extent = Extent.of(*scans)
    method.begin(Context(extent, SENSOR))
    view = view_of(params, SENSOR)
    reference = Reference(params, view.rows, view.top, view.bottom, extent.low, extent.high)
    names = set()
    for scan in scans:
        method.observe(scan)
        expected = reference.observe(scan)
        np.testing.assert_array_equal(method.explain(scan), expected)
        names |= {NAME[code] for code in expected}
    assert "never_free" in names
    assert any(name.startswith("ever_free") for name in names)
    # Voxel by voxel, where points lie.
    voxels = 512 * np.repeat(np.flatnonzero(method._map._inner), 512) + np.tile(
        np.arange(512), method._map._inner.sum()
    )
    keys = method._map.grid.keys(voxels) - reference.low
    inside = ((keys >= 1) & (keys < reference.shape - 1)).all(1)
    at = tuple(keys[inside].T)
    for ours, theirs in ((method._map.free, reference.free), (method._map.revoked, reference.revoked)):
        np.testing.assert_array_equal(kernels.ever_free.get(voxels, ours)[inside], theirs[at])
    first = method._map._first[voxels // 512] + voxels % 512
    np.testing.assert_array_equal(method._map._weight[first][inside], reference.weight[at])
    apart = np.abs(method._map._distance[first][inside] - reference.distance[at]) > 2e-5
    assert apart.sum() <= 3  # voxels on a pixel's border, which float32 sees on its other side
    np.testing.assert_array_equal(method._map._counts[first][inside] >= 2, reference.count[at] >= 2)


def test_every_reason_but_out_of_reach_is_given_in_the_room():
    found = set()
    for changes in ({}, {"max_range": 5.0, "revoke_after": 2, "max_cluster": 30}):
        scans = busy_room()
        found |= set(reasons(run(scans, dataclasses.replace(COARSE, **changes)), scans).tolist())
    assert found == set(range(7))
