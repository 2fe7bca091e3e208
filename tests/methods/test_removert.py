from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers.marks import compiled_only
from helpers.reference.removert import Reference
from scipy.spatial.transform import Rotation

from dynaviz import kernels
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.params import resolve
from dynaviz.contracts.probe import SILENT, MemoryProbe
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.errors import UsageError
from dynaviz_methods.removert.method import REASONS, Removert, RemovertParams
from dynaviz_methods.shared.range_images import image_views, picture, whole

SHARED = kernels.load("dynaviz_methods.shared.kernels")

pytestmark = pytest.mark.boundscheck

SENSOR = Sensor(elevation=(-30.0, 30.0))
COARSE = RemovertParams(resolutions=(0.5, 0.35, 0.25), voxel=0.3)  # many points per pixel


def scan(index: int, points, position=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0)) -> Scan:
    T_world_sensor = np.eye(4)
    T_world_sensor[:3, :3] = Rotation.from_euler("xyz", turn).as_matrix()
    T_world_sensor[:3, 3] = position
    return Scan(index, np.asarray(points, np.float32).reshape(-1, 3), T_world_sensor)


def street(frames: int = 5, thin: int = 1, seed: int = 0) -> list[Scan]:
    """Far from the origin: rays of a rotating sensor to a floor, a round wall and a
    passing ball.
    """
    random = np.random.default_rng(seed)
    scans = []
    for frame in range(frames):
        turn = 0.05 * frame, -0.03 * frame, 1.1 * frame
        away = np.radians(random.uniform((-180, -28), (180, 28), (4000 // thin, 2)))
        up = np.sin(away[:, 1])
        direction = np.stack(
            [np.cos(away[:, 0]), np.sin(away[:, 0]), np.tan(away[:, 1])], 1
        ) * np.cos(away[:, 1:])
        wall = 12 / np.cos(away[:, 1])
        reach = np.where(up < 0, np.minimum(wall, 5 / np.maximum(-up, 1e-6)), wall)
        centre = np.array([5.0, -4.0 + 2 * frame, 0.0])
        along = direction @ centre
        inside = 1.2**2 - (centre @ centre - along**2)
        hit = (inside > 0) & (along > 0)
        reach = np.where(hit, along - np.sqrt(np.maximum(inside, 0)), reach)
        at = np.array([37.0 + 0.1 * frame, -12.0, 3.0])
        scans.append(scan(7 * frame, at + direction * reach[:, None], at, turn))
    return scans


def of_ball(s: Scan):
    """Points closer than wall and floor: those of the ball."""
    away = s.points - s.position
    return (np.hypot(*away[:, :2].T) < 11) & (away[:, 2] > -4.9)


def run(scans, params=COARSE, probe=SILENT, sensor=SENSOR):
    method = Removert(params)
    method.begin(context(scans, probe, sensor))
    for s in scans:
        method.observe(s)
    return method


def context(scans, probe=SILENT, sensor=SENSOR):
    unused = [scan(0, [(0.0, 0.0, 0.0)])]  # Removert does not use the extent
    return Context(
        Extent.of(*unused), sensor, probe, raw_map=np.concatenate([s.points for s in scans])
    )


def labels(method, scans):
    return np.concatenate([method.label(s).dynamic for s in scans])


def names(method, s):
    return [REASONS[code].name for code in method.label(s).reasons]


VARIANTS = [
    {},
    {"resolutions": (0.5, 0.45, 0.4, 0.3), "threshold": 0.01, "voxel": 0.1},
    {"resolutions": (0.3, 0.2), "revert_resolutions": (0.25,)},
    {"resolutions": (0.2,), "revert_resolutions": (0.15, 0.25), "threshold": 0.2},
    {"voxel": 0.0, "elevation": (-12.0, 3.0), "azimuth": (-140.0, 100.0)},
    {"port": True, "voxel": 0.0},
    {"port": True, "elevation": (-5.0, 5.0), "threshold": 0.3},
    {"scan_neighbours": 2},
    {"scan_neighbours": 5, "scan_difference": 2.0, "revert_resolutions": (0.3,)},
]


@pytest.mark.parametrize("variant", range(len(VARIANTS)))
def test_reasons_match_the_reference(variant):
    scans, params = street(thin=10, seed=variant), dataclasses.replace(COARSE, **VARIANTS[variant])
    odd = np.array([(np.nan, 0, 0), (np.inf, 1, 1), scans[2].position, (37.2, -12, 40)], np.float32)
    scans[2] = dataclasses.replace(scans[2], points=np.concatenate([odd, scans[2].points]))
    method, probe = run(scans, params), MemoryProbe()
    reference = Reference(
        params,
        context(scans).raw_map,
        params.elevation or SENSOR.elevation,
        params.azimuth or SENSOR.azimuth,
    )
    for s in scans:
        reference.observe(s)
    labelled = [reference.label(s) for s in scans]
    expected = [
        reason
        for s, each in zip(scans, labelled, strict=True)
        for reason in reference.reasons(s, each)
    ]
    assert [reason for s in scans for reason in names(method, s)] == expected
    dynamic = labels(method, scans)
    np.testing.assert_array_equal(dynamic, [value for each in labelled for value in each])
    assert 20 < dynamic.sum() < 0.9 * len(dynamic)
    np.testing.assert_array_equal(labels(run(scans, params, probe), scans), dynamic)
    assert ("reverted" in expected) == bool(params.revert_resolutions)
    removed = {reason.name for reason in REASONS if reason.meaning.startswith("removed")}
    assert [reason in removed for reason in expected] == dynamic.tolist()


def test_the_ball_is_removed_and_the_rest_is_kept():
    scans = street()
    dynamic, ball = labels(run(scans), scans), np.concatenate([of_ball(s) for s in scans])
    assert dynamic[ball].mean() > 0.9
    assert dynamic[~ball].mean() < 0.05
    assert ball.sum() > 100


@pytest.mark.parametrize(
    "values", [{}, {"revert_resolutions": (0.4,)}, {"port": True}, {"scan_neighbours": 2}]
)
def test_labels_do_not_depend_on_threads_or_the_probe(values):
    scans, params = street(), dataclasses.replace(COARSE, **values)
    answer = labels(run(scans, params), scans)
    codes = [run(scans, params).label(s).reasons for s in scans[:2]]
    try:
        kernels.set_threads(1)
        again = run(scans, params, probe=MemoryProbe())
        np.testing.assert_array_equal(labels(again, scans), answer)
        np.testing.assert_array_equal([again.label(s).reasons for s in scans[:2]], codes)
    finally:
        kernels.set_threads(None)
    assert answer.any()


@pytest.mark.parametrize("port", [False, True])
def test_ignoring_map_points_beyond_reach_changes_no_label(port):
    """With one very distant return, each scan reaches all of the three streets."""
    near, params = [], dataclasses.replace(COARSE, port=port, elevation=(-30.0, 60.0))
    for k, s in enumerate(street(4, thin=10) * 3):
        shift = np.array([300.0 * (k // 4), 0, 0])
        near.append(scan(k, s.points + shift, s.position + shift))
    far = [
        scan(s.index, np.vstack([s.points, s.position + np.array((0, 9e4, 9e4))]), s.position)
        for s in near
    ]
    all_of_it, cut = run(far, params), run(near, params)
    expected = np.concatenate([all_of_it.label(s).dynamic[:-1] for s in far])
    np.testing.assert_array_equal(labels(cut, near), expected)
    assert 0 < expected.mean() < 0.5


def test_removal_is_final_and_begin_discards_it():
    scans = street()
    method = run(scans)
    final = labels(method, scans)
    method.begin(context(scans))
    before = np.zeros(len(scans[0]), np.bool_)
    for s in scans:
        method.observe(s)
        now = method.label(scans[0]).dynamic
        assert (now >= before).all()
        before = now
    assert before.any()
    np.testing.assert_array_equal(labels(method, scans), final)


def test_reasons_of_points_along_a_ray():
    """Along one ray: an object at 5 m that disappears, a wall at 10 m seen three times, and a point
    behind it.
    """
    wall, thing, behind, above = (10.0, 0, 0), (5.0, 0, 0), (15.0, 0, 0), (1.0, 0, 5.0)
    left = (0.0, 20.0, 0.0)
    scans = [
        scan(0, [thing, above]),
        scan(1, [wall]),
        scan(2, [wall, left]),
        scan(3, [behind]),
        scan(4, [wall]),
    ]
    method = run(scans, dataclasses.replace(COARSE, voxel=0.0))
    nearer = "nearer_than_scan_at_res_1"
    expected = [[nearer, "out_of_view"], [nearer], [nearer, "hidden"], ["hidden"], [nearer]]
    assert [names(method, s) for s in scans] == expected
    del scans[3]  # without it nothing is seen behind the wall
    method = run(scans, dataclasses.replace(COARSE, voxel=0.0))
    assert [names(method, s) for s in scans] == [
        [nearer, "out_of_view"],
        ["agrees"],
        ["agrees", "hidden"],
        ["agrees"],
    ]


@pytest.mark.parametrize(("nearer", "removed"), [(9.4, True), (9.6, False)])
def test_the_threshold_is_a_fraction_of_the_range(nearer, removed):
    for factor in (1, 5):
        scans = [scan(0, [(nearer * factor, 0, 0)]), scan(1, [(10.0 * factor, 0, 0)])]
        assert run(scans).label(scans[0]).dynamic.tolist() == [removed]


def test_points_that_are_not_flagged_in_the_revert_image_are_static():
    """A point next to the ray to the wall: in the same pixel of 4 degrees, but not of 1 degree."""
    thing = 5 * np.array([np.cos(0.03), np.sin(0.03), 0])
    scans = [scan(0, [thing]), scan(1, [(10.0, 0, 0)])]
    params = RemovertParams(resolutions=(0.25,), voxel=0.0)
    assert names(run(scans, params), scans[0]) == ["nearer_than_scan_at_res_1"]
    params = dataclasses.replace(params, revert_resolutions=(1.0,))
    assert names(run(scans, params), scans[0]) == ["reverted"]
    reverted = scan(2, 10 * thing / 5)  # this scan sees past it in the fine image, too
    assert names(run([*scans, reverted], params), scans[0]) == ["nearer_than_scan_at_res_1"]


@pytest.mark.plain
def test_the_port_judges_one_map_point_of_a_pixel():
    behind_one_another = [(5.0, 0, 0), (5.1, 0, 0), (5.2, 0, 0)]
    scans = [scan(0, behind_one_another), scan(1, [(10.0, 0, 0)])]
    params = dataclasses.replace(COARSE, voxel=0.0)
    assert run(scans, params).label(scans[0]).dynamic.tolist() == [True] * 3
    port = dataclasses.replace(params, port=True)
    assert run(scans, port).label(scans[0]).dynamic.tolist() == [True, False, False]


def test_states_are_those_declared_and_are_consistent():
    scans, probe = street(), MemoryProbe()
    method = run(scans, probe=probe)
    emitted = {name: {type(value) for value in values} for name, values in probe.values.items()}
    assert emitted == {state.name: {state.kind} for state in Removert.info.emits}
    assert {len(values) for values in probe.values.values()} == {len(scans)}
    for frame, s in enumerate(scans):
        for k, resolution in enumerate(COARSE.resolutions, 1):
            of_scan, of_map, difference, flagged = (
                probe.values[f"{name}_{k}"][frame].ranges
                for name in ("scan", "map", "difference", "flagged")
            )
            assert of_scan.shape == (round(60 * resolution), round(360 * resolution))
            np.testing.assert_array_equal(difference, of_scan - of_map)
            with np.errstate(invalid="ignore"):
                np.testing.assert_array_equal(
                    ~np.isnan(flagged), difference > np.float32(0.05) * of_scan
                )
            assert np.nanmin(of_scan) == pytest.approx(
                np.linalg.norm(s.points - s.position, axis=1).min()
            )
    accused = np.concatenate([value.xyz for value in probe.values["accused"]])
    points = method._map[:, method._dynamic(method._past)[:-1]].T
    assert {tuple(p) for p in accused} == {tuple(p) for p in points}
    assert len(accused) == len(points) > 50


def test_two_resolutions_have_states_of_two():
    scans, probe = street(2, thin=10), MemoryProbe()
    run(scans, dataclasses.replace(COARSE, resolutions=(0.5, 0.3)), probe=probe)
    assert {name[-1] for name in probe.values} - {"d"} == {"1", "2"}  # and accused


def test_pictures_have_up_at_the_top_and_left_on_the_left():
    views = image_views((0.5, 0.1), (-30.0, 10.0), (-180.0, 180.0))
    directions = np.radians([(0.0, 6.0), (90.0, 0.0), (-90.0, -20.0)])
    points = np.array(
        [(np.cos(a) * 5, np.sin(a) * 5, np.tan(e) * 5) for a, e in directions], np.float32
    )
    camera = (
        kernels.as_readonly(np.zeros(3), np.float64),
        kernels.as_readonly(np.eye(3), np.float64),
        views,
        False,
    )
    xyz = kernels.as_readonly(points.T, np.float32)
    flat, _ = SHARED.range_image.nearest(xyz, *whole(len(points)), *camera, 1, np.float32(0))
    image = picture(flat, views[0]).ranges
    assert image.shape == (20, 180)
    rows, columns = np.nonzero(~np.isnan(image))
    assert rows.tolist() == [2, 5, 15]
    assert columns[np.argsort(rows)].tolist() == [89, 44, 134]  # ahead, left, right
    assert picture(flat, views[1]).ranges.shape == (4, 36)


@pytest.mark.plain
@pytest.mark.parametrize(
    "points",
    [
        [],
        [(1.0, 2.0, 0.5)],
        [(0.0, 0.0, 0.0)],
        pytest.param([(np.nan, 0.0, 0.0), (np.inf, -np.inf, 0.0)], marks=compiled_only),
        [(1e30, 0.0, 0.0), (4e5, 0.0, 0.0), (1.0, 1.0, 1.0)],
        [(0.0, 0.0, 3.0), (0.0, 0.0, -3.0)],
    ],
    ids=["empty", "one", "at the sensor", "not finite", "beyond reach", "above and below"],
)
@pytest.mark.parametrize(
    "values", [{}, {"port": True}, {"voxel": 0.0}, {"scan_neighbours": 2}], ids=str
)
def test_odd_scans_are_kept(points, values):
    s = scan(0, points)
    method = run([s], dataclasses.replace(COARSE, **values), probe=MemoryProbe())
    assert not method.label(s).dynamic.any()
    unplaced = ~(np.abs(s.points) < (3e5 if values.get("voxel") != 0.0 else np.inf)).all(1)
    assert np.array([name == "out_of_view" for name in names(method, s)])[unplaced].all()


def test_a_missing_field_of_view_is_an_error():
    with pytest.raises(UsageError, match=r"elevation=\[LOWEST,HIGHEST\]"):
        run(street(1), sensor=Sensor())
    scans = street(thin=10)
    given = run(scans, dataclasses.replace(COARSE, elevation=(-30.0, 30.0)), sensor=Sensor())
    np.testing.assert_array_equal(labels(given, scans), labels(run(scans), scans))


def test_preset_values():
    assert resolve(Removert, preset="av2").params.resolutions == (2.5, 1.5)
    assert resolve(Removert, preset="kitti").params == dataclasses.replace(
        RemovertParams(), resolutions=(2.5, 2.2, 2)
    )
    port = resolve(Removert, preset="port").params
    assert (port.port, port.voxel, port.elevation) == (True, 0.0, (-25.0, 25.0))


@pytest.mark.parametrize(
    "values",
    [
        {"resolutions": ()},
        {"resolutions": (2.5, 0.0)},
        {"resolutions": (float("nan"),)},
        {"resolutions": (1e9,)},
        {"revert_resolutions": (1.0,) * 8},
        {"threshold": 1.0},
        {"voxel": -0.1},
        {"elevation": (10.0, -10.0)},
        {"azimuth": (-190.0, 10.0)},
        {"scan_neighbours": -1},
        {"scan_difference": float("nan")},
        {"port": True, "revert_resolutions": (1.0,)},
    ],
    ids=str,
)
def test_invalid_parameters_are_rejected(values):
    with pytest.raises(ValueError, match=next(iter(values)).removeprefix("revert_")):
        RemovertParams(**values)
