from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers.marks import compiled_only
from helpers.reference.beautymap import Reference

from dynaviz import kernels
from dynaviz.blocks.window import Window
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.probe import SILENT, MemoryProbe
from dynaviz.contracts.scan import Scan
from dynaviz.testing.world import moved, turn
from dynaviz_methods.beautymap.method import BeautyMap, BeautyMapParams

pytestmark = pytest.mark.boundscheck

EXTENT = Extent(np.zeros(3), np.zeros(3), np.zeros((0, 3), np.int32))


def scan(index: int, points, sensor=(0.0, 0.0, 1.7)) -> Scan:
    T_world_sensor = np.eye(4)
    T_world_sensor[:3, 3] = sensor
    return Scan(index, np.asarray(points, np.float32).reshape(-1, 3), T_world_sensor)


def yard(frames: int = 5, seed: int = 0) -> list[Scan]:
    """A sloping floor with a pit, a wall, branches above, and a moving box."""
    random = np.random.default_rng(seed)
    scans = []
    for index in range(frames):
        floor = random.uniform((-12, -12, -0.05), (12, 12, 0.05), (4000, 3))
        floor[:, 2] += 0.05 * floor[:, 0]
        pit = random.uniform((3, 3, -3), (4, 4, -2), (20, 3))
        wall = random.uniform((9, -12, 0), (9.4, 12, 4), (1200, 3))
        branches = random.uniform((-9, -9, 3), (-6, 9, 4.5), (200, 3))
        thing = random.uniform((0, 5, 0.1), (2.2, 6.8, 1.5), (300, 3)) + np.array(
            [2.5 * index - 6, 0, 0]
        )
        stray = random.uniform((-11, -11, 0.2), (11, 11, 3), (40, 3))
        points = np.concatenate([floor, pit, wall, branches, thing, stray])
        scans.append(scan(3 * index + 1, points, (0.6 * index, 0.3 * index, 1.7)))
    return scans


def jumble(frames: int = 5, seed: int = 0) -> list[Scan]:
    """Posts on ground with a hole.

    Each scan sees other posts, and the sensor of some scans is above the hole.
    """
    random = np.random.default_rng(seed)
    feet = random.uniform((-12, -12), (12, 12), (60, 2))
    tops = random.uniform(0.5, 3, 60)
    scans = []
    for index in range(frames):
        ground = random.uniform((-12, -12, -0.1), (12, 12, 0.1), (1500, 3))
        ground[:, 2] += 0.1 * ground[:, 1]
        ground = ground[(np.abs(ground[:, :2]) > 2).any(1)]
        posts = []
        for foot, top in zip(feet, tops, strict=True):
            if random.random() < 0.5 and (np.abs(foot) > 2.5).any():
                z = 0.1 * foot[1] + np.arange(0.1, top, 0.1)
                posts.append(np.column_stack([np.tile(foot, (len(z), 1)), z]))
        sky = random.uniform((-9, -9, 5), (9, 9, 8), (3, 3))
        sensor = (0.5, 0.3, 0.8) if index % 2 else (3.0, 2.0, 1.5 + 0.2 * index)
        scans.append(scan(index, np.concatenate([ground, *posts, sky]), sensor))
    return scans


def post(*heights: float, at=(6.0, 0.5)) -> np.ndarray:
    return np.array([(*at, h) for h in heights]).reshape(-1, 3)


def floor() -> np.ndarray:
    x, y = np.meshgrid(np.arange(-11.75, 12, 0.5), np.arange(-11.75, 12, 0.5))
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], 1)


def run(scans, probe=SILENT, **values):
    method = BeautyMap(BeautyMapParams(**values))
    method.begin(Context(EXTENT, probe=probe, raw_map=np.concatenate([s.points for s in scans])))
    for s in scans:
        method.observe(s)
    return method


def names(method, s) -> list[str]:
    return [method.info.reasons[code].name for code in method.label(s).reasons]


@pytest.mark.parametrize("values", [(16.0, 1.0, 0.5), (10.0, 0.5, 0.2), (40.0, 0.8, 0.35)])
@pytest.mark.parametrize("scene", [yard, jumble])
@pytest.mark.parametrize("seed", range(2))
def test_labels_match_the_reference(values, scene, seed):
    scans = scene(seed=seed)
    method = run(scans, **dict(zip(("dis_range", "xy_resolution", "h_res"), values, strict=True)))
    reference = Reference(np.concatenate([s.points for s in scans]), *values)
    for s in scans:
        reference.observe(s.points, s.position)
    removed = 0
    for s in scans:
        expected = np.array([reference.label(p) for p in s.points])
        np.testing.assert_array_equal(method.label(s).dynamic, expected)
        removed += expected.sum()
    assert removed > 50


