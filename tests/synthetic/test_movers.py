from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynaviz.synthetic.simulate import PRESETS
from dynaviz.synthetic.simulate.movers import Movement, Route, arrive, cruise, depart
from dynaviz.synthetic.simulate.parallel import build


def flat(x, y):
    return np.zeros(np.broadcast(x, y).shape)


def slope(x, y):
    return 0.1 * x


@given(st.floats(-50, 50), st.floats(0.5, 15), st.floats(0, 20))
def test_schedules_are_monotonic_and_stand_where_they_should(place, speed, time):
    times = np.linspace(-5, 30, 200)
    leaving, coming = depart(place, speed, time), arrive(place, speed, time)
    for schedule in (leaving, coming, cruise(place, speed)):
        steps = np.diff([schedule(t) for t in times])
        assert (steps >= 0).all()
        assert steps.max() <= speed * (times[1] - times[0]) + 1e-9
    assert leaving(time - 1) == leaving(time) == coming(time) == coming(time + 9) == place
    assert leaving(time + 1) > place > coming(time - 1)


def test_a_route_has_its_length_and_cuts_corners():
    corner = Route([(0, 0), (10, 0), (10, 10)], rounds=4)
    assert corner.xy[0] == pytest.approx((0, 0))
    assert corner.xy[-1] == pytest.approx((10, 10))
    assert 10 * np.sqrt(2) < corner.length < 20
    assert np.abs(np.diff(corner.yaw)).max() < 0.35


@given(st.floats(-3, 3))
def test_a_parallel_of_a_circle_is_a_circle(left):
    around = np.linspace(0, np.pi, 400)
    circle = Route(20 * np.column_stack([np.cos(around), np.sin(around)]))
    parallel = circle.shifted(left)
    np.testing.assert_allclose(np.hypot(*parallel.xy[1:-1].T), 20 - left, atol=1e-3)


def test_a_motion_has_no_pose_beyond_its_route():
    motion = Movement(Route([(0, 0), (10, 0)]), cruise(-5, 1))
    assert motion.pose(4, flat) is None
    assert motion.pose(16, flat) is None
    pose = motion.pose(10, flat)
    assert pose is not None
    np.testing.assert_allclose(
        pose, [[1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], atol=1e-12
    )


@pytest.mark.parametrize("upright", [True, False])
def test_vehicles_follow_the_slope_and_people_stay_upright(upright):
    pose = Movement(Route([(0, 0), (10, 10)]), cruise(5, 1), upright).pose(0, slope)
    assert pose is not None
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)
    up = (0, 0, 1) if upright else np.array([-0.1, 0, 1]) / np.sqrt(1.01)
    np.testing.assert_allclose(pose[:3, 2], up, atol=1e-12)
    assert pose[2, 3] == pytest.approx(0.1 * pose[0, 3])


@pytest.mark.parametrize("frames", [50, 130, 200])
@pytest.mark.parametrize("preset", ["street_hdl64", "street_vlp16"])
def test_no_vehicle_drives_through_the_sensor(preset, frames):
    scene = build(PRESETS[preset], frames, 3)
    for time in np.arange(0.0, scene.duration, 0.2):
        here = scene.sensor.pose(time, scene.height)[:2, 3]
        poses = [mover.motion.pose(time, scene.height) for mover in scene.movers]
        assert min(np.hypot(*(pose[:2, 3] - here)) for pose in poses if pose is not None) > 1.5
