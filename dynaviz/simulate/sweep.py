"""Ray casting while sensor and movers move during the sweep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F32, F64, I64, Bool
from dynaviz.sensors import Sensor
from dynaviz.simulate.lidar import Bodies, Hits, Rays, RayScene, Surfaces
from dynaviz.simulate.movers import Mover
from dynaviz.simulate.scene import SimulatedScene
from dynaviz.simulate.shapes import Mesh

TICKS = 256  # poses of the sensor per sweep: at 10 m/s and 10 Hz it moves 4 mm between two
KNOTS = 9  # of these, evenly spaced, the others follow by linear interpolation
SLICES = 16  # places of the movers per sweep: at 10 m/s and 10 Hz they move 6 cm between two


@dataclass(frozen=True, eq=False)
class TimedRays:
    """The rays of a sweep in the scene frame.

    Attributes:
        origins: (N, 3) float64, metres.
        directions: (N, 3) float64, unit length: true directions, with the errors of the beams.
        slices: (N,) int64: time slice of each ray.
    """

    origins: F64
    directions: F64
    slices: I64

    def __getitem__(self, chosen: I64 | Bool) -> TimedRays:
        return TimedRays(self.origins[chosen], self.directions[chosen], self.slices[chosen])

    def continued(self, distance: F64, directions: F64) -> TimedRays:
        """Rays that start after (N,) metres along these, into other directions."""
        return TimedRays(self.origins + self.directions * distance[:, None], directions, self.slices)


def ray_shares(rays: Rays) -> F64:
    """(N,) float64, 0 to 1: when during the sweep each ray is fired; every lidar fires its rays in order."""
    shares = np.empty(len(rays.lidar))
    for number in np.unique(rays.lidar):
        own = np.flatnonzero(rays.lidar == number)
        shares[own] = np.arange(len(own)) / len(own)
    return shares


class MovingSweep:
    """The scene during one sweep.

    Args:
        ray_scene: the scene prepared for ray casting.
        time: middle of the sweep, seconds.
        duration: of the sweep, seconds; 0 freezes the scene.
    """

    def __init__(self, ray_scene: RayScene, time: float, duration: float):
        self._static, scene = ray_scene.static, ray_scene.scene
        self.slices = SLICES if duration else 1
        self._moving = _slices(scene, time, duration, self.slices, ray_scene.bodies)

    def cast(self, rays: TimedRays) -> Hits:
        """Nearest surface along each ray at its time."""
        packed: F32 = np.concatenate([rays.origins, rays.directions], axis=1).astype(np.float32)
        hits = self._static.cast(packed)
        for number, surfaces in enumerate(self._moving):
            own = np.flatnonzero(rays.slices == number)
            if surfaces is None or not len(own):
                continue
            moving = surfaces.cast(packed[own])
            nearer = np.flatnonzero(moving.range < hits.range[own])
            for name in Hits.__dataclass_fields__:
                getattr(hits, name)[own[nearer]] = getattr(moving, name)[nearer]
        return hits


def _slices(scene: SimulatedScene, middle: float, duration: float, count: int, bodies: Bodies) -> list[Surfaces | None]:
    """The movers in each time slice, on a line between their places at the ends, in the posture of the middle."""
    present = []
    for mover in scene.movers:
        now, *ends = (mover.motion.pose(middle + side * duration / 2, scene.height) for side in (0, -1, 1))
        if now is not None:
            body = _body(mover, mover.motion.schedule(middle), bodies)
            first, last = (body.transformed(now if T is None else T) for T in ends)
            present.append((mover, first, last.vertices - first.vertices))
    if not present:
        return [None] * count
    owners, shares = [mover for mover, _, _ in present], (np.arange(count) + 0.5) / count
    return [Surfaces(owners, [Mesh(m.vertices + u * way, m.triangles) for _, m, way in present]) for u in shares]


def _body(mover: Mover, distance: float, bodies: Bodies) -> Mesh:
    """The mover's body; that of a mover who waits is built once."""
    known = bodies.get(mover.instance)
    if known is None or known[0] != distance:
        known = bodies[mover.instance] = (distance, mover.body(distance))
    return known[1]


def sensor_poses(scene: SimulatedScene, sensor: Sensor, time: float, duration: float, shares: F64) -> tuple[F64, I64]:
    """Poses of the sensor during a sweep.

    Args:
        scene: gives the motion.
        sensor: gives its height above the ground.
        time: middle of the sweep, seconds.
        duration: of the sweep, seconds.
        shares: (N,) float64, 0 to 1: when each ray is fired.

    Returns:
        (T, 4, 4) float64 T_scene_sensor at each tick; (N,) int64 tick of each ray.
    """
    if not duration:
        return sensor_pose(scene, sensor, time)[None], np.zeros(len(shares), np.int64)
    knots = np.stack([sensor_pose(scene, sensor, float(t)) for t in time + duration * np.linspace(-0.5, 0.5, KNOTS)])
    at = (np.arange(TICKS) + 0.5) / TICKS * (KNOTS - 1)
    before = at.astype(np.int64)
    share = (at - before)[:, None, None]
    poses: F64 = (1 - share) * knots[before] + share * knots[before + 1]  # turns of less than a milliradian
    return poses, (shares * TICKS).astype(np.int64)


def sensor_pose(scene: SimulatedScene, sensor: Sensor, time: float) -> F64:
    """T_scene_sensor (4, 4) float64, metres."""
    T = scene.sensor.pose(time, scene.height)
    assert T is not None  # checked by SimulatedScene
    T[:3, 3] += T[:3, 2] * (sensor.height or 0.0)
    return T


def by_tick(poses: F64, ticks: I64, points: F64, *, turn_only: bool = False) -> F64:
    """Transform (N, 3) points by the pose of each one's tick, one coordinate at a time."""
    out = np.empty((len(points), 3))
    for axis in range(3):
        a, b, c, d = (poses[:, axis, column][ticks] for column in range(4))
        out[:, axis] = a * points[:, 0] + b * points[:, 1] + c * points[:, 2] + (0.0 if turn_only else d)
    return out