def test_slices_that_a_scan_should_see_but_does_not_are_removed():
    """Slices 1 and 2 of a post are removed; in slice 0 only the points above the ground are."""
    foot = np.repeat(0.02, 20)
    there = scan(0, np.concatenate([floor(), post(*foot, 0.25, 0.45, 0.6, 1.1)]))
    gone = scan(1, np.concatenate([floor(), post(3.0, at=(11.0, 11.0))]))
    method = run([there, gone])
    assert names(method, there)[-4:] == ["above_fine_ground"] * 2 + ["not_in_scan"] * 2
    assert set(names(method, there)[-21:-4]) == {"fine_ground"}
    assert method.label(there).dynamic[-4:].all()
    assert not method.label(there).dynamic[:-4].any()


def test_points_above_a_gap_of_fine_bins_in_a_split_slice_are_kept():
    foot = np.repeat(0.02, 20)
    there = scan(0, np.concatenate([floor(), post(*foot, 0.15, 0.45, 0.6)]))
    gone = scan(1, np.concatenate([floor(), post(3.0, at=(11.0, 11.0))]))
    assert names(run([there, gone]), there)[-3:] == ["above_fine_ground", "overhang", "not_in_scan"]


def test_a_slice_without_enough_ground_is_kept():
    there = scan(0, np.concatenate([floor(), post(*np.repeat(0.45, 9), 0.15, 0.6)]))
    gone = scan(1, np.concatenate([floor(), post(3.0, at=(11.0, 11.0))]))
    assert set(names(run([there, gone]), there)[-11:-1]) == {"fine_ground", "overhang"}


def test_splits_of_several_scans_add_up():
    """One scan removes slice 3 and splits 2, the other removes slice 1 and splits 0.

    The rest is hidden from them.
    """
    low, high = np.repeat(0.02, 20), np.repeat(1.02, 20)
    sky = np.concatenate([floor(), post(6.0, at=(-6.0, 0.5))])
    there = scan(0, np.concatenate([sky, post(*low, *high, 0.25, 0.45, 0.6, 1.25, 1.6)]))
    hidden = ((0.3, 0.6, 1.1), (0.3, 1.1, 1.6))
    others = [
        scan(k + 1, np.concatenate([sky, post(*heights, at=(5.0, -0.1))]))
        for k, heights in enumerate(hidden)
    ]
    for order in (others, others[::-1]):
        method = run([there, *order])
        assert [
            name in ("not_in_scan", "above_fine_ground") for name in names(method, there)[-45:]
        ] == ([False] * 40 + [True] * 5)


@pytest.mark.plain
def test_lines_of_sight_work_without_map_points_below_the_sensor():
    hole = floor()[(np.abs(floor()[:, :2]) > 1.5).any(1)]
    there = scan(0, np.concatenate([hole, post(0.6)]))
    for height, reason in ((0.6, "ray_blocked"), (1.6, "not_in_scan")):
        gone = scan(
            1, np.concatenate([hole, post(0.3, height, at=(5.0, -0.1)), post(6.0, at=(-6.0, 0.5))])
        )
        assert names(run([there, gone]), there)[-1] == reason


def test_a_line_to_a_near_target_ends_one_column_behind_it():
    """For a target three columns from the sensor, a line is first tested, and ends, one column
    behind the target.
    """
    there = scan(0, np.concatenate([floor(), post(1.1, at=(3.0, 0.0))]))
    for x, reason in ((4.0, "ray_blocked"), (5.0, "not_in_scan")):
        behind = post(0.6, at=(x, 0.0))
        gone = scan(1, np.concatenate([floor(), behind, post(6.0, at=(-6.0, 0.5))]))
        assert names(run([there, gone]), there)[-1] == reason


def test_slice_0_extends_one_slice_below_the_base():
    """A pit in level ground: the base of its column is that of the ground."""
    pit = post(-0.4, -0.6, at=(3.2, 3.2))
    s = scan(0, np.concatenate([floor(), pit]))
    method = run([s, scan(1, floor())])
    assert names(method, s)[-2:] == ["always_seen", "unjudged"]
    assert not method.label(s).dynamic.any()


