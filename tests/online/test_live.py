"""Live use: labels of scans as they come, revised labels, the static map, and what is forgotten."""

from __future__ import annotations

import weakref

import numpy as np
import pytest
from scipy.spatial import cKDTree

import dynaviz as dv
from dynaviz import kernels
from dynaviz.blocks.blocks import BlockGrid
from dynaviz.blocks.window import Window
from dynaviz.contracts import registry
from dynaviz.contracts.method import Context, Live
from dynaviz.contracts.scan import Scan
from dynaviz.errors import UsageError
from dynaviz.online.session import LiveSession, Settings
from dynaviz.testing.checks import ask
from dynaviz.testing.world import SENSOR, crossing, turn

KERNELS = kernels.load("dynaviz_methods.dynablox.kernels")


def session(method: str, reach: float = 100.0, keep: int = 20) -> LiveSession:
    kind = registry.load("methods", method)
    return LiveSession(kind(kind.Params()), SENSOR, Settings(reach, keep))


def drive(frames: int, step: float, start: float = 0.0) -> list[Scan]:
    """A sensor that drives along a corridor: a floor and two walls, with few rays."""
    angles = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    floor = np.stack([6 * np.cos(angles), 2 * np.sin(angles), np.full(120, -1.5)], 1)
    walls = np.stack(
        [8 * np.cos(angles), np.sign(np.sin(angles)) * 2.5, 1.5 * np.sin(7 * angles)], 1
    )
    scans = []
    for frame in range(frames):
        T = turn(0.0, start + frame * step, 0.3, 1.5)
        points = np.concatenate([floor, walls]) + T[:3, 3]
        scans.append(Scan(frame, points.astype(np.float32), T, 100_000_000 * frame))
    return scans


def test_labels_scans_given_as_arrays_like_those_of_a_sequence() -> None:
    scans = [scan.without_truth() for scan in crossing(3)]
    live = dv.live("dufomap", sensor="vlp16", reach=100)
    by_scan = session("dufomap")
    for scan in scans:
        labels = live.update(scan.points, scan.T_world_sensor, scan.stamp_ns, points_in="world")
        expected = by_scan.add(scan)
        np.testing.assert_array_equal(labels.dynamic, expected.dynamic)
        np.testing.assert_array_equal(labels.reasons, expected.reasons)
    assert sum(map(len, (each.labels for each in live.revise()))) == sum(map(len, scans))
    assert [each.stamp for each in live.revise()] == [scan.stamp_ns for scan in scans]


@pytest.mark.parametrize("method", ["dufomap", "seethrough", "beautymap"])
def test_revised_labels_are_those_of_the_offline_run(method: str) -> None:
    scans = [scan.without_truth() for scan in crossing(9)]
    live = session(method)
    first = [live.add(scan).dynamic.sum() for scan in scans]
    offline = ask(type(live._method), type(live._method).Params(), scans)
    for each, dynamic in zip(live.revise(), offline.dynamic, strict=True):
        np.testing.assert_array_equal(each.labels.dynamic, dynamic)
    revised = [dynamic.sum() for dynamic in offline.dynamic]
    assert sum(revised) > sum(first), "later scans must add evidence"
    again = session(method)
    for scan in scans[:-1]:
        again.add(scan)
        if scan.index % 3 == 2:
            again.revise()
    assert again.add(scans[-1]).dynamic.sum() == first[-1], "revising must not change later labels"


def test_map_has_one_static_point_per_voxel() -> None:
    live, scans = session("dufomap"), crossing(4)
    for scan in scans:
        live.add(scan.without_truth())
    points = live.map()
    assert len(np.unique(np.floor(points / 0.2).astype(int), axis=0)) == len(points) > 10_000
    raw = np.concatenate([scan.points for scan in scans])
    distances, _ = cKDTree(raw).query(points)
    assert distances.max() < 0.2 / 256, "each point of the map is a measured one"


def test_far_coordinates_come_back_in_the_map() -> None:
    live = session("dufomap")
    scan, far = crossing(1)[0], np.array([500_000.0, 5_000_000.0, 100.0])
    T = scan.T_world_sensor.copy()
    local = (scan.points - T[:3, 3]) @ T[:3, :3]
    T[:3, 3] += far
    live.update(local, T)
    assert np.abs(np.median(live.map(), axis=0) - T[:3, 3]).max() < 60


def test_memory_stays_bounded_while_the_sensor_drives() -> None:
    window = Window(12.0)
    grid = BlockGrid(window, 0.1)
    state = grid.per_block(np.zeros(len(grid), np.int32))
    most, rows = [], set()
    for scan in drive(120, 1.5):
        window.follow(scan)
        voxels = grid.locate(scan.points)
        assert (voxels >= 0).all()
        state[np.unique(voxels >> 9)] += 1
        most.append(int(grid.existing().sum()))
        rows |= set(np.flatnonzero(grid.existing()).tolist())
    assert max(most[60:]) <= 1.1 * max(most[20:60])
    assert len(rows) < 2 * max(most), "rows are used again"
    assert not state[~grid.existing()].any(), "the state of blocks that went is reset"
    assert state.max() < 20


