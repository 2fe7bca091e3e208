from __future__ import annotations

import numpy as np
import pytest

from dynaviz.contracts.sensors import load_sensor, sensor_names
from dynaviz.synthetic.simulate.classes import ObjectClass
from dynaviz.synthetic.simulate.lidar import Hits, RayScene, mounts, receive, sweep_rays
from dynaviz.synthetic.simulate.movers import Movement, Route, cruise
from dynaviz.synthetic.simulate.scene import SimulatedScene
from dynaviz.synthetic.simulate.shapes import box, quads


def flat(x, y):
    return np.zeros(np.broadcast(x, y).shape)


def angles(directions):
    return np.degrees(np.arctan2(directions[:, 1], directions[:, 0])), np.degrees(
        np.arcsin(directions[:, 2])
    )


@pytest.mark.parametrize("name", sensor_names())
def test_rays_stay_in_the_field_of_view_and_fill_it(name):
    sensor = load_sensor(name)
    rays = sweep_rays(sensor, 3, np.random.default_rng(0))
    np.testing.assert_allclose(np.linalg.norm(rays.directions, axis=1), 1, atol=1e-12)
    for number, T in enumerate(mounts(sensor)):
        own = rays.lidar == number
        azimuth, elevation = angles(rays.directions[own] @ T[:3, :3])
        low, high = sensor.elevation
        assert low - 1e-6 <= elevation.min() < low + 0.6
        assert high - 0.6 < elevation.max() <= high + 1e-6
        assert np.histogram(azimuth, 36, sensor.azimuth)[0].min() > 0.02 * own.sum()
        np.testing.assert_array_equal(rays.origins[own], np.broadcast_to(T[:3, 3], (own.sum(), 3)))
        if sensor.rings:
            assert len(np.unique(elevation.round(3))) == sensor.rings
        else:
            assert own.sum() == sensor.points_per_sweep


def test_the_lower_lidar_of_the_pair_is_upside_down():
    upper, lower = mounts(load_sensor("vlp32c_pair"))
    assert upper[2, 2] == 1
    assert lower[2, 2] == pytest.approx(-1)
    assert lower[2, 3] < upper[2, 3]


def test_a_pattern_without_rings_does_not_repeat():
    sensor = load_sensor("mid360")
    sweeps = [sweep_rays(sensor, k, np.random.default_rng(0)).directions for k in range(4)]
    azimuth, elevation = angles(np.concatenate(sweeps))
    cells = [
        len(np.unique(np.floor(azimuth[:n] * 2) * 1000 + np.floor(elevation[:n] * 2)))
        for n in (20000, 80000)
    ]
    assert cells[1] > 1.5 * cells[0]


def scene_with_a_wall_and_a_mover():
    scene = SimulatedScene(
        np.random.default_rng(0), 1.0, flat, Movement(Route([(0, 0), (9, 0)]), cruise(0, 1))
    )
    scene.add(
        quads([[(10, -50, -9), (10, 50, -9), (10, 50, 9), (10, -50, 9)]]), ObjectClass.BUILDING, 0.8
    )
    scene.move(ObjectClass.MOVING_CAR, Route([(5, -4), (5, 4)]), cruise(0, 4), box(2, 2, 2))
    return scene


def test_the_nearer_of_mover_and_background_is_hit():
    ray_scene, sensor = RayScene(scene_with_a_wall_and_a_mover()), load_sensor("vlp16")
    rays = sweep_rays(sensor, 0, np.random.default_rng(0))
    T = np.eye(4)
    T[2, 3] = 1.0
    for time, middle in ((0.5, -2.0), (1.0, 0.0), (1.5, 2.0)):
        hits = ray_scene.cast(rays, T, time)
        points = rays.directions * hits.range[:, None]
        mover, wall = hits.kind == ObjectClass.MOVING_CAR, hits.kind == ObjectClass.BUILDING
        assert mover.any()
        np.testing.assert_allclose(points[wall][:, 0], 10, atol=1e-3)
        assert (np.abs(points[mover] - (5, middle, 0)).max(1) < 1.001).all()
        assert np.isinf(hits.range[~(mover | wall)]).all()
        assert set(hits.instance[mover]) == {1}
        assert not hits.instance[~mover].any()
    gone = ray_scene.cast(rays, T, 3.0)
    assert ObjectClass.MOVING_CAR not in gone.kind


def hits_of(count, range_, reflectance=0.8, facing=1.0, kind=ObjectClass.BUILDING):
    full = np.full(count, 1.0)
    kinds, instances = np.full(count, kind, np.uint16), np.zeros(count, np.int32)
    return Hits(
        range_ * full,
        facing * full,
        kinds,
        instances,
        reflectance * full,
        np.zeros(count, np.bool_),
    )


def test_ranges_have_the_sensors_noise_and_limits():
    sensor = load_sensor("hdl64e")
    distance, back, kinds, intensity = receive(
        hits_of(20000, 20.0), sensor, np.random.default_rng(0)
    )
    assert 0.9 < back.mean() < 1
    assert (distance[back] - 20).std() == pytest.approx(sensor.range_noise, rel=0.05)
    assert abs((distance[back] - 20).mean()) < 0.001
    assert (kinds == ObjectClass.BUILDING).all()
    assert intensity.min() >= 0
    assert intensity.max() <= 1
    for limit in (0.5 * sensor.min_range, 1.2 * sensor.max_range, np.inf):
        assert not receive(hits_of(1000, limit), sensor, np.random.default_rng(0))[1].any()


def test_dark_and_grazed_surfaces_return_less_at_long_range():
    sensor, rng = load_sensor("hdl64e"), np.random.default_rng(0)
    bright, dark, grazed = (
        receive(hits_of(5000, 60.0, reflectance, facing), sensor, rng)[1].mean()
        for reflectance, facing in ((0.8, 1.0), (0.1, 1.0), (0.35, 0.01))
    )
    assert bright > 0.9
    assert dark < 0.05
    assert grazed < 0.3


def test_multipath_returns_are_rare_too_far_and_marked():
    sensor = load_sensor("hdl64e")
    distance, _, kinds, _ = receive(
        hits_of(100000, 20.0, kind=ObjectClass.ROAD), sensor, np.random.default_rng(0)
    )
    detour = kinds == ObjectClass.OUTLIER
    assert 0 < detour.mean() < 0.001
    assert distance[detour].min() > 22.5
    assert (kinds[~detour] == ObjectClass.ROAD).all()
