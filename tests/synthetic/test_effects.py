"""The laws of each effect, on tiny sensors in front of a wall."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dynaviz.contracts.sensors import load_sensor
from dynaviz.errors import UsageError
from dynaviz.synthetic.simulate import measurement, optics, poses
from dynaviz.synthetic.simulate.classes import ObjectClass
from dynaviz.synthetic.simulate.effects import BEHAVIOUR, NAMES, Effects
from dynaviz.synthetic.simulate.lidar import Hits, RayScene
from dynaviz.synthetic.simulate.movers import Movement, Route, cruise
from dynaviz.synthetic.simulate.options import Chosen
from dynaviz.synthetic.simulate.presets import PRESETS, REAL
from dynaviz.synthetic.simulate.recording import SceneRecorder, build
from dynaviz.synthetic.simulate.scene import SimulatedScene
from dynaviz.synthetic.simulate.shapes import box, quads

SMALL = dataclasses.replace(
    load_sensor("vlp16"),
    rings=16,
    elevation=(-15.0, 15.0),
    azimuth=(-30.0, 30.0),
    azimuth_step=0.5,
    range_noise=0.0,
    height=1.0,
)
SPEED = 8.0


def flat(x, y):
    return np.zeros(np.broadcast(x, y).shape)


@pytest.fixture
def wall():
    """A sensor that drives along y at 8 m/s, 10 m from a wall.

    A box moves 1 m in front of the wall.
    """
    way = Route([(0, -20), (0, 20)])
    scene = SimulatedScene(np.random.default_rng(0), 2.0, flat, Movement(way, cruise(16, SPEED)))
    scene.add(
        quads([[(9, -90, -90), (9, 90, -90), (9, 90, 90), (9, -90, 90)]]), ObjectClass.BUILDING, 0.8
    )
    scene.move(
        ObjectClass.MOVING_CAR, Route([(8.3, -8), (8.3, 8)]), cruise(5, 0.5), box(0.6, 1.0, 2.5)
    )
    return scene


def sensed(scene, effects, index=2, sensor=SMALL):
    """Returns in the sensor frame turned so that x points at the wall."""
    turned = dataclasses.replace(sensor, azimuth=(-120.0, -60.0))
    found = measurement.measure(RayScene(scene), turned, index, effects, seed=0)
    x, y, z = found.points.T
    return dataclasses.replace(found, points=np.stack([-y, x, z], axis=1))


def test_every_effect_is_off_by_default_and_documented():
    assert not Effects().active
    assert not Effects().optical
    assert all(each.metadata["text"] for each in dataclasses.fields(Effects))
    assert set(REAL.active) == set(NAMES) - {"raw", "pulse_m", "rain_per_m3"}


def test_deskewing_puts_the_wall_back_and_raw_points_bend(wall):
    exact = sensed(wall, Effects(sweep_s=0.1))
    raw = sensed(wall, Effects(sweep_s=0.1, raw=1))
    still = exact.kinds == ObjectClass.BUILDING
    np.testing.assert_allclose(exact.points[still, 0], 9, atol=2e-3)
    # the lidar turns from back to front while the sensor drives forward, so the sweep covers 0.8 m
    # more of the wall
    length, bent = (
        np.ptp(each.points[np.abs(each.points[:, 2]) < 0.3, 1]) for each in (exact, raw)
    )
    assert length - bent == pytest.approx(SPEED * 0.1, abs=0.15)


def test_movers_move_during_the_sweep(wall):
    wall.movers[0] = dataclasses.replace(
        wall.movers[0], motion=Movement(Route([(8.3, -8), (8.3, 8)]), cruise(5, 10.0))
    )
    lengths = []
    for effects in (Effects(), Effects(sweep_s=0.1)):
        found = sensed(wall, effects)
        own = found.points[found.instances == 1]
        lengths.append(np.ptp(own[:, 1]))
    assert abs(lengths[1] - lengths[0]) > 0.02


def test_mixed_pixels_lie_between_the_surfaces_and_belong_to_the_mover(wall):
    found = sensed(wall, Effects(divergence_mrad=15.0, pulse_m=3.0))
    mixed = found.kinds == ObjectClass.MOVING_MIXED_PIXEL
    assert mixed.sum() > 5
    assert (found.instances[mixed] == 1).all()
    depth = found.points[mixed, 0]
    assert ((depth > 8.0 - 0.1) & (depth < 9.0)).all()
    apart = sensed(wall, Effects(divergence_mrad=15.0, pulse_m=0.1))
    assert not (apart.kinds == ObjectClass.MOVING_MIXED_PIXEL).any()


def hits(ranges, kinds, instances):
    ranges = np.atleast_2d(np.array(ranges, float))
    kinds, instances = np.atleast_2d(np.uint16(kinds)), np.atleast_2d(np.int32(instances))
    return Hits(
        ranges,
        np.ones(ranges.shape),
        kinds,
        instances,
        np.full(ranges.shape, 0.5),
        np.zeros(ranges.shape, bool),
    )


WALL, CAR = ObjectClass.BUILDING, ObjectClass.MOVING_CAR


@pytest.mark.parametrize(
    ("ranges", "kinds", "expected"),
    [
        ([9, 9, 9, 9, 8.4], [WALL] * 4 + [CAR], ObjectClass.MOVING_MIXED_PIXEL),
        (
            [9, 9, 9, 9, 8.9],
            [WALL] * 4 + [CAR],
            WALL,
        ),  # 2 cm in front of the wall: cannot be told from it
        ([9, 9, 9, 8.4, 8.4], [WALL] * 5, ObjectClass.MIXED_PIXEL),
        (
            [9, 9, 9, 9, 6],
            [WALL] * 4 + [CAR],
            WALL,
        ),  # two separate echoes, of which the wall's is brighter
        ([9, 9, 9, 9, 4], [WALL] * 4 + [CAR], CAR),  # as before, but light from nearby is brighter
        ([9, 4, 4, 4, 4], [WALL] + [CAR] * 4, CAR),
        ([np.inf] * 4 + [4], [0] * 4 + [CAR], CAR),  # a partial hit
    ],
)
def test_the_label_of_a_beam_with_several_surfaces(ranges, kinds, expected):
    found = optics.combine(
        hits(ranges, kinds, [int(kind == CAR) for kind in kinds]), pulse=1.0, washed=0.06
    )
    assert found.kind[0] == expected
    assert (found.instance[0] == 1) == (expected >= CAR)
    seen = np.array(ranges)[np.isfinite(ranges)]
    assert seen.min() <= found.range[0] <= seen.max()


def test_a_beam_that_meets_nothing_returns_nothing():
    assert np.isinf(optics.combine(hits([np.inf] * 5, [0] * 5, [0] * 5), 1.0, 0.06).range[0])


def measured(ranges, facing):
    count = len(ranges)
    return Hits(
        ranges,
        facing,
        np.full(count, WALL, np.uint16),
        np.zeros(count, np.int32),
        np.ones(count),
        np.zeros(count, bool),
    )


def test_noise_grows_with_range_and_incidence():
    effects, rng = Effects(noise_range_m=0.1, noise_incidence_m=0.02), np.random.default_rng(0)
    for distance, facing, expected in (
        (50.0, 1.0, 0.05),
        (100.0, 1.0, 0.1),
        (1e-3, np.sqrt(0.5), 0.02),
    ):
        noise = measurement._noise(
            measured(np.full(20000, distance), np.full(20000, facing)), effects, rng
        )
        assert noise.std() == pytest.approx(expected, rel=0.05)
        assert abs(noise.mean()) < 0.05 * expected


def test_drop_outs_grow_with_range_and_incidence():
    effects, rng = Effects(dropout_range=0.2, dropout_incidence=0.3), np.random.default_rng(0)
    for distance, facing, expected in (
        (50.0, 1.0, 0.1),
        (100.0, 1.0, 0.2),
        (0.0, 0.0, 0.3),
        (100.0, 0.0, 0.44),
    ):
        kept = measurement._kept(
            measured(np.full(40000, distance), np.full(40000, facing)), effects, rng
        )
        assert 1 - kept.mean() == pytest.approx(expected, abs=0.01)


def test_each_beam_has_an_error_of_its_own_that_stays(wall):
    near = [sensed(wall, Effects(beam_deg=0.5), index) for index in (1, 2)]
    plain = sensed(wall, Effects(), 2)
    # beams hit the wall elsewhere than their nominal direction says, so its points leave the plane
    # ring by ring
    flat_wall, bent = (
        np.abs(each.points[each.kinds == WALL, 0] - 9).max() for each in (plain, near[1])
    )
    assert flat_wall < 2e-3
    assert 0.02 < bent < 0.5
    turned = dataclasses.replace(SMALL, azimuth=(-120.0, -60.0))
    rays = measurement.sweep_rays(turned, 0, np.random.default_rng(0))
    tilt = [measurement._beam_errors(rays, turned, Effects(beam_deg=d), 0) for d in (0.0, 0.5, 0.5)]
    np.testing.assert_array_equal(tilt[1], tilt[2])
    error = np.degrees(np.arccos(np.clip((tilt[0] * tilt[1]).sum(1), -1, 1))).reshape(-1, 16)
    np.testing.assert_allclose(error, np.broadcast_to(error[0], error.shape), atol=1e-5)
    assert 0.3 < np.sqrt((error[0] ** 2).mean() / 2) < 0.8


def test_a_retro_reflector_blooms_onto_the_wall_behind_it(wall):
    wall.add(
        quads([[(6, -0.9, 0.8), (6, -1.3, 0.8), (6, -1.3, 1.2), (6, -0.9, 1.2)]]),
        ObjectClass.TRAFFIC_SIGN,
        1.0,
    )
    plain, lit = (sensed(wall, Effects(sweep_s=1e-6, bloom_deg=d)) for d in (0.0, 3.0))
    count = [(each.kinds == ObjectClass.TRAFFIC_SIGN).sum() for each in (plain, lit)]
    assert count[1] > 1.5 * count[0] > 0
    halo = np.linalg.norm(lit.points[lit.kinds == ObjectClass.TRAFFIC_SIGN], axis=1)
    assert np.ptp(halo) < 0.3


def test_multipath_mirrors_static_and_moving_objects_below_the_ground(wall):
    wall.add(
        quads([[(-50, -50, 0), (50, -50, 0), (50, 50, 0), (-50, 50, 0)]]), ObjectClass.ROAD, 0.5
    )
    found = sensed(wall, Effects(multipath=1.0))
    assert {ObjectClass.OUTLIER, ObjectClass.MOVING_OUTLIER} <= set(found.kinds.tolist())
    for kind, moving in ((ObjectClass.OUTLIER, False), (ObjectClass.MOVING_OUTLIER, True)):
        mirrored = found.kinds == kind
        assert (found.points[mirrored, 2] < -SMALL.height + 1e-6).all()
        assert (found.instances[mirrored] > 0).all() == moving
    image = found.points[found.kinds == ObjectClass.OUTLIER]
    assert np.median(image[:, 0]) == pytest.approx(
        9, abs=0.1
    )  # the mirrored wall is straight below the wall


def test_rain_is_denser_near_the_sensor_and_of_its_own_class(wall):
    few, many = (sensed(wall, Effects(rain_per_m3=n)) for n in (5.0, 50.0))
    counts = [(each.kinds == ObjectClass.AIRBORNE).sum() for each in (few, many)]
    assert 4 * counts[0] < counts[1]
    wet = many.kinds == ObjectClass.AIRBORNE
    assert not many.instances[wet].any()
    assert np.linalg.norm(many.points[wet], axis=1).max() < 16


def test_leaves_and_panes_let_their_share_of_rays_pass(wall):
    wall.add(
        quads([[(5, -90, -9), (5, 90, -9), (5, 90, 1.0), (5, -90, 1.0)]]),
        ObjectClass.VEGETATION,
        0.6,
    )
    pane = quads([[(5, -90, 1.0), (5, 90, 1.0), (5, 90, 9), (5, -90, 9)]])
    wall.add(pane, ObjectClass.FENCE, 0.6)
    wall.parts[-1] = dataclasses.replace(wall.parts[-1], glass=True)
    found = sensed(wall, Effects(vegetation_gap=0.3, glass=0.7))
    below = found.points[:, 2] < 0
    behind = found.points[:, 0] > 6
    assert behind[below].mean() == pytest.approx(0.3, abs=0.06)
    assert behind[~below].mean() == pytest.approx(0.7, abs=0.06)


def test_effects_have_random_numbers_of_their_own(wall):
    plain, noisy = (
        sensed(wall, effects)
        for effects in (Effects(sweep_s=1e-6), Effects(sweep_s=1e-6, noise_range_m=0.5))
    )
    assert len(plain.points) == len(noisy.points)  # the same returns, with other ranges only
    np.testing.assert_array_equal(plain.intensity, noisy.intensity)


def test_drift_grows_with_the_distance_and_jitter_does_not():
    effects = Effects(drift_m=0.5, drift_deg=0.0, jitter_m=0.03, jitter_deg=0.1)
    straight = np.tile(np.eye(4), (101, 1, 1))
    straight[:, 0, 3] = np.arange(101.0)
    ends = np.array(
        [
            poses.drift(np.random.default_rng(k), straight, effects)[[25, 100], :3, 3]
            for k in range(60)
        ]
    )
    assert ends[:, 1].std() == pytest.approx(0.5, rel=0.2)
    assert ends[:, 0].std() == pytest.approx(0.25, rel=0.2)
    jitter = poses.jitter(np.random.default_rng(0), 2000, effects)
    assert jitter[:, :3, 3].std() == pytest.approx(0.03, rel=0.05)
    angles = np.degrees(
        np.arccos(np.clip((np.trace(jitter[:, :3, :3], axis1=1, axis2=2) - 1) / 2, -1, 1))
    )
    assert np.sqrt((angles**2).mean() / 3) == pytest.approx(0.1, rel=0.05)
    assert abs(np.corrcoef(jitter[1:, 0, 3], jitter[:-1, 0, 3])[0, 1]) < 0.1
    standing = np.tile(np.eye(4), (9, 1, 1))
    np.testing.assert_array_equal(
        poses.drift(np.random.default_rng(0), standing, effects), standing
    )


def test_the_yaw_of_the_drift_turns_later_positions():
    effects = Effects(drift_deg=1.0)
    straight = np.tile(np.eye(4), (201, 1, 1))
    straight[:, 0, 3] = np.arange(201.0)
    errors = poses.drift(np.random.default_rng(0), straight, effects)
    assert np.abs(errors[-1, 1:3, 3]).max() > 0.3  # metres aside, from rotation alone


@pytest.mark.parametrize("preset", ["street_vlp16", "square_mid360", "hall_vlp16"])
def test_behaviour_adds_movers_near_the_sensor_and_leaves_the_others_alone(preset):
    plain = PRESETS[preset]
    scene = build(plain, 60)
    acted = build(dataclasses.replace(plain, effects=Effects(**dict.fromkeys(BEHAVIOUR, 1))), 60)
    added = acted.movers[len(scene.movers) :]
    kinds = [mover.kind for mover in added]
    assert (
        kinds.count(ObjectClass.MOVING_PERSON) >= 9
    )  # one brushes, six and one in a crowd, one pushes, one sits down
    assert {
        ObjectClass.MOVING_DOOR,
        ObjectClass.MOVING_ANIMAL,
        ObjectClass.MOVING_OTHER_VEHICLE,
    } <= set(kinds)
    assert len(kinds) >= 13
    assert [m.reflectance for m in acted.movers[: len(scene.movers)]] == [
        m.reflectance for m in scene.movers
    ]
    assert [m.instance for m in acted.movers] == list(range(1, len(acted.movers) + 1))
    for mover in added:
        schedule = [mover.motion.schedule(t) for t in np.arange(0, 6, 0.1)]
        assert any(mover.motion.pose(t, acted.height) is not None for t in np.arange(0, 6, 0.5))
        assert np.ptp(schedule) > 0.5


def test_walkers_brush_along_walls_at_the_given_distance():
    preset = dataclasses.replace(PRESETS["hall_vlp16"], effects=Effects(brushing=6))
    scene = build(preset, 60)
    obstacles = scene.places.obstacles
    walkers = scene.movers[-6:]
    assert len(obstacles) == 14
    for mover in walkers:
        x, y = mover.motion.path.xy.T
        wall = np.minimum(24.0 - np.abs(x), 13.0 - np.abs(y))
        pillar = np.min(
            [np.maximum(np.abs(x - ox), np.abs(y - oy)) - 0.4 for ox, oy, *_ in obstacles], axis=0
        )
        gap = np.minimum(wall, pillar) - 0.31
        assert np.median(gap) == pytest.approx(0.2, abs=0.06)


def test_a_real_preset_gives_the_same_sweep_in_any_order():
    chosen = Chosen.parse("street_vlp16_real?frames=4")
    scene = build(chosen.preset, 4, 0)
    first, again = (
        SceneRecorder(scene, chosen.preset, 4),
        SceneRecorder(build(chosen.preset, 4, 0), chosen.preset, 4),
    )
    forward, backward = [first.sweep(k) for k in (1, 3)], [again.sweep(k) for k in (3, 1)]
    for a, b in zip(forward, backward[::-1], strict=True):
        np.testing.assert_array_equal(a.points, b.points)
        np.testing.assert_array_equal(a.kinds, b.kinds)
        np.testing.assert_array_equal(a.T_world_sensor, b.T_world_sensor)
        moving = a.kinds >= ObjectClass.MOVING_CAR
        np.testing.assert_array_equal(a.labels == 1, moving)
        assert (a.instances[moving] > 0).all()


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("nowhere", "unknown scene 'nowhere'"),
        ("demo?jiter_m=1", r"unknown option 'jiter_m=1'. Did you mean 'jitter_m'"),
        ("demo?jitter_m", "unknown option 'jitter_m'"),
        ("demo?jitter_m=much", "jitter_m = 'much': give a number"),
        ("demo?brushing=1.5", r"brushing = '1.5': give a whole number"),
        ("demo?jitter_m=-1", "jitter_m = -1.0: give 0 to 10"),
        ("demo?jitter_m=nan", "jitter_m = nan"),
        ("demo?frames=0", "at least one frame"),
        ("demo?frames=2&frames=3", "frames is given twice"),
    ],
)
def test_wrong_options_are_explained(text, problem):
    with pytest.raises(UsageError, match=problem):
        Chosen.parse(text)
