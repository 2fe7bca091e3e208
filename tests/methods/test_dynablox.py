from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from helpers.marks import compiled_only
from helpers.reference.dynablox import Reference
from helpers.worlds import pose

from dynaviz import kernels
from dynaviz.blocks.blocks import read
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.probe import SILENT, MemoryProbe
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor, load_sensor
from dynaviz.errors import UsageError
from dynaviz_methods.dynablox.free_space import SensorView
from dynaviz_methods.dynablox.method import (
    BESIDE,
    FREE,
    FREE_LARGE,
    FREE_SMALL,
    NEVER_FREE,
    OUT_OF_RANGE,
    OUT_OF_REACH,
    REASONS,
    REVOKED,
    Dynablox,
    DynabloxParams,
    view_of,
)

pytestmark = pytest.mark.boundscheck

SENSOR = Sensor(rings=20, elevation=(-40.0, 50.0))
# Coarse enough for the slow reference, and for the few rays of the room to fill the image.
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
    """Rays from a moving, turning and pitching sensor to the walls of a room and to boxes that
    appear and disappear.
    """
    random = np.random.default_rng(seed)
    low, high = np.array([-4.0, -4.0, 0.0]), np.array([5.0, 4.0, 4.0])
    boxes = [
        (first, first + stays, random.uniform((-2, -2, 1), (3, 2, 3)))
        for first, stays in ((5, 1), (6, 2), (7, 9))
    ]
    scans = []
    for frame in range(frames):
        T_world_sensor = pose(0.1 * frame, z=2.0) @ rotation(0.2 * frame, 0.1 * math.sin(frame))
        origin = T_world_sensor[:3, 3]
        direction = random.normal(size=(rays, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        reach = np.where(
            direction > 0, (high - origin) / direction, (low - origin) / direction
        ).min(1)
        for first, last, centre in boxes:
            near, far = np.sort(
                [(centre + side - origin) / direction for side in (-0.5, 0.5)], axis=0
            )
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
    tilt[::2, ::2][:2, :2] = [
        [math.cos(pitch), math.sin(pitch)],
        [-math.sin(pitch), math.cos(pitch)],
    ]
    return turn @ tilt


def run(scans, params=COARSE, probe=SILENT, extent=None, sensor=SENSOR):
    method = Dynablox(params)
    method.begin(Context(extent or Extent.of(*scans), sensor, probe))
    for scan in scans:
        method.observe(scan)
    return method


def reasons(method, scans):
    return np.concatenate([method.label(scan).reasons for scan in scans])


def waiting(frames: int, arrives: int) -> list[Scan]:
    """A wall all around the sensor; from one frame on, an object is in space that was free."""
    random = np.random.default_rng(0)
    azimuth = np.linspace(-np.pi, np.pi, 4000)
    elevation = random.uniform(-0.35, 0.35, len(azimuth))
    directions = np.stack([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)], 1)
    thing = (np.abs(azimuth) < 0.15) & (np.abs(elevation) < 0.15)
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
        pytest.param(
            {"resolution": 0.45, "max_weight": 2, "revoke_after": 3}, 2, marks=pytest.mark.slow
        ),
        pytest.param(
            {"resolution": 0.33, "burn_in": 1, "cluster_distance": 1.0, "min_cluster": 12},
            3,
            marks=pytest.mark.slow,
        ),
        (
            {
                "resolution": 0.5,
                "truncation": 1.2,
                "occupied_distance": 0.6,
                "temporal_buffer": 2,
                "max_cluster": 30,
            },
            4,
        ),
        ({"field_of_view": 60.0, "image_rows": 13, "burn_in": 0, "temporal_buffer": 0}, 5),
    ],
)
def test_reasons_and_voxels_match_the_reference(changes, seed):
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
        np.testing.assert_array_equal(method.label(scan).reasons, expected)
        names |= {NAME[code] for code in expected}
    assert "never_free" in names
    assert any(name.startswith("ever_free") for name in names)
    # Compare the state of the voxels where points lie.
    voxels = 512 * np.repeat(np.flatnonzero(method._map._inner), 512) + np.tile(
        np.arange(512), method._map._inner.sum()
    )
    keys = method._map.grid.keys(voxels) - reference.low
    inside = ((keys >= 1) & (keys < reference.shape - 1)).all(1)
    at = tuple(keys[inside].T)
    for ours, theirs in (
        (method._map.free, reference.free),
        (method._map.revoked, reference.revoked),
    ):
        np.testing.assert_array_equal(read(ours, voxels)[inside], theirs[at])
    first = method._map._first[voxels // 512] + voxels % 512
    np.testing.assert_array_equal(method._map._weight[first][inside], reference.weight[at])
    differs = np.abs(method._map._distance[first][inside] - reference.distance[at]) > 2e-5
    assert (
        differs.sum() <= 3
    )  # voxels on the border of a pixel, which float32 puts on the other side
    np.testing.assert_array_equal(method._map._counts[first][inside] >= 2, reference.count[at] >= 2)


@pytest.fixture(scope="module")
def room_scans():
    return busy_room()


def arriving(method, scans, arrives):
    """For each frame from the arrival on.

    The share of the object's points that is removed, and their reasons.
    """
    of_object = np.hypot(*(scans[arrives].points[:, :2].T - np.float32(0.1))) < 4
    given = [method.label(scan) for scan in scans[arrives:]]
    removed = [each.dynamic[of_object].mean() for each in given]
    return removed, [set(each.reasons[of_object].tolist()) for each in given]


def test_an_arriving_object_is_removed_until_its_voxels_are_revoked():
    scans = waiting(frames=14, arrives=4)
    removed, codes = arriving(run(scans), scans, 4)
    stays = COARSE.revoke_after
    assert min(removed[:stays]) > 0.9
    assert max(removed[stays:]) == 0
    assert codes[stays - 1] <= {FREE, FREE_SMALL, FREE_LARGE, NEVER_FREE, BESIDE}
    assert codes[stays] <= {REVOKED, NEVER_FREE}
    assert REVOKED in codes[stays]


def test_no_voxel_is_ever_free_during_the_first_burn_in():
    first = COARSE.burn_in + 1
    for arrives in (first - 1, first):
        scans = waiting(frames=first + 2, arrives=arrives)
        removed, _ = arriving(run(scans), scans, arrives)
        assert (removed[0] > 0.9) == (arrives == first)


def test_with_clusters_labels_are_those_of_clusters(room_scans):
    plain, decided = run(room_scans), run(room_scans, dataclasses.replace(COARSE, clusters=True))
    codes = reasons(plain, room_scans)
    np.testing.assert_array_equal(codes, reasons(decided, room_scans))
    for method, removed in ((plain, (FREE, FREE_SMALL, FREE_LARGE)), (decided, (FREE, BESIDE))):
        labels = np.concatenate([method.label(scan).dynamic for scan in room_scans])
        np.testing.assert_array_equal(labels, np.isin(codes, removed))


def test_every_reason_occurs():
    scans, found = busy_room(), set()
    for changes in ({}, {"max_range": 5.0, "max_cluster": 30}):
        found |= set(reasons(run(scans, dataclasses.replace(COARSE, **changes)), scans).tolist())
    assert found | {REVOKED, OUT_OF_REACH} == set(
        range(len(REASONS))
    )  # these two have tests of their own


@pytest.mark.plain
@pytest.mark.parametrize(
    "points",
    [
        [],
        [(1.0, 2.0, 3.0)],
        [(0.0, 0.0, 0.0)],
        [(0.0, 0.0, 5.0), (0.0, 0.0, -5.0)],
        pytest.param([(np.nan, 0.0, 0.0), (np.inf, -np.inf, 0.0)], marks=compiled_only),
        [(1e30, 0.0, 0.0), (4000.0, 0.0, 0.0), (1.0, 1.0, 1.0)],
    ],
    ids=["empty", "one", "at the sensor", "overhead", "not finite", "beyond reach"],
)
def test_odd_scans_are_kept(points):
    points = np.array(points, np.float32).reshape(-1, 3)
    scans = [Scan(k, points, np.eye(4)) for k in range(4)]
    valid = np.isfinite(points).all(1) & (np.abs(points) < 1e5).all(1)
    method = run(
        scans,
        DynabloxParams(burn_in=1, temporal_buffer=1),
        extent=Extent.of(Scan(0, points[valid], np.eye(4))),
    )
    given = [method.label(scan) for scan in scans]
    assert not any(each.dynamic.any() for each in given)
    r = np.linalg.norm(points.astype(float), axis=1)
    within = (r >= 0.3) & np.isfinite(r)
    expected = np.where(
        within, np.where((np.abs(points) < 3276.8).all(1), NEVER_FREE, OUT_OF_REACH), OUT_OF_RANGE
    )
    np.testing.assert_array_equal(given[-1].reasons, expected)


@pytest.mark.plain
def test_an_empty_scan_does_not_discard_the_map(room_scans):
    empty = Scan(99, np.empty((0, 3), np.float32), np.eye(4))
    method = run([*room_scans[:8], empty, *room_scans[8:]], extent=Extent.of(*room_scans))
    assert method.label(room_scans[8]).dynamic.any()
    assert len(method.label(empty).dynamic) == 0


def test_points_outside_the_extent_are_kept_unjudged():
    scan = Scan(0, np.array([(1.0, 0, 0), (50.0, 0, 0), (1.7, 0, 0)], np.float32), np.eye(4))
    method = run(
        [scan],
        DynabloxParams(),
        extent=Extent.of(dataclasses.replace(scan, points=scan.points[:1])),
    )
    assert method.label(scan).reasons.tolist() == [NEVER_FREE, OUT_OF_REACH, OUT_OF_REACH]


def test_labels_do_not_depend_on_threads_or_the_probe(room_scans):
    try:
        kernels.set_threads(1)
        alone = run(room_scans)
        kernels.set_threads(None)
        together = run(room_scans, probe=MemoryProbe())
    finally:
        kernels.set_threads(None)
    np.testing.assert_array_equal(alone._map._distance, together._map._distance)
    np.testing.assert_array_equal(alone._map.free, together._map.free)
    np.testing.assert_array_equal(reasons(alone, room_scans), reasons(together, room_scans))


def test_labels_do_not_depend_on_the_extent(room_scans):
    more = Scan(
        0, np.random.default_rng(0).uniform(-30, 30, (3000, 3)).astype(np.float32), np.eye(4)
    )
    narrow, wide = run(room_scans), run(room_scans, extent=Extent.of(*room_scans, more))
    np.testing.assert_array_equal(reasons(narrow, room_scans), reasons(wide, room_scans))


def test_online_and_offline_labels_are_equal_and_begin_discards_the_map(room_scans):
    method = run(room_scans)
    later = [method.label(scan).dynamic for scan in room_scans]
    method.begin(Context(Extent.of(*room_scans), SENSOR))
    for scan, expected in zip(room_scans, later, strict=True):
        method.observe(scan)
        np.testing.assert_array_equal(method.label(scan).dynamic, expected)


def test_states_are_those_declared_and_match_the_map(room_scans):
    probe = MemoryProbe()
    method = run(room_scans, dataclasses.replace(COARSE, revoke_after=2), probe=probe)
    assert {name: {type(v) for v in values} for name, values in probe.values.items()} == {
        state.name: {state.kind} for state in method.info.emits
    }
    assert all(len(values) == len(room_scans) for values in probe.values.values())
    gained, lost = (
        sum(len(v.keys) for v in probe.values[name]) for name in ("became_free", "revoked")
    )
    free = np.bitwise_count(method._map.free).sum()
    assert gained - lost == free == probe.values["free_voxels"][-1].value > 0
    for scan, intruded, clusters in zip(
        room_scans, probe.values["intruded"], probe.values["clusters"], strict=True
    ):
        codes = method.label(scan).reasons
        flagged = (codes >= FREE) & (codes <= FREE_LARGE)
        assert intruded.values.sum() == flagged.sum() == np.isin(clusters.classes, (1, 3, 4)).sum()
        keys = {
            tuple(k) for k in np.floor(scan.points[flagged] / np.float32(0.4)).astype(int).tolist()
        }
        assert keys == {tuple(k) for k in intruded.keys.tolist()}


def test_four_bits_per_point_are_stored(room_scans):
    method = run(room_scans)
    assert sum(kept.nbytes for kept in method._reasons.values()) == sum(
        (len(s) + 1) // 2 for s in room_scans
    )


def test_the_view_is_that_of_the_sensor_by_default():
    vlp16 = load_sensor("vlp16")
    assert view_of(DynabloxParams(), vlp16) == SensorView(16, 2048, 15.0, -15.0)
    assert view_of(DynabloxParams(image_rows=64, field_of_view=33.0), Sensor()) == SensorView(
        64, 2048, 16.5, -16.5
    )
    with pytest.raises(UsageError, match="image_rows"):
        view_of(DynabloxParams(), Sensor())
    assert view_of(DynabloxParams(), load_sensor("mid360")) == SensorView(
        57, 349, 52.0, -7.0
    )  # 19 893 pixels, 20 000 points


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("resolution", 0.0),
        ("truncation", float("nan")),
        ("min_range", -1.0),
        ("max_range", 0.2),
        ("image_rows", 1),
        ("image_columns", 0),
        ("image_rows", 10_000),
        ("field_of_view", 180.0),
        ("occupied_distance", 0.5),
        ("temporal_buffer", 6),
        ("revoke_after", 0),
        ("revoke_after", 65535),
        ("max_cluster", 19),
        ("cluster_distance", 0.001),
    ],
)
def test_invalid_parameters_are_rejected(name, value):
    with pytest.raises(ValueError, match=name):
        DynabloxParams(**{name: value})
