"""Odometries on sweeps that are measured while the sensor moves."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dynaviz.arrays import F64
from dynaviz.contracts import registry
from dynaviz.contracts.scan import Scan
from dynaviz.io.poses import read_poses
from dynaviz.sources.odometry.estimate import Odometry, estimate
from dynaviz.sources.odometry.kiss_icp import KissIcp
from dynaviz.sources.odometry.small_gicp import SmallGicp
from dynaviz.spatial import geometry
from dynaviz.spatial.motion import deskewed_to_middle
from dynaviz.testing.world import InMemory, crossing

STEP = np.array([0.8, 0.1, 0.0])  # metres in a sweep
LASTS = 0.1  # seconds


def test_points_of_a_moving_sensor_meet_in_the_middle_of_the_sweep() -> None:
    """Every point is the same place, measured from another position of a sensor that drives and
    turns.
    """
    motion = geometry.pose(STEP, [np.cos(0.02), 0.0, 0.0, np.sin(0.02)])
    times = np.linspace(0.0, LASTS, 51)
    place = np.array([5.0, -2.0, 1.0])
    half = geometry.pose(STEP / 2, [np.cos(0.01), 0.0, 0.0, np.sin(0.01)])
    seen = np.array(
        [geometry.apply(geometry.inverse(_at(share)), place[None])[0] for share in times / LASTS]
    )
    found = deskewed_to_middle(seen, times + 7.0, motion)
    np.testing.assert_allclose(
        found, np.tile(geometry.apply(geometry.inverse(half), place[None]), (51, 1)), atol=1e-5
    )
    np.testing.assert_array_equal(deskewed_to_middle(seen, np.full(51, 3.0), motion), seen)


def _at(share: float) -> F64:
    return geometry.pose(share * STEP, [np.cos(0.02 * share), 0.0, 0.0, np.sin(0.02 * share)])


@pytest.mark.parametrize(
    ("kind", "module", "tolerance"), [(KissIcp, "kiss_icp", 0.08), (SmallGicp, "small_gicp", 0.05)]
)
def test_the_first_sweeps_of_a_moving_sensor_do_not_displace_the_later_ones(
    kind: type[Odometry], module: str, tolerance: float
) -> None:
    """The speed is unknown in the first sweeps; their map must fit the sweeps that are deskewed."""
    pytest.importorskip(module)
    scan = crossing(1)[0]
    world, start = scan.points.astype(np.float64), scan.T_world_sensor
    shares = (np.arctan2(*(world - start[:3, 3])[:, 1::-1].T) / (2 * np.pi) + 0.5).round(3)
    odometry, found = kind(20.0), []
    for frame in range(6):
        way = start[:3, 3] + (frame + shares)[:, None] * STEP
        points = (world - way) @ start[:3, :3]
        found.append(odometry.register(points, shares * LASTS))
    poses = np.array(found)
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    np.testing.assert_allclose(steps, np.linalg.norm(STEP), atol=tolerance)
    np.testing.assert_allclose(
        poses[:, :3, :3] @ np.swapaxes(poses[:, :3, :3], 1, 2), [np.eye(3)] * 6, atol=1e-12
    )
    assert kind.reference == 0.5


def bumpy(seconds: F64) -> F64:
    """(N, 4, 4) poses of a vehicle that pitches by 2.5 degrees within eight sweeps."""
    T = np.tile(np.eye(4), (len(seconds), 1, 1))
    T[:, 0, 3] = 8.0 * seconds
    pitch = np.radians(2.5) * np.sin(2 * np.pi * seconds / 0.8)
    T[:, :3, :3] = Rotation.from_rotvec(pitch[:, None] * [0.0, 1.0, 0.0]).as_matrix()
    return T


class Recorder:
    """An odometry that knows the true poses, and keeps what it is given."""

    reference: ClassVar[float] = 0.5
    package: ClassVar[str] = "numpy"
    given: ClassVar[list[tuple[F64, F64 | None]]] = []

    def __init__(self, reach: float) -> None:
        self._sweeps = 0

    def register(self, points: F64, times: F64 | None) -> F64:
        self.given.append((points, times))
        self._sweeps += 1
        return bumpy(np.array([(self._sweeps - 0.5) * LASTS]))[0]


def test_the_second_pass_deskews_with_the_motion_that_the_first_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Straight lines between the poses of sweeps would displace these points by 7 cm.

    The table follows the motion.
    """
    monkeypatch.setattr(registry, "load", lambda kind, name: Recorder)
    monkeypatch.setattr(Recorder, "given", [])
    world = np.random.default_rng(0).normal(0, 20, (400, 3))
    shares, start = np.linspace(0, 1, 400), 1_700_000_000_000_000_000
    sweeps = []
    for k in range(12):
        seen = geometry.inverse(bumpy((k + shares) * LASTS))
        points = np.einsum("nij,nj->ni", seen[:, :3, :3], world) + seen[:, :3, 3]
        stamp = start + round(k * LASTS * 1e9)
        sweeps.append(
            Scan(
                k,
                points.astype(np.float32),
                np.eye(4),
                stamp,
                times=(shares * LASTS).astype(np.float32),
            )
        )
    found = estimate("any", InMemory(sweeps), tmp_path, raw=True)
    assert found.deskewed
    assert [times is None for _, times in Recorder.given] == [False] * 12 + [True] * 12
    for k in range(2, 10):  # the ends of a trajectory are extrapolated
        middle = geometry.inverse(bumpy(np.array([(k + 0.5) * LASTS]))[0])
        np.testing.assert_allclose(
            Recorder.given[12 + k][0], geometry.apply(middle, world), atol=0.02
        )
    table = read_poses(found.file)
    assert table.stamps is not None
    seconds = (table.stamps - start) / 1e9
    inside = (seconds > 0.2) & (seconds < 1.0)
    assert inside.sum() > 30
    np.testing.assert_allclose(table.poses[inside], bumpy(seconds[inside]), atol=1e-3)
