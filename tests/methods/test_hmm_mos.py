from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from helpers.reference.hmm_mos import Reference
from helpers.worlds import pose

from dynaviz import kernels
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.params import resolve
from dynaviz.contracts.probe import SILENT, MemoryProbe
from dynaviz.contracts.scan import Scan
from dynaviz_methods.hmm_mos.method import CLASS, REASONS, HmmMos, HmmMosParams

pytestmark = pytest.mark.boundscheck

NAME = [reason.name for reason in REASONS]
COARSE = {
    "resolution": 0.3,
    "kernel": 3,
    "window": 3,
    "min_score": 1,
    "min_range": 0.8,
    "max_range": 20.0,
}


LOW, HIGH = np.array([-3.0, -3.0, 0.0]), np.array([4.0, 3.0, 3.0])  # of the room


def small_room(frames: int, rays: int, stops: int = 99, seed: int = 0) -> list[Scan]:
    """Rays from a moving sensor to the walls of a room, and to a box that moves 0.7 m a frame until
    it stops.
    """
    random, scans = np.random.default_rng(seed), []
    for frame in range(frames):
        origin = np.array([0.12 * frame - 0.3, -1.5, 1.2])
        direction = random.normal(size=(rays, 3))
        with np.errstate(divide="ignore"):
            wall = np.where(
                direction > 0, (HIGH - origin) / direction, (LOW - origin) / direction
            ).min(1)
            centre = np.array([0.7 * min(frame, stops) - 2.6, 1.0, 1.0])
            near, far = np.sort(
                [(centre - 0.5 - origin) / direction, (centre + 0.5 - origin) / direction], axis=0
            )
        moving = (near.max(1) > 0) & (near.max(1) < far.min(1))
        points = origin + direction * np.where(moving, near.max(1), wall)[:, None]
        scans.append(
            Scan(
                10 + frame, points.astype(np.float32), pose(*origin), labels=moving.astype(np.uint8)
            )
        )
    return scans


@cache
def crossed_room(frames: int = 9) -> list[Scan]:
    """The small room, with points at the sensor, outside the room, and not finite."""
    strays = np.array([[0.0, -1.5, 1.3], [3.2, 9.1, 3.0], [np.nan, 0, 0]], np.float32)
    scans = [scan.without_truth() for scan in small_room(frames, 3000)]
    return [
        dataclasses.replace(scan, points=np.concatenate([scan.points, strays])) for scan in scans
    ]


def begin(scans, probe=SILENT, extent=None, **values) -> HmmMos:
    method = HmmMos(HmmMosParams(**values))
    finite = [dataclasses.replace(s, points=s.points[np.isfinite(s.points).all(1)]) for s in scans]
    method.begin(Context(extent or Extent.of(*finite), probe=probe))
    return method


def run(scans, **values) -> HmmMos:
    method = begin(scans, **values)
    for scan in scans:
        method.observe(scan)
    return method


def reasons(method, scans) -> list[list[str]]:
    return [[NAME[code] for code in method.label(scan).reasons] for scan in scans]


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"port": True, "kernel": 5, "forget_after": 3, "window": 2},
        {"max_range": 2.5, "belief": 0.9, "kernel": 1, "forget_after": 2, "min_score": 60},
    ],
    ids=str,
)
def test_reasons_match_the_reference(values):
    values = COARSE | values
    scans = crossed_room()
    method, reference = begin(scans, **values), Reference(HmmMosParams(**values))
    found = []
    for scan in scans:
        method.observe(scan)
        expected = reference.observe(scan)
        finite = np.isfinite(scan.points).all(1)
        expected = [
            name if ok else "out_of_reach" for name, ok in zip(expected, finite, strict=True)
        ]
        (given,) = reasons(method, [scan])
        assert given == expected
        found += given
    assert len(set(found)) > 4


def test_every_reason_occurs_in_the_small_world():
    scans, found = crossed_room(), set()
    for values in (COARSE, COARSE | {"min_score": 60}):
        found |= {name for scan in reasons(run(scans, **values), scans) for name in scan}
    assert found == set(NAME)


def test_a_box_that_stops_is_static_after_the_window():
    """Dynamic means moving now: the box is removed until it stops, and kept soon after."""
    scans = small_room(14, 3000, stops=7)
    method = run([scan.without_truth() for scan in scans], **COARSE)
    removed = [method.label(scan).dynamic[scan.labels == 1].mean() for scan in scans]
    assert min(removed[5:8]) > 0.5
    assert max(removed[11:]) == 0


