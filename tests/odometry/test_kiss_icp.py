"""KISS-ICP on sweeps that are measured while the sensor moves."""

from __future__ import annotations

import numpy as np
import pytest

from dynaviz.arrays import F64
from dynaviz.odometry.kiss_icp import KissIcp, deskewed_to_middle
from dynaviz.spatial import geometry
from dynaviz.testing.world import crossing

STEP = np.array([0.8, 0.1, 0.0])  # metres in a sweep
LASTS = 0.1  # seconds


def test_points_of_a_moving_sensor_meet_in_the_middle_of_the_sweep() -> None:
    """Every point is the same place, measured from another position of a sensor that drives and turns."""
    motion = geometry.pose(STEP, [np.cos(0.02), 0.0, 0.0, np.sin(0.02)])
    times = np.linspace(0.0, LASTS, 51)
    place = np.array([5.0, -2.0, 1.0])
    half = geometry.pose(STEP / 2, [np.cos(0.01), 0.0, 0.0, np.sin(0.01)])
    seen = np.array([geometry.apply(geometry.inverse(_at(share)), place[None])[0] for share in times / LASTS])
    found = deskewed_to_middle(seen, times + 7.0, motion)
    np.testing.assert_allclose(found, np.tile(geometry.apply(geometry.inverse(half), place[None]), (51, 1)), atol=1e-5)
    np.testing.assert_array_equal(deskewed_to_middle(seen, np.full(51, 3.0), motion), seen)


def _at(share: float) -> F64:
    return geometry.pose(share * STEP, [np.cos(0.02 * share), 0.0, 0.0, np.sin(0.02 * share)])


def test_the_first_sweeps_of_a_moving_sensor_do_not_displace_the_later_ones() -> None:
    """The speed is unknown in the first sweeps; their map must fit the sweeps that are deskewed."""
    pytest.importorskip("kiss_icp")
    scan = crossing(1)[0]
    world, start = scan.points.astype(np.float64), scan.T_world_sensor
    shares = (np.arctan2(*(world - start[:3, 3])[:, 1::-1].T) / (2 * np.pi) + 0.5).round(3)
    odometry, found = KissIcp(20.0), []
    for frame in range(6):
        way = start[:3, 3] + (frame + shares)[:, None] * STEP
        points = (world - way) @ start[:3, :3]
        found.append(odometry.register(points, shares * LASTS))
    steps = np.linalg.norm(np.diff(np.array(found)[:, :3, 3], axis=0), axis=1)
    np.testing.assert_allclose(steps, np.linalg.norm(STEP), atol=0.08)
    assert KissIcp.reference == 0.5