@pytest.mark.parametrize(
    ("reason", "there", "gone"),
    [
        ("near_sensor", post(0.6, at=(2.0, 0.5)), post()),
        ("above_highest_seen", post(1.1), post(0.6)),
        ("above_view", post(0.6, 1.1, 1.6, 2.1, 2.6, 3.1, 3.6), post(1.4, at=(-6.0, 0.5))),
        ("overhang", post(2.1), post(6.0, at=(-6.0, 0.5))),
        ("ray_blocked", post(0.6), post(0.3, 0.6, 1.1, 1.6, at=(5.0, -0.1))),
        ("out_of_window", post(0.6, at=(11.0, 0.5)), post()),
    ],
)
def test_each_step_keeps_its_slices(reason, there, gone):
    scans = [scan(0, np.concatenate([floor(), there])), scan(1, np.concatenate([floor(), gone]))]
    method = run(scans, dis_range=20.0)
    assert names(method, scans[0])[-1] == reason


def test_the_field_of_view_ends_at_the_steepest_point_at_any_distance():
    there = scan(0, np.concatenate([floor(), post(0.6, 1.1, 1.6, 2.1, 2.6, 3.1, 3.6)]))
    for near, reason in ((post(), "above_view"), (post(2.2, at=(0.4, 0.3)), "not_in_scan")):
        gone = scan(1, np.concatenate([floor(), post(1.4, at=(-6.0, 0.5)), near]))
        assert names(run([there, gone]), there)[-1] == reason


def test_far_columns_without_visible_ground_are_kept():
    ground = floor() + np.array([12.0, 0, 0])
    far = post(0.6, 0.8, at=(18.0, 0.5))
    unseen = ground[np.abs(ground[:, 0] - 18.0) > 1]
    scans = [scan(0, np.concatenate([ground, far])), scan(1, unseen)]
    assert names(run(scans), scans[0])[-1] == "ground_not_seen"


def test_the_lowest_slice_is_ground():
    scans = [scan(0, floor()), scan(1, floor()[:100])]
    assert "ground_slice" in names(run(scans), scans[0])
    assert not run(scans).label(scans[0]).dynamic.any()


@pytest.mark.plain
@pytest.mark.parametrize(
    "points",
    [
        [],
        [(1.0, 2.0, 3.0)],
        [(0.0, 0.0, 1.7)],
        pytest.param(
            [(np.nan, 0.0, 0.0), (np.inf, -np.inf, 0.0), (1.0, 1.0, np.nan)], marks=compiled_only
        ),
        [(1e30, 0.0, 0.0), (4e4, 0.0, 0.0), (1.0, 1.0, 1.0), (5.0, 5.0, 1e30)],
    ],
    ids=["empty", "one", "at the sensor", "not finite", "beyond reach"],
)
def test_odd_scans_are_kept(points):
    points = np.array(points, np.float32).reshape(-1, 3)
    s = scan(0, points)
    method = run([s], probe=MemoryProbe())
    assert not method.label(s).dynamic.any()
    judged = (np.abs(points) < (32768, 32768, 1e6)).all(1)
    assert [name == "unjudged" for name in names(method, s)] == (~judged).tolist()


def test_points_and_sensors_outside_the_map_change_nothing():
    scans = yard(2)
    method = run(scans)
    before = [method.label(s).dynamic for s in scans]
    for sensor in ((1e6, 0, 0), (-60.0, 5.0, 1.0), (np.nan, 0.0, 0.0)):
        method.observe(scan(9, floor()[:5], sensor))
    for s, labels in zip(scans, before, strict=True):
        np.testing.assert_array_equal(method.label(s).dynamic, labels)
    outside = scan(9, [(500.0, 0, 0), (-500.0, 0, 0)])
    method.observe(outside)
    assert names(method, outside) == ["unjudged"] * 2


@pytest.mark.parametrize("height", [-1e308, -1e5, 1e5, 1e308])
def test_extreme_heights_of_points_and_sensors_work(height):
    scans = yard(2)
    steep = np.array([(1e-30, 0.0, 1.0), (0.0, 0.0, 5.0), (1e-20, 1e-20, 1e30)])
    method = run([*scans, scan(8, steep, (0.0, 0.0, 0.5)), scan(9, floor(), (0.0, 0.0, height))])
    assert not any(method.label(s).dynamic.all() for s in scans)


def test_labels_do_not_depend_on_threads_or_the_probe():
    scans = yard()
    try:
        kernels.set_threads(1)
        alone = [run(scans).label(s).dynamic for s in scans]
        kernels.set_threads(None)
        together = [run(scans, probe=MemoryProbe()).label(s).dynamic for s in scans]
    finally:
        kernels.set_threads(None)
    np.testing.assert_array_equal(np.concatenate(alone), np.concatenate(together))
    assert np.concatenate(alone).any()


def test_labels_do_not_depend_on_the_order_of_scans():
    scans = yard()
    back = run(scans[::-1])
    for s in scans:
        np.testing.assert_array_equal(run(scans).label(s).dynamic, back.label(s).dynamic)


