"""What is measured on the scans: noise, drop-outs, and the rays that have no return."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynaviz.arrays import F64, Bool
from dynaviz.contracts.scan import Label, Scan
from dynaviz.contracts.sensors import Sensor, load_sensor
from dynaviz.synthetic.implants.cast import Target, cast, implant
from dynaviz.synthetic.implants.implant_scene import Implant, ImplantScene
from dynaviz.synthetic.implants.lidar_model import LidarModel
from dynaviz.synthetic.implants.pattern import Pattern, find_beams
from dynaviz.synthetic.simulate.lidar import sweep_rays
from dynaviz.testing import InMemory

SENSOR = load_sensor("vlp16")
HEIGHT, WALL, FARTHEST = 2.0, 25.0, 90.0  # metres


def reach_of(directions: F64) -> F64:
    """Metres to the ground or the wall."""
    with np.errstate(divide="ignore"):
        ground = np.where(directions[:, 2] < 0, -HEIGHT / directions[:, 2], np.inf)
        wall = np.where(directions[:, 1] > 0.05, WALL / directions[:, 1], np.inf)
    return np.minimum(ground, wall)


def scan_of(
    directions: F64, kept: Bool, index: int = 0, noise: float = 0.0, origins: F64 | None = None
) -> Scan:
    """A flat plain with a high wall on the left half of the horizon.

    Rays to the sky do not return.
    """
    rng = np.random.default_rng(index)
    reach = reach_of(directions) + rng.normal(0, noise, len(directions))
    rows = kept & (reach < FARTHEST)
    points = directions[rows] * reach[rows, None]
    starts = None
    if origins is not None:
        points, starts = points + origins[rows], origins[rows]
    T = np.eye(4)
    T[2, 3] = HEIGHT
    up = np.array([0, 0, HEIGHT])
    labels = np.zeros(rows.sum(), np.uint8)
    return Scan(
        index,
        (points + up).astype(np.float32),
        T,
        labels=labels,
        origins=None if starts is None else starts + up,
    )


def plain(
    frames: int = 3, lost: float = 0.0, noise: float = 0.0, ring_by_ring: bool = False
) -> tuple[InMemory, F64]:
    """Scans of a VLP-16 on the plain, and the directions of its rays in the first."""
    scans, first = [], None
    for index in range(frames):
        rng = np.random.default_rng([7, index])
        directions = sweep_rays(SENSOR, index, rng).directions
        if ring_by_ring:
            directions = directions.reshape(-1, 16, 3).swapaxes(0, 1).reshape(-1, 3)
        first = directions if first is None else first
        scans.append(scan_of(directions, rng.random(len(directions)) >= lost, index, noise))
    assert first is not None
    return InMemory(scans, "plain", SENSOR), first


def truck_on_the_right() -> ImplantScene:
    """A truck 12 m to the right, where the upper rays see only sky."""
    mover = Implant(
        "truck", 5, 1, np.array([[-50.0, -12, 0], [50, -12, 0]]), np.array([[-10.0, 0], [10, 100]])
    )
    return ImplantScene(0, 0.0, 0.0, True, (mover,))


@pytest.mark.parametrize("ring_by_ring", [False, True])
def test_rays_before_the_sky_are_found(ring_by_ring: bool) -> None:
    sequence, directions = plain(ring_by_ring=ring_by_ring)
    lidar = LidarModel.measure(sequence)
    assert lidar.sky_rays
    found, limits, before = lidar.missing_rays(sequence[0])
    sky = directions[(directions[:, 2] > -0.05) & (reach_of(directions) >= FARTHEST)]
    rows = np.isinf(limits)
    assert rows.sum() == pytest.approx(len(sky), rel=0.05)
    nearest = (found[rows] @ sky.T).max(1)
    assert np.degrees(np.arccos(np.clip(nearest, -1, 1))).max() < 0.11  # half a step
    towards = sequence[0].points[before] - (0, 0, HEIGHT)
    level = np.degrees(np.arctan2(towards[:, 2], np.hypot(*towards[:, :2].T)))
    assert (
        np.abs(level - np.degrees(np.arcsin(found[:, 2]))).max() < 0.2
    )  # a point of the same ring


@pytest.mark.parametrize("ring_by_ring", [False, True])
def test_a_mover_before_the_sky_is_seen_in_full(ring_by_ring: bool) -> None:
    sequence, directions = plain(ring_by_ring=ring_by_ring)
    lidar, scene, scan = LidarModel.measure(sequence), truck_on_the_right(), sequence[0]
    mesh = scene.movers[0].mesh(0.0)
    assert mesh is not None
    starts = np.broadcast_to([0.0, 0, HEIGHT], directions.shape)
    resting = [Target(mesh, 1, 5, np.zeros(3))]
    expected = (
        cast(
            resting, starts, directions, np.full(len(directions), 90.0), np.zeros(len(directions))
        ).mover
        >= 0
    )
    seen = implant(scan, scene, lidar)
    assert (seen.instances == 5).sum() == pytest.approx(expected.sum(), rel=0.03)
    assert seen.points[seen.instances == 5][:, 2].max() > 3.5
    blind = implant(scan, replace(scene, sky_rays=False), lidar)
    assert blind.points[blind.instances == 5][:, 2].max() < 2.05  # only rays to the ground


def test_a_lost_return_of_a_near_surface_does_not_show_what_is_behind() -> None:
    sequence, _ = plain(lost=0.05)
    lidar = LidarModel.measure(sequence)
    behind = Implant(
        "car", 5, 1, np.array([[-20.0, 40, 0], [20, 40, 0]]), np.array([[-10.0, 0], [10, 40]])
    )
    seen = implant(sequence[0], ImplantScene(0, 0.0, 0.0, True, (behind,)), lidar)
    assert not (seen.labels == Label.DYNAMIC).any()


def test_a_sensor_without_rings_is_not_regular() -> None:
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(20_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    sequence = InMemory([scan_of(directions, np.ones(len(directions), bool))], "dome", Sensor())
    lidar = LidarModel.measure(sequence)
    assert not lidar.sky_rays
    assert [len(found) for found in lidar.missing_rays(sequence[0])] == [0, 0, 0]


@pytest.mark.parametrize(("noise", "lost"), [(0.01, 0.0), (0.03, 0.08)])
def test_noise_and_drop_outs_are_measured(noise: float, lost: float) -> None:
    lidar = LidarModel.measure(plain(noise=noise, lost=lost)[0])
    assert lidar.range_noise == pytest.approx(noise, rel=0.25)
    assert lidar.drop_out == pytest.approx(lost, abs=0.012)
    assert lidar.min_range == SENSOR.min_range
    assert 80 < lidar.max_range < 90.5


def test_each_ray_starts_at_its_own_origin() -> None:
    """A mover right in front of one of two lidars hides the other's points only where its rays
    pass.
    """
    rng = np.random.default_rng(1)
    directions = sweep_rays(SENSOR, 0, rng).directions
    starts = np.where(
        np.arange(len(directions))[:, None] % 2 == 0, (0.0, 0.0, 0.0), (6.0, 0.0, 0.0)
    )
    scan = scan_of(directions, np.ones(len(directions), bool), origins=starts)
    lidar = LidarModel.measure(InMemory([scan], "two", Sensor()))
    mover = Implant(
        "person", 5, 1, np.array([[0.0, -2, 0], [0, -3, 0]]), np.array([[-1.0, 0], [1, 0]])
    )
    scene = ImplantScene(0, 0.0, 0.0, False, (mover,))
    seen = implant(scan, scene, lidar)
    assert len(seen.origins) == len(seen)
    rows = seen.instances == 5
    assert (seen.origins[rows, 0] == 0).any()
    mesh = mover.mesh(0.0)
    assert mesh is not None
    for x in (0.0, 6.0):
        own = scan.origins[:, 0] == x
        away = scan.points[own] - scan.origins[own]
        far = np.linalg.norm(away, axis=1)
        hits = (
            cast(
                [Target(mesh, 1, 5, np.zeros(3))],
                scan.origins[own],
                away / far[:, None],
                far,
                0 * far,
            ).mover
            >= 0
        )
        assert (rows & (seen.origins[:, 0] == x)).sum() == pytest.approx(hits.sum(), abs=2)


def test_points_that_are_not_finite_stay() -> None:
    sequence, _ = plain()
    scan = sequence[0]
    points = scan.points.copy()
    points[::50] = np.nan
    scan = replace(scan, points=points)
    seen = implant(
        scan, truck_on_the_right(), LidarModel.measure(InMemory([scan], "holes", SENSOR))
    )
    assert np.isnan(seen.points).all(1).sum() == len(points[::50])


def test_too_few_points_have_no_pattern() -> None:
    assert find_beams(np.zeros(5)) is None
    assert Pattern.infer([np.zeros((0, 3))]) is None
    assert Pattern.infer([np.ones((3, 3))]) is None
