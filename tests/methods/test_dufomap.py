from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers.marks import compiled_only
from helpers.reference.dufomap import Reference, key

from dynaviz import kernels
from dynaviz.blocks.blocks import VOXELS
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.probe import SILENT, MemoryProbe, Voxels
from dynaviz.contracts.scan import Scan
from dynaviz_methods.dufomap.method import DufoMap, DufoMapParams

pytestmark = pytest.mark.boundscheck


def scan(index: int, points, origins=(0.0, 0.0, 0.0)) -> Scan:
    origins = np.atleast_2d(np.asarray(origins, float))
    T_world_sensor = np.eye(4)
    T_world_sensor[:3, 3] = origins[0]
    return Scan(
        index, np.asarray(points, np.float32).reshape(-1, 3), T_world_sensor, origins=origins
    )


def box(centre, half, count: int, random) -> np.ndarray:
    """Points on the faces of a box."""
    points = random.uniform(-1, 1, (count, 3))
    axis = random.integers(0, 3, count)
    points[np.arange(count), axis] = np.sign(points[np.arange(count), axis])
    return points * half + centre


def room(seed: int, resolution: float = 0.1, rays: int = 2600) -> list[Scan]:
    """A small room around a moving sensor, dense enough to be void, and a box that appears in one
    scan.
    """
    random, unit, scans = np.random.default_rng(seed), resolution / 0.1, []
    for index in range(3):
        walls = box((0, 0, 0), np.array([0.9, 0.7, 0.5]) * unit, rays, random)
        thing = box((0.45, -0.3, 0), np.array([0.08, 0.08, 0.1]) * unit, 40, random) * (index == 1)
        strays = random.uniform(-1.2, 1.2, (10, 3)) * unit
        # The first origin is on a face of a voxel, but not on an edge, where rounding decides.
        origin = (
            random.uniform(-0.2, 0.2, 3) * unit if index else np.array([0.0, 0.037, 0.052]) * unit
        )
        scans.append(scan(index, np.concatenate([walls, thing * unit, strays]), origin))
    return scans


def begin(scans, probe=SILENT, extent=None, **values) -> DufoMap:
    method = DufoMap(DufoMapParams(**values))
    method.begin(Context(extent or Extent.of(*scans), probe=probe))
    return method


def run(scans, **values) -> DufoMap:
    method = begin(scans, **values)
    for s in scans:
        method.observe(s)
    return method


def labels(method, scans) -> np.ndarray:
    return np.concatenate([method.label(s).dynamic for s in scans])


def names(method, s) -> list[str]:
    return [method.info.reasons[code].name for code in method.label(s).reasons]


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"unknown_margin": 0},
        {"max_range": 0.8},
        {"hit_margin": 0.0, "unknown_margin": 3},
        {"resolution": 0.15, "hit_margin": 0.5},
        {"resolution": 0.25, "unknown_margin": 9},
    ],
    ids=str,
)
def test_voxels_and_labels_match_the_reference(values):
    scans = room(1, values.get("resolution", 0.1), 600 if "resolution" in values else 2600)
    method, reference = begin(scans, **values), Reference(**values)
    for s in scans:
        method.observe(s)
        reference.observe(s)
        np.testing.assert_array_equal(method.label(s).dynamic, reference.label(s))  # online
    keys = [tuple(k) for k in method._grid.keys(np.arange(len(method._grid) * VOXELS)).tolist()]
    for bits, voxels in (
        (method._seen_free, reference.seen_free),
        (method._crossed, reference.crossed),
    ):
        marked = np.unpackbits(bits[:-1].view(np.uint8), bitorder="little")
        np.testing.assert_array_equal(marked, [k in voxels for k in keys])
    resolution = method.params.resolution
    for s in scans:
        dynamic, given = reference.label(s), method.label(s)
        np.testing.assert_array_equal(given.dynamic, dynamic)
        crossed = [key(p, resolution) in reference.crossed for p in s.points]
        r = np.linalg.norm(s.points - s.origins, axis=1)
        out = (r <= reference.min_range) | (r >= reference.max_range)
        reasons = np.where(dynamic, 0, np.where(out, 3, np.where(crossed, 1, 2)))
        np.testing.assert_array_equal(given.reasons, reasons)
    assert reference.seen_free or values["unknown_margin"] == 9


def test_each_point_may_have_its_own_origin():
    random = np.random.default_rng(3)
    points = [box((0, 0, 0), (0.7, 0.6, 0.5), 1500, random) for _ in range(2)]
    origins = np.repeat([[0.1, 0, 0], [-0.1, 0.2, 0.1]], 1500, axis=0)
    scans = [
        scan(0, np.concatenate(points), origins),
        scan(1, random.uniform(-0.6, 0.6, (50, 3)), (3.0, 0, 0)),
    ]
    method, reference = run(scans), Reference()
    for s in scans:
        reference.observe(s)
    np.testing.assert_array_equal(
        labels(method, scans), np.concatenate([reference.label(s) for s in scans])
    )
    assert labels(method, scans).any()


def test_void_voxels_stay_void_in_any_order_of_scans():
    scans = room(2)
    forward, backward = run(scans), run(scans[::-1])
    np.testing.assert_array_equal(labels(forward, scans), labels(backward, scans))
    # before any scan sees through its voxels
    online, box_first = (
        begin(scans),
        [scans[1], scans[0], scans[2]],
    )
    answers = []
    for s in box_first:
        online.observe(s)
        answers.append(online.label(s).dynamic)
    offline = labels(forward, box_first)
    assert (np.concatenate(answers) <= offline).all()
    assert np.concatenate(answers).sum() < offline.sum()