def test_a_shift_of_the_world_and_a_rotation_of_the_sensor_change_few_labels():
    scans = yard()
    T = turn(0.0, 13.37, -7.1, 0.45)
    turned = turn(50.0, 0.0, 0.0, 0.0)
    shifted = [Scan(s.index, moved(s, T).points, T @ s.T_world_sensor @ turned) for s in scans]
    before, after = run(scans), run(shifted)
    changed = [
        before.label(s).dynamic != after.label(t).dynamic
        for s, t in zip(scans, shifted, strict=True)
    ]
    assert np.concatenate(changed).mean() < 1e-3


def test_begin_discards_an_earlier_sequence():
    scans = yard()
    method = run(scans)
    first = [method.label(s).dynamic for s in scans]
    method.begin(Context(EXTENT, raw_map=np.concatenate([s.points for s in scans])))
    assert not any(method.label(s).dynamic.any() for s in scans)
    for s in scans:
        method.observe(s)
    np.testing.assert_array_equal(
        np.concatenate(first), np.concatenate([method.label(s).dynamic for s in scans])
    )


def test_states_are_those_declared_and_partition_the_slices():
    scans, probe = yard(), MemoryProbe()
    method = run(scans, probe=probe)
    kinds = {state.name: state.kind for state in method.info.emits}
    assert {name: {type(v) for v in values} for name, values in probe.values.items()} == {
        name: {kind} for name, kind in kinds.items()
    }
    assert all(len(values) == len(scans) for values in probe.values.values())
    voxels = [name for name, kind in kinds.items() if kind.__name__ == "Voxels"]
    cubes = {
        name: {tuple(k) for v in probe.values[name] for k in v.keys.tolist()} for name in voxels
    }
    assert cubes["removed"]
    assert all(cubes[name] <= cubes["map_slices"] for name in voxels)
    for frame in range(len(scans)):  # each slice is seen, kept by one step, or removed
        parts = [
            {tuple(k) for k in probe.values[name][frame].keys.tolist()}
            for name in voxels
            if name != "map_slices"
        ]
        whole = {tuple(k) for k in probe.values["map_slices"][frame].keys.tolist()}
        assert sum(len(p) for p in parts) == len(whole) == len(set.union(*parts))


def test_labels_do_not_depend_on_the_memory_layout_of_the_map():
    scans = yard(2)
    raw = np.asfortranarray(np.concatenate([s.points for s in scans]))
    raw.flags.writeable = False
    method = BeautyMap(BeautyMapParams())
    method.begin(Context(EXTENT, raw_map=raw))
    for s in scans:
        method.observe(s)
    np.testing.assert_array_equal(
        method.label(scans[0]).dynamic, run(scans).label(scans[0]).dynamic
    )


@pytest.mark.parametrize("threads", [1, 2])
def test_labels_do_not_depend_on_the_parts_in_which_a_map_is_encoded(threads, monkeypatch):
    scans = yard(3)
    expected = [run(scans).label(s).reasons for s in scans]
    monkeypatch.setattr("dynaviz_methods.beautymap.method.CHUNK", 997)
    before = kernels.threads_in_use()
    kernels.set_threads(threads)
    try:
        method = run(scans)
    finally:
        kernels.set_threads(before)
    for s, reasons in zip(scans, expected, strict=True):
        np.testing.assert_array_equal(method.label(s).reasons, reasons)


def test_live_labels_are_those_of_a_run_over_the_scans_that_are_not_forgotten():
    """The lowest x and y of the map, from which columns are counted, differ from scan to scan."""
    scans = [
        scan(n, np.concatenate([s.points, [[-40 - 0.37 * n, -30 + 0.21 * n, 0]]]))
        for n, s in enumerate(yard(7))
    ]
    live, removed = BeautyMap(BeautyMapParams()), 0
    live.begin(Context(Window(50.0)))
    for n, s in enumerate(scans):
        live.observe(s)
        recent = scans[max(n - 3, 0) : n + 1]
        offline = run(recent)
        for each in recent:
            np.testing.assert_array_equal(live.label(each).reasons, offline.label(each).reasons)
        removed += live.label(s).dynamic.sum()
        live.forget(n - 3)
    assert removed > 50


@pytest.mark.parametrize(
    "values", [{"dis_range": 0.0}, {"xy_resolution": float("nan")}, {"h_res": -1.0}]
)
def test_invalid_parameters_are_rejected(values):
    with pytest.raises(ValueError, match=next(iter(values))):
        BeautyMapParams(**values)
    with pytest.raises(ValueError, match="dis_range"):
        BeautyMapParams(dis_range=1.0, xy_resolution=1.0)


def test_the_number_of_parameters_matches_the_paper():
    assert len(dataclasses.fields(BeautyMapParams)) == 3
