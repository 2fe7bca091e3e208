from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers.marks import compiled_only
from helpers.reference.octomap import Reference, key

from dynaviz import kernels
from dynaviz.blocks.blocks import VOXELS
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.probe import SILENT, Mask, MemoryProbe, Plane, Voxels
from dynaviz.contracts.scan import Scan
from dynaviz_methods.octomap.method import OctoMap, OctoMapG, OctoMapGF, OctoMapParams

pytestmark = pytest.mark.boundscheck

FAMILY = [OctoMap, OctoMapG, OctoMapGF]


def scan(index: int, points, origins) -> Scan:
    origins = np.atleast_2d(np.asarray(origins, float))
    T_world_sensor = np.eye(4)
    T_world_sensor[:3, 3] = origins[0]
    return Scan(
        index, np.asarray(points, np.float32).reshape(-1, 3), T_world_sensor, origins=origins
    )


def scattered(seed: int, resolution: float) -> list[Scan]:
    """A few points in a small space, so that rays often cross voxels of other points.

    Some rays along the axes.
    """
    random = np.random.default_rng(seed)
    scans = []
    for index in range(4):
        points = random.uniform(-2.5, 2.5, (60, 3)) * (1, 1, 0.4)
        origin = random.uniform(-1, 1, 3) if index % 2 else random.integers(-3, 3, 3) * resolution
        points[:20, index % 3] = origin[index % 3]
        points[10:20, (index + 1) % 3] = origin[(index + 1) % 3]
        scans.append(scan(index, points, origin))
    return scans


def ground_and_walls(frames: int = 4, seed: int = 0) -> list[Scan]:
    """An uneven floor, a wall, a moving box, and stray points."""
    random = np.random.default_rng(seed)
    scans = []
    for index in range(frames):
        floor = random.uniform((-8, -8, -0.02), (8, 8, 0.02), (1500, 3))
        wall = random.uniform((7, -8, 0), (7.05, 8, 3), (500, 3))
        box = random.uniform((0, 2, 0.2), (0.5, 2.5, 1.5), (200, 3)) + np.array([1.5 * index, 0, 0])
        strays = random.uniform((-8, -8, 0.5), (8, 8, 6), (60, 3))
        scans.append(
            scan(3 * index + 1, np.concatenate([floor, wall, box, strays]), (0.1 * index, 0, 1.7))
        )
    return scans


def run(method, scans, seed=0, probe=SILENT, params=None, extent=None):
    method = method(params or method.Params())
    method.begin(Context(extent or Extent.of(*scans), seed=seed, probe=probe))
    for s in scans:
        method.observe(s)
    return method


def labels(method, scans):
    return np.concatenate([method.label(s).dynamic for s in scans])


@pytest.mark.parametrize("resolution", [0.1, 0.2, 0.25, 0.3, 0.37])
@pytest.mark.parametrize("seed", range(3))
def test_voxels_and_labels_match_the_reference(resolution, seed):
    scans = scattered(seed, resolution)
    method = run(OctoMap, scans, params=OctoMapParams(resolution=resolution))
    reference = Reference(resolution)
    for s in scans:
        reference.observe(s)
    voxels = np.arange(len(method._grid) * VOXELS)
    expected = np.array(
        [reference.log_odds.get(tuple(k), 0) for k in method._grid.keys(voxels).tolist()],
        np.float32,
    )
    np.testing.assert_array_equal(method._log_odds[:-1].ravel(), expected)
    for s in scans:
        given = method.label(s)
        np.testing.assert_array_equal(given.dynamic, reference.label(s))
        crossed = np.array([key(p, resolution) in reference.ever_crossed for p in s.points])
        np.testing.assert_array_equal(
            given.reasons, np.where(given.dynamic, 1, np.where(crossed, 0, 2))
        )
    assert labels(method, scans).any()


def test_each_point_may_have_its_own_origin():
    random = np.random.default_rng(5)
    points = random.uniform(-2, 2, (80, 3)).astype(np.float32)
    origins = np.repeat([[0.0, 0, 0], [0.5, -0.5, 0.2]], 40, axis=0)
    scans = [scan(0, points, origins), scan(1, points[::-1].copy(), origins)]
    method, reference = run(OctoMap, scans), Reference(0.1)
    for s in scans:
        reference.observe(s)
    np.testing.assert_array_equal(
        labels(method, scans), np.concatenate([reference.label(s) for s in scans])
    )