def test_what_comes_back_after_a_while_is_new() -> None:
    live = session("octomap", reach=12.0)
    there, away = drive(5, 0.0), drive(1, 0.0, start=100.0)[0]
    first = [live.add(scan).reasons for scan in there]
    live.add(Scan(5, away.points, away.T_world_sensor))
    again = live.add(Scan(6, there[0].points, there[0].T_world_sensor))
    np.testing.assert_array_equal(again.reasons, first[0])


def test_points_beyond_reach_are_kept_and_still_cast_rays() -> None:
    live = session("octomap", reach=10.0)
    away = turn(0.0, 0.0, 0.0, 0.0)
    points = np.array([[30.0, 0.05, 0.05]] * 5, np.float32)
    labels = live.update(points, away)
    assert not labels.dynamic.any()
    assert live.info.reasons[labels.reasons[0]].name == "out_of_reach"
    for _ in range(3):
        live.update(points, away)
    assert live.update(np.array([[5.0, 0.05, 0.05]], np.float32), away).dynamic.all()


def test_neighbours_of_a_rolling_grid_are_those_of_its_keys() -> None:
    window = Window(12.0)
    grid = BlockGrid(window, 0.1)
    neighbours = grid.neighbours()
    for scan in drive(40, 2.0):
        window.follow(scan)
    exists = np.flatnonzero(grid.existing())
    number = {tuple(key): n for n, key in zip(exists, grid.blocks[exists].tolist(), strict=True)}
    for n in exists[::17]:
        x, y, z = grid.blocks[n]
        around = [(x + i, y + j, z + k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)]
        assert neighbours[n].tolist() == [number.get(key, -1) for key in around]


def test_cells_cover_all_rays_within_reach() -> None:
    window = Window(20.0)
    grid = BlockGrid(window, 0.1)
    for scan in drive(3, 0.9):
        window.follow(scan)
        along = np.linspace(0, 1, 50)[:, None, None]
        rays = scan.position + along * (scan.points - scan.position)
        assert (grid.locate(rays.reshape(-1, 3).astype(np.float32)) >= 0).all()


def test_the_world_begins_anew_far_from_its_origin() -> None:
    live = session("octomap", reach=10.0, keep=2)
    before = weakref.ref(live._window)
    for frame, scan in enumerate([*drive(3, 1.0), *drive(3, 1.0, start=3270.0)]):
        labels = live.update(scan.points, scan.T_world_sensor, points_in="world")
        assert (labels.reasons != 3).all(), f"frame {frame}: points are out of reach"
    assert live.restarts == 1
    assert before() is None, "the old map takes no memory"
    assert abs(np.median(live.map()[:, 0]) - 3271) < 8
    for scan in drive(2, 1.0, start=3274.0):
        assert (live.add(scan).reasons != 3).all()
    assert live.restarts == 1, "scans in the frame of the source are moved, too"


def test_a_crowded_window_drops_the_farthest() -> None:
    window = Window(12.0)
    grid = BlockGrid(window, 0.1)
    cells = window._cells
    cells.cells = cells.cells[:600].copy()
    for scan in drive(4, 0.5):
        window.follow(scan)
        assert len(window) <= 600
    near = scan.position + np.array([[0.5, 0.1, -0.2], [-1.0, 0.2, -0.4]])
    assert (grid.locate(near.astype(np.float32)) >= 0).all()


@pytest.mark.parametrize("method", ["erasor", "removert"])
def test_methods_that_need_the_map_say_why_not(method: str) -> None:
    with pytest.raises(UsageError, match="compares each scan with the map of all scans"):
        dv.live(method)


def test_a_map_of_no_other_scans_is_refused() -> None:
    with pytest.raises(
        UsageError, match=r"keep = 0: beautymap compares each scan with the last ones\. Give"
    ):
        dv.live("beautymap", keep=0)


def test_beautymap_begins_anew_before_the_end_of_its_columns() -> None:
    window, kind = Window(20.0), registry.load("methods", "beautymap")
    kind(kind.Params(dis_range=10.0, xy_resolution=0.1)).begin(Context(window))
    assert 3200 < window.farthest < 3276.8 - 20, "32768 columns of 0.1 m"


def test_all_other_methods_run_live() -> None:
    methods = registry.loadable("methods")
    assert {name for name, kind in methods.items() if not issubclass(kind, Live)} == {
        "erasor",
        "removert",
    }


@pytest.mark.parametrize(
    ("points", "pose", "message"),
    [
        (np.zeros((3, 2)), np.eye(4), r"points: \(3, 2\)"),
        (np.zeros((3, 3)), np.eye(3), r"pose: \(3, 3\)"),
        (np.zeros((3, 3)), np.full((4, 4), np.nan), "pose: has NaN"),
    ],
)
def test_wrong_arrays_are_refused(points: object, pose: object, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        session("dufomap").update(points, pose)  # type: ignore[arg-type]


def test_kernels_that_need_dynamic_points_are_compiled_before_the_first_scan(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls = []
    grow = KERNELS.clusters.grow
    monkeypatch.setattr(
        KERNELS.clusters, "grow", lambda *given: calls.append(grow(*given)) or calls[-1]
    )
    dv.live("dynablox", sensor="hdl64e", reach=30)
    assert len(calls) > 0, "clusters grow only from points in ever-free space"
