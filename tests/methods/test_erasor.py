from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers.marks import compiled_only
from helpers.reference.erasor import Reference
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from dynaviz import kernels
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.probe import SILENT, MemoryProbe
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.errors import UsageError
from dynaviz_methods.erasor.method import REASONS, Erasor, ErasorParams
from dynaviz_methods.shared import tiles
from dynaviz_methods.shared.tiles import laid_out, thinned

pytestmark = pytest.mark.boundscheck

HEIGHT = 1.5
SMALL = ErasorParams(max_range=12.0, rings=5, sectors=24, removal_interval=2)


def scan(index: int, points, position=(0.0, 0.0, HEIGHT)) -> Scan:
    T_world_sensor = np.eye(4)
    T_world_sensor[:3, 3] = position
    return Scan(index, np.asarray(points, np.float32).reshape(-1, 3), T_world_sensor)


def street(frames: int = 6, seed: int = 0, at=(37.0, -12.0, 3.0)) -> list[Scan]:
    """Far from the origin: a sloping floor, a kerb, a wall, stray points, and a moving box."""
    random = np.random.default_rng(seed)
    scans = []
    for frame in range(frames):
        floor = random.uniform((-14, -14, -0.02), (14, 14, 0.02), (5000, 3))
        floor[:, 2] += 0.03 * floor[:, 0] + 0.3 * (floor[:, 1] < -4)
        wall = random.uniform((-14, 9.0, 0), (14, 9.1, 4), (1500, 3))
        corner = np.array([-6 + 2.0 * frame, 2.0, 0.1])
        box = random.uniform(corner, np.add(corner, (1.5, 1.0, 1.6)), (500, 3))
        strays = random.uniform((-14, -14, -2), (14, 14, 5), (40, 3))
        points = np.concatenate([floor, wall, box, strays]) + at
        scans.append(scan(7 * frame, points, np.add(at, (0.3 * frame, 0.1, HEIGHT))))
    return scans


def run(scans, params=SMALL, probe=SILENT, sensor=None):
    method = Erasor(params)
    raw_map = np.concatenate([s.points for s in scans])
    sensor = sensor or Sensor(height=HEIGHT)
    method.begin(Context(Extent.of(*scans), sensor=sensor, probe=probe, raw_map=raw_map))
    for s in scans:
        method.observe(s)
    return method


def labels(method, scans):
    return np.concatenate([method.label(s).dynamic for s in scans])


def names(method, s):
    return [REASONS[code].name for code in method.label(s).reasons]


VARIANTS = [
    {},
    {"map_voxel": 0.25, "query_voxel": 0.4, "removal_interval": 1},
    {"scan_ratio": 0.5, "min_difference": 0.3, "min_points": 20},
    {
        "rings": 3,
        "sectors": 7,
        "max_range": 6.0,
        "ground_distance": 0.05,
        "ground_iterations": 1,
        "ground_skip": 0,
    },
    {
        "min_height": -0.2,
        "max_height": 1.0,
        "ground_lowest": 3,
        "ground_seed": 0.1,
        "ground_skip": 40,
    },
]


@pytest.mark.parametrize(
    "variant", [0, 1, 2, *(pytest.param(k, marks=pytest.mark.slow) for k in (3, 4))]
)
def test_reasons_match_the_reference(variant):
    scans, params = street(seed=variant), dataclasses.replace(SMALL, **VARIANTS[variant])
    method = run(scans, params)
    reference = Reference(params, np.concatenate([s.points for s in scans]), HEIGHT)
    for s in scans:
        reference.observe(s)
    expected = [reason for s in scans for reason in reference.names(s)]
    assert [reason for s in scans for reason in names(method, s)] == expected
    np.testing.assert_array_equal(
        labels(method, scans), [reason == "bin_ratio" for reason in expected]
    )
    assert {"bin_ratio", "ground_of_flagged_bin", "map_not_higher"} <= set(expected)