@pytest.mark.plain
def test_log_odds_count_and_clamp():
    far, near = [(2.05, 0.05, 0.05)], [(1.05, 0.05, 0.05)]
    hits = [scan(k, near, (0.05, 0.05, 0.05)) for k in range(10)]
    misses = [scan(10 + k, far, (0.05, 0.05, 0.05)) for k in range(20)]
    for n, expected in ((8, 3.4761 - 8 * 0.405465), (9, 3.4761 - 9 * 0.405465), (20, -1.99243)):
        method = run(OctoMap, hits + misses[:n], extent=Extent.of(*hits, *misses))
        assert method._log_odds.ravel()[method._grid.locate(hits[0].points)] == pytest.approx(
            expected, abs=1e-3
        )
        assert method.label(hits[0]).dynamic.tolist() == [expected < 0]


def test_a_voxel_crossed_and_hit_by_one_scan_gets_both_updates():
    both = scan(0, [(1.02, 0.05, 0.05), (2.05, 0.05, 0.05)], (0.05, 0.05, 0.05))
    method = run(OctoMap, [both])
    assert method._log_odds.ravel()[method._grid.locate(both.points)] == pytest.approx(
        [0.441833, 0.847298], abs=1e-5
    )
    assert method.label(both).reasons.tolist() == [0, 2]


@pytest.mark.plain
@pytest.mark.parametrize("method", FAMILY)
@pytest.mark.parametrize(
    "points",
    [
        [],
        [(1.0, 2.0, 3.0)],
        [(0.0, 0.0, 0.0)],
        pytest.param([(np.nan, 0.0, 0.0), (np.inf, -np.inf, 0.0)], marks=compiled_only),
        [(1e30, 0.0, 0.0), (4000.0, 0.0, 0.0), (1.0, 1.0, 1.0)],
    ],
    ids=["empty", "one", "at the sensor", "not finite", "beyond reach"],
)
def test_odd_scans_are_kept(method, points):
    points = np.array(points, np.float32).reshape(-1, 3)
    s = scan(0, points, (0.0, 0.0, 0.0))
    # The extent of the valid points, as the runner computes it.
    extent = Extent.of(
        scan(0, points[np.isfinite(points).all(1) & (np.abs(points) < 1e5).all(1)], (0.0, 0.0, 0.0))
    )
    ran = run(method, [s], extent=extent)
    given = ran.label(s)
    assert not given.dynamic.any()
    names = [ran.info.reasons[code].name for code in given.reasons]
    judged = (np.abs(points) < 3276.8).all(1)
    assert [name == "out_of_reach" for name in names] == (~judged).tolist()


def test_a_sensor_beyond_reach_casts_no_rays_but_its_points_hit():
    s = scan(0, [(3276.0, 0.0, 0.0), (3270.0, 0.0, 0.0)], (3300.0, 0.0, 0.0))
    method = run(OctoMap, [s])
    assert [method.info.reasons[code].name for code in method.label(s).reasons] == [
        "never_crossed"
    ] * 2


def test_points_outside_the_extent_are_kept_unjudged():
    s = scan(0, [(1.0, 0, 0), (50.0, 0, 0)], (0.0, 0, 0))
    method = run(OctoMap, [s], extent=Extent.of(scan(0, s.points[:1], (0.0, 0, 0))))
    assert method.label(s).reasons.tolist() == [2, 3]


@pytest.mark.parametrize("method", FAMILY)
def test_labels_do_not_depend_on_threads_or_the_probe(method):
    scans = ground_and_walls()
    try:
        kernels.set_threads(1)
        alone = run(method, scans)
        answers = labels(alone, scans)
        kernels.set_threads(None)
        together = run(method, scans, probe=MemoryProbe())
        np.testing.assert_array_equal(alone._log_odds, together._log_odds)
        np.testing.assert_array_equal(answers, labels(together, scans))
    finally:
        kernels.set_threads(None)
    assert answers.any()
    assert not answers.all()


def test_labels_do_not_depend_on_the_extent():
    scans = ground_and_walls()
    wide = Extent.of(
        *scans, scan(9, np.random.default_rng(0).uniform(-30, 30, (3000, 3)), (0.0, 0, 0))
    )
    narrow, large = run(OctoMap, scans), run(OctoMap, scans, extent=wide)
    np.testing.assert_array_equal(labels(narrow, scans), labels(large, scans))
    assert len(large._grid) > len(narrow._grid)


def test_begin_discards_an_earlier_sequence():
    scans = ground_and_walls()
    method = run(OctoMapGF, scans)
    first = labels(method, scans)
    method.begin(Context(Extent.of(*scans)))
    for s in scans:
        method.observe(s)
    np.testing.assert_array_equal(first, labels(method, scans))