@pytest.mark.plain
@pytest.mark.parametrize(
    "values", [{}, {"min_range": 0.0}, {"min_range": 0.0, "resolution": 1.0}], ids=str
)
@pytest.mark.parametrize(
    "points",
    [
        [],
        [(1.0, 2.0, 3.0)],
        [(0.0, 0.0, 0.0)],
        [(0.05, 0.05, 0.05), (0.5, 0.5, 0.5)],
        pytest.param([(np.nan, 0.0, 0.0), (np.inf, -np.inf, 0.0)], marks=compiled_only),
        [(1e30, 0.0, 0.0), (4000.0, 0.0, 0.0), (1.0, 1.0, 1.0)],
    ],
    ids=["empty", "one", "at the sensor", "on the sensor's voxel", "not finite", "beyond reach"],
)
@pytest.mark.parametrize(
    "origin", [(0.0, 0.0, 0.0), (0.05, 0.05, 0.05), (0.5, 0.5, 0.5), (1e5, 0.0, 0.0)]
)
def test_odd_scans_are_kept(points, origin, values):
    points = np.array(points, np.float32).reshape(-1, 3)
    s = scan(0, points, origin)
    # The extent of the valid points, as the runner computes it.
    extent = Extent.of(
        scan(0, points[np.isfinite(points).all(1) & (np.abs(points) < 1e5).all(1)], origin)
    )
    ran = run([s], extent=extent, **values)
    assert not ran.label(s).dynamic.any()
    judged = (np.abs(points) < 3276.8 * values.get("resolution", 0.1) / 0.1).all(1)
    assert [name == "out_of_reach" for name in names(ran, s)] == (~judged).tolist()


def test_a_point_at_the_sensor_blocks_all_rays_unless_below_min_range():
    walls, thing = room(0)[0].points, (0.45, -0.3, 0.0)
    scans = [scan(0, np.concatenate([walls, [(0.0, 0.0, 0.01)]])), scan(1, [thing])]
    assert run(scans).label(scans[1]).dynamic.all()
    assert names(run(scans), scans[0])[-1] == "void_seen"
    shut = run(scans, min_range=0.0)
    assert not shut.label(scans[1]).dynamic.any()
    assert names(shut, scans[1]) == ["never_crossed"]


def test_points_out_of_range_are_judged_but_not_integrated():
    walls, far = room(0)[0].points, (30.0, 0.0, 0.0)
    s = scan(0, np.concatenate([walls, [far, (0.1, 0.0, 0.0)]]))
    ran = run([s], max_range=20.0)
    assert names(ran, s)[-2:] == ["out_of_range", "void_seen"]


def test_points_outside_the_extent_are_kept_unjudged():
    s = scan(0, [(1.0, 0, 0), (50.0, 0, 0)])
    ran = run([s], extent=Extent.of(scan(0, s.points[:1])))
    assert names(ran, s) == ["never_crossed", "out_of_reach"]


def test_labels_do_not_depend_on_threads_the_probe_or_the_extent():
    scans = [*room(4), scan(9, [(40.0, 3, 2), (-20.0, 7.0, 0.5)])]
    wide = Extent.of(*scans, scan(9, np.random.default_rng(0).uniform(-8, 8, (3000, 3))))
    try:
        kernels.set_threads(1)
        alone = labels(run(scans), scans)
        kernels.set_threads(None)
        np.testing.assert_array_equal(alone, labels(run(scans, probe=MemoryProbe()), scans))
        np.testing.assert_array_equal(alone, labels(run(scans, extent=wide), scans))
    finally:
        kernels.set_threads(None)
    assert alone.any()
    assert not alone.all()


def test_begin_discards_an_earlier_sequence():
    scans = room(5)
    method = run(scans)
    first = labels(method, scans)
    method.begin(Context(Extent.of(*scans)))
    assert not labels(method, scans).any()
    for s in scans:
        method.observe(s)
    np.testing.assert_array_equal(first, labels(method, scans))


def test_states_are_those_declared_and_match_the_reference():
    scans, probe, reference = room(6), MemoryProbe(), Reference()
    run(scans, probe=probe)
    assert set(probe.values) == {state.name for state in DufoMap.info.emits}
    with_points = set()
    for frame, s in enumerate(scans):
        reference.observe(s)
        with_points |= {key(p, 0.1) for p in s.points}
        shown = {name: values[frame] for name, values in probe.values.items()}
        assert {(type(value), value.size) for value in shown.values()} == {(Voxels, 0.1)}
        sets = {name: {tuple(k) for k in value.keys.tolist()} for name, value in shown.items()}
        assert sets["observed"] == (reference.observed - reference.hit) & with_points
        assert sets["void"] == reference.void & with_points
        assert sets["hit"] >= reference.hit & reference.observed
        assert sets["hit"] <= reference.hit
        assert sets["void"] <= sets["seen_free"] <= reference.seen_free & with_points
    assert sets["void"]


@pytest.mark.parametrize(
    "values",
    [
        {"resolution": 0.0},
        {"hit_margin": -0.1},
        {"hit_margin": float("nan")},
        {"unknown_margin": -1},
        {"min_range": float("inf")},
        {"max_range": 0.1},
        {"max_range": float("inf")},
    ],
    ids=str,
)
def test_invalid_parameters_are_rejected(values):
    with pytest.raises(ValueError, match=next(iter(values))):
        DufoMapParams(**values)


def test_there_are_three_parameters_of_the_paper_and_two_range_limits():
    assert len(dataclasses.fields(DufoMapParams)) == 5