@pytest.mark.plain
def test_the_box_is_removed_and_the_rest_is_kept():
    scans = street()
    dynamic = labels(run(scans), scans).reshape(len(scans), -1)
    assert dynamic[:, 6500:7000].mean() > 0.8
    assert dynamic[:, :5000].mean() < 0.01
    assert not dynamic[:, 5000:6500].any()


def test_a_shift_of_the_world_changes_few_labels():
    here, there = street(at=(0.0, 0.0, 0.0)), street(at=(512.0, -1024.0, 64.0))
    assert (labels(run(here), here) == labels(run(there), there)).mean() > 0.99


def test_without_voxels_every_point_is_judged_individually():
    scans = street(4)
    doubled = [dataclasses.replace(s, points=np.repeat(s.points, 2, axis=0)) for s in scans]
    params = dataclasses.replace(SMALL, map_voxel=0.0, query_voxel=0.0)
    once = dataclasses.replace(params, ground_skip=3, ground_lowest=10, min_points=5)
    twice = dataclasses.replace(params, ground_skip=6, ground_lowest=20, min_points=10)
    answer = labels(run(scans, once), scans)
    assert 0 < answer.sum() < len(answer)
    np.testing.assert_array_equal(labels(run(doubled, twice), doubled), np.repeat(answer, 2))


def test_removal_is_final_and_online_labels_only_grow():
    scans = street()
    method = run(scans)
    final = [method.label(s).dynamic for s in scans]
    method.begin(
        Context(
            Extent.of(*scans),
            Sensor(height=HEIGHT),
            raw_map=np.concatenate([s.points for s in scans]),
        )
    )
    method.observe(scans[0])
    before = method.label(scans[0]).dynamic
    assert not before.any()
    for s in scans[1:]:
        method.observe(s)
        now = method.label(scans[0]).dynamic
        assert (now >= before).all()
        before = now
    assert before.any()
    for s, answer in zip(scans, final, strict=True):
        np.testing.assert_array_equal(method.label(s).dynamic, answer)


@pytest.mark.parametrize("port", [False, True])
def test_labels_do_not_depend_on_threads_tiles_or_the_probe(port, monkeypatch):
    scans, params = street(), dataclasses.replace(SMALL, port=port)
    answer = labels(run(scans, params), scans)
    monkeypatch.setattr(tiles, "TILE", 1.3)
    try:
        kernels.set_threads(1)
        again = run(scans, params, probe=MemoryProbe())
        np.testing.assert_array_equal(labels(again, scans), answer)
    finally:
        kernels.set_threads(None)
    assert answer.any()


def test_the_port_labels_by_distance_to_the_remaining_map():
    scans, probe = street(), MemoryProbe()
    method = run(scans, dataclasses.replace(SMALL, port=True), probe)
    nearest = cKDTree(method.cleaned_map()).query(np.concatenate([s.points for s in scans]))[0]
    np.testing.assert_array_equal(labels(method, scans), nearest > 0.05)
    for s in scans:
        removed = {"bin_ratio", "far_from_map"}
        assert [name in removed for name in names(method, s)] == method.label(s).dynamic.tolist()
    raw, _ = thinned(np.concatenate([s.points for s in scans]), 0.1)
    inserted = cKDTree(raw).query(method.cleaned_map())[0] > 0
    of_scans = np.concatenate([thinned(s.points, 0.1)[0] for s in scans[1::2]])
    assert inserted.any()
    assert (cKDTree(of_scans).query(method.cleaned_map()[inserted])[0] == 0).all()