def test_labels_online_are_those_after_all_scans():
    scans = crossed_room()
    method = begin(scans, **COARSE)
    online = []
    for scan in scans:
        method.observe(scan)
        online += reasons(method, [scan])
    assert online == reasons(method, scans)


def test_labels_do_not_depend_on_threads_the_probe_the_extent_or_point_order():
    scans = crossed_room(6)
    wide = Extent(
        np.full(3, -40.0),
        np.full(3, 40.0),
        np.argwhere(np.ones((26, 26, 26))).astype(np.int32) - 13,
    )
    try:
        kernels.set_threads(1)
        alone = reasons(run(scans, **COARSE), scans)
        kernels.set_threads(None)
        assert reasons(run(scans, **COARSE, probe=MemoryProbe()), scans) == alone
        assert reasons(run(scans, **COARSE, extent=wide), scans) == alone
        backwards = [dataclasses.replace(scan, points=scan.points[::-1]) for scan in scans]
        assert [scan[::-1] for scan in reasons(run(backwards, **COARSE), backwards)] == alone
    finally:
        kernels.set_threads(None)


def test_states_match_the_labels():
    scans, probe = crossed_room(), MemoryProbe()
    method = run(scans, probe=probe, **COARSE)
    assert set(probe.values) == {state.name for state in HmmMos.info.emits}
    for frame, scan in enumerate(scans):
        shown = {name: values[frame] for name, values in probe.values.items()}
        labels = method.label(scan)
        np.testing.assert_array_equal(shown["dynamic"].classes, CLASS[labels.reasons])
        if labels.dynamic.any():
            assert shown["threshold"].value > method.params.min_score
            assert shown["window_score"].values.max() > shown["threshold"].value
        hit = set(
            map(
                tuple,
                np.floor(scan.points[np.isfinite(scan.points).all(1)] / 0.3).astype(int).tolist(),
            )
        )
        for name in ("turned", "score", "window_score"):
            assert set(map(tuple, shown[name].keys.tolist())) <= hit
        assert len(shown["belief"].keys) == len(shown["likelihood"].keys) > 0
        for name in ("belief", "likelihood"):
            assert 0 <= shown[name].values.min() <= shown[name].values.max() <= 1


@pytest.mark.plain
def test_points_far_from_the_extent_and_empty_scans_are_kept():
    scans = crossed_room(6)
    empty = dataclasses.replace(scans[0], index=99, points=scans[0].points[:0])
    far = dataclasses.replace(scans[1], index=98, points=scans[1].points + np.float32(9000))
    method = run([*scans, empty, far], extent=Extent.of(empty, *small_room(6, 500)), **COARSE)
    assert len(method.label(empty)) == 0
    assert set(reasons(method, [far])[0]) == {"out_of_reach"}


@pytest.mark.parametrize(
    "values",
    [
        {"resolution": 0.0},
        {"belief": 1.0},
        {"kernel": 4},
        {"kernel": 19},
        {"window": 0},
        {"forget_after": 0},
        {"min_score": -1},
        {"min_range": -1.0},
        {"max_range": 1.0},
        {"max_range": 6000.0},
    ],
    ids=str,
)
def test_invalid_parameters_are_rejected(values):
    with pytest.raises(ValueError, match=next(iter(values))):
        HmmMosParams(**values)


def test_presets_have_the_published_values():
    published = {
        "semindoor": (0.5, 20.0, 5, False),
        "helimos": (1.5, 50.0, 3, False),
        "port": (1.5, 120.0, 5, True),
    }
    for preset, expected in published.items():
        p = resolve(HmmMos, preset).params
        assert (p.min_range, p.max_range, p.window, p.port) == expected


def test_blocks_out_of_reach_are_forgotten_on_a_drive_that_never_returns():
    """What a scan costs then does not depend on the length of the drive."""
    random, scans = np.random.default_rng(0), []
    for k in range(60):
        T_world_sensor = pose(2 * k, 0, 0)
        points = random.uniform(-8, 8, (40, 3)) + T_world_sensor[:3, 3]
        scans.append(Scan(k, points.astype(np.float32), T_world_sensor))
    method = HmmMos(HmmMosParams(max_range=10.0))
    method.begin(Context(Extent.of(*scans)))
    used = []
    for scan in scans:
        method.observe(scan)
        used.append(len(method._map._used))
        assert len(set(method._map._used.tolist())) == used[-1]
    assert max(used[30:]) < 1.2 * max(used[15:30])
    assert max(used) < len(method._map) / 2