def test_ground_is_kept_and_does_not_mark_its_voxels_occupied():
    scans = ground_and_walls()
    floor = slice(0, 1500)
    plain, with_ground = run(OctoMap, scans), run(OctoMapG, scans)
    assert (
        sum(plain.label(s).dynamic[floor].sum() for s in scans)
        > sum(with_ground.label(s).dynamic[floor].sum() for s in scans)
        == 0
    )
    codes = with_ground.label(scans[0]).reasons
    assert (codes[floor] == 4).all()
    ground_alone = with_ground._grid.locate(
        scans[0].points[floor][np.abs(scans[0].points[floor, 0] + 4) < 2]
    )
    assert (with_ground._log_odds.ravel()[ground_alone] <= 0).all()


def test_rays_to_the_ground_are_optional():
    below = [(x, 0.0, 0.0) for x in np.linspace(2, 4, 30)]
    below += [(x, y, 0.0) for x in (2, 4) for y in np.linspace(1, 2, 20)]
    between = [(1.5, 0.0, 0.5)]  # on the way from the sensor to (3, 0, 0)
    scans = [scan(0, below + between, (0.0, 0.0, 1.0))] + [
        scan(k, below, (0.0, 0.0, 1.0)) for k in range(1, 6)
    ]
    cast = run(OctoMapG, scans)
    uncast = run(OctoMapG, scans, params=OctoMapG.Params(cast_ground_rays=False))
    assert cast.label(scans[0]).dynamic[-1]
    assert not uncast.label(scans[0]).dynamic[-1]


def test_noise_marks_its_voxel_but_casts_no_ray():
    random = np.random.default_rng(0)
    crowd = random.normal((4, 0, 0), 0.05, (300, 3))
    stray = [(8.0, 0.0, 0.0)]  # its ray would cross the crowd
    scans = [scan(k, np.concatenate([crowd, stray]), (0.0, 0.0, 0.0)) for k in range(3)]
    method = run(OctoMapGF, scans)
    voxel = method._grid.locate(scans[0].points)
    assert method._log_odds.ravel()[voxel[-1]] == pytest.approx(3 * 0.847298, abs=1e-5)
    assert method.label(scans[0]).reasons[-1] == 5
    behind = method._grid.locate(np.array([(7.95, 0.0, 0.0)], np.float32))
    assert method._log_odds.ravel()[behind] == 0


def test_the_same_seed_gives_the_same_labels():
    step = np.float32(0.15)  # in the floor, so that no plane contains all of it
    scans = [
        dataclasses.replace(s, points=s.points + step * (s.points[:, :1] > 2))
        for s in ground_and_walls()
    ]
    answers = [labels(run(OctoMapG, scans, seed=seed), scans) for seed in (1, 1, 2, 3, 4)]
    np.testing.assert_array_equal(answers[0], answers[1])
    assert any((answers[0] != other).any() for other in answers[2:])


@pytest.mark.parametrize("method", FAMILY)
def test_states_are_those_declared_and_match_the_map(method):
    scans, probe = ground_and_walls(), MemoryProbe()
    ran = run(method, scans, probe=probe)
    kinds = {state.name: state.kind for state in method.info.emits}
    emitted = {name: {type(value) for value in values} for name, values in probe.values.items()}
    assert emitted == {name: {kind} for name, kind in kinds.items()}
    assert all(len(values) == len(scans) for values in probe.values.values())
    last = probe.values["log_odds"][-1]
    centres = ((last.keys + 0.5) * last.size).astype(np.float32)
    np.testing.assert_array_equal(ran._log_odds.ravel()[ran._grid.locate(centres)], last.values)
    parts = {tuple(k) for name in ("crossed", "hit") for k in probe.values[name][-1].keys.tolist()}
    assert parts == {tuple(k) for k in last.keys.tolist()}
    hit = {tuple(k) for k in probe.values["hit"][-1].keys.tolist()}
    marking = (
        scans[-1].points[~probe.values["ground"][-1].chosen]
        if "ground" in probe.values
        else scans[-1].points
    )
    assert hit == {key(p, 0.1) for p in marking}
    assert {Voxels} <= set(kinds.values()) <= {Voxels, Mask, Plane}


@pytest.mark.parametrize(
    ("params", "values"),
    [
        (OctoMap.Params, {"resolution": 0.0}),
        (OctoMap.Params, {"prob_hit": 1.0}),
        (OctoMap.Params, {"resolution": float("inf")}),
        (OctoMap.Params, {"clamp_min": float("nan")}),
        (OctoMapG.Params, {"ground_distance": -0.1}),
        (OctoMapGF.Params, {"noise_neighbours": 0}),
    ],
)
def test_invalid_parameters_are_rejected(params, values):
    with pytest.raises(ValueError, match=next(iter(values))):
        params(**values)


def test_parameter_counts_match_the_paper():
    assert [len(dataclasses.fields(method.Params)) for method in FAMILY] == [5, 8, 10]