def test_states_are_those_declared_and_are_consistent():
    scans, probe = street(), MemoryProbe()
    method = run(scans, probe=probe)
    emitted = {name: {type(value) for value in values} for name, values in probe.values.items()}
    assert emitted == {state.name: {state.kind} for state in Erasor.info.emits}
    assert {len(values) for values in probe.values.values()} == {3}  # scans that were compared
    before, _ = thinned(np.concatenate([s.points for s in scans]), 0.1)
    removed = np.concatenate([value.xyz for value in probe.values["removed"]])
    assert len(before) == len(method.cleaned_map()) + len(removed)
    assert {tuple(p) for p in before} == {tuple(p) for p in method.cleaned_map()} | {
        tuple(p) for p in removed
    }
    for k in range(3):
        high, low, ratio, status = (
            probe.values[name][k].values
            for name in ("map_height", "scan_height", "ratio", "status")
        )
        assert high.shape == (5, 24)
        flagged = status == 6
        assert ((ratio < 0.2) & (high > 0.5) & (low < high))[flagged].all()
        np.testing.assert_array_equal(np.isnan(status), np.isnan(high))
        foot = scans[2 * k + 1].position
        points = (
            np.concatenate([probe.values[name][k].xyz for name in ("removed", "ground")]) - foot
        )
        ring = np.hypot(points[:, 0], points[:, 1]) // (12 / 5)
        sector = np.degrees(np.arctan2(points[:, 1], points[:, 0])) % 360 // 15
        assert set(zip(ring, sector, strict=True)) == set(zip(*np.nonzero(flagged), strict=True))
        cubes = {tuple(key) for key in np.floor((points + foot) / 0.5).astype(int)}
        assert cubes == {tuple(key) for key in probe.values["flagged"][k].keys.tolist()}


@pytest.mark.plain
@pytest.mark.parametrize(
    "points",
    [
        [],
        [(1.0, 2.0, 0.5)],
        [(0.0, 0.0, HEIGHT)],
        pytest.param([(np.nan, 0.0, 0.0), (np.inf, -np.inf, 0.0)], marks=compiled_only),
        [(1e30, 0.0, 0.0), (4e5, 0.0, 0.0), (1.0, 1.0, 1.0)],
    ],
    ids=["empty", "one", "at the sensor", "not finite", "beyond reach"],
)
@pytest.mark.parametrize("port", [False, True])
def test_odd_scans_are_kept(points, port):
    s = scan(0, points)
    extent = Extent.of(scan(0, [(1.0, 1.0, 1.0)]))
    method = Erasor(dataclasses.replace(SMALL, removal_interval=1, port=port))
    method.begin(Context(extent, Sensor(height=HEIGHT), raw_map=s.points))
    method.observe(s)
    assert not method.label(s).dynamic.any()
    judged = (np.abs(s.points) < 1e5).all(1)
    assert [name == "unjudged" for name in names(method, s)] == (~judged).tolist()


def test_scans_far_from_the_map_do_not_change_it():
    scans = street()
    alone = [s for k, s in enumerate(scans) if k % 2 == 0]
    away = [scan(100 + k, s.points + 500, s.position + 500) for k, s in enumerate(alone)]
    mixed = [s for pair in zip(alone, away, strict=True) for s in pair]
    method = run(mixed)
    assert not any(method.label(s).dynamic.any() for s in alone)
    assert {name for s in alone for name in names(method, s)} == {"beyond_range"}


@pytest.mark.plain
def test_bins_with_few_scan_points_are_not_judged():
    floor = np.array([(x, y, 0.02) for x in np.arange(5.05, 7, 0.2) for y in (0.25, 0.45, 0.65)])
    tower = np.array([(6.0, 0.5, z) for z in np.arange(0.15, 2.5, 0.2)])
    for seen, reason in ((floor[:5], "too_few_points"), (floor[:6], "bin_ratio")):
        scans = [scan(0, np.concatenate([floor, tower])), scan(1, seen)]
        assert names(run(scans), scans[0])[-1] == reason


def test_kerbs_and_bins_of_equal_height_are_kept():
    floor = np.array([(x, y, 0.02) for x in np.arange(5.05, 7, 0.2) for y in (0.25, 0.45, 0.65)])
    for top, seen, reason in (
        (0.4, 0.02, "low_bin"),
        (2.5, 0.02, "bin_ratio"),
        (2.5, 0.9, "map_not_higher"),
    ):
        column = np.array([(6.0, 0.5, z) for z in np.arange(0.15, top, 0.2)])
        scans = [
            scan(0, np.concatenate([floor, column])),
            scan(1, np.concatenate([floor, [(6.0, 0.5, seen)]])),
        ]
        assert names(run(scans), scans[0])[-1] == reason


@pytest.mark.parametrize(
    ("position", "reason"),
    [((9.0, 9.0, 1.0), "beyond_range"), ((5.0, 0.5, 3.5), "outside_height_band")],
)
def test_points_outside_the_bins_have_their_own_reasons(position, reason):
    scans = [scan(0, [position]), scan(1, [(1.0, 1.0, 0.0)])]
    assert names(run(scans), scans[0]) == [reason]


def test_a_sensor_without_height_is_an_error():
    scans = street(2)
    with pytest.raises(UsageError, match=r".sensor_height.: METRES"):
        run(scans, sensor=Sensor())
    given = run(scans, dataclasses.replace(SMALL, sensor_height=HEIGHT), sensor=Sensor(height=9.0))
    np.testing.assert_array_equal(labels(given, scans), labels(run(scans), scans))


def test_begin_discards_an_earlier_sequence():
    first, second = street(seed=1), street(seed=2)
    method = run(first)
    method.begin(
        Context(
            Extent.of(*second),
            Sensor(height=HEIGHT),
            raw_map=np.concatenate([s.points for s in second]),
        )
    )
    for s in second:
        method.observe(s)
    np.testing.assert_array_equal(labels(method, second), labels(run(second), second))


@pytest.mark.parametrize(
    "values",
    [
        {"rings": 0},
        {"removal_interval": 0},
        {"ground_lowest": 0},
        {"ground_skip": -1},
        {"map_voxel": float("nan")},
        {"max_range": 0.0},
        {"min_height": 3.0},
    ],
)
def test_invalid_parameters_are_rejected(values):
    with pytest.raises(ValueError, match=next(iter(values))):
        ErasorParams(**values)


def test_the_number_of_parameters_matches_the_paper():
    assert len(dataclasses.fields(Erasor.Params)) == 18


coordinate = st.floats(-300, 300, width=32)
clouds = st.lists(st.tuples(coordinate, coordinate, coordinate), max_size=40).map(
    lambda rows: np.array(rows, np.float32).reshape(-1, 3)
)


@given(clouds, st.tuples(coordinate, coordinate), st.floats(0.1, 200))
def test_tiles_find_every_point_within_reach(points, centre, reach):
    (laid, rows, where), more = (
        laid_out(points, np.arange(-1, len(points), dtype=np.int32)),
        points[:3] + np.float32(1),
    )
    assert where[0] == -1
    np.testing.assert_array_equal(rows[where[1:]], points)
    laid.append(more)
    rows = np.concatenate([rows, more])
    spans = laid.spans(np.array([*centre, 0.0]), reach)
    found = {row for first, last in spans for row in range(first, last)}
    near = np.hypot(*(rows[:, :2].astype(float) - centre).T) < reach
    assert set(np.flatnonzero(near)) <= found
    assert sum(last - first for first, last in spans) == len(found)


@given(clouds, st.sampled_from([0.1, 0.5, 7.0]))
def test_each_voxel_has_one_centroid_inside_it(points, size):
    centroids, voxels = thinned(points, size)
    assert (voxels >= 0).all()
    for voxel, centroid in enumerate(centroids):
        members = points[voxels == voxel]
        assert len({tuple(key) for key in np.floor(members * np.float32(1 / size)).tolist()}) == 1
        np.testing.assert_allclose(centroid, members.mean(0, dtype=float), atol=1e-4)
    keys = {tuple(key) for key in np.floor(points * np.float32(1 / size)).tolist()}
    assert len(keys) == len(centroids)
