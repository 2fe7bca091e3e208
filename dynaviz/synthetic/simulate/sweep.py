"""Ray casting while sensor and movers move during the sweep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F32, F64, I64, Bool
from dynaviz.contracts.sensors import Sensor
from dynaviz.synthetic.simulate.lidar import Bodies, Hits, Rays, RayScene, Surfaces
from dynaviz.synthetic.simulate.movers import Mover
from dynaviz.synthetic.simulate.scene import SimulatedScene
from dynaviz.synthetic.simulate.shapes import Mesh

TICKS = 256  # poses of the sensor per sweep: at 10 m/s and 10 Hz it moves 4 mm between two
KNOTS = 9  # of these, evenly spaced, the others follow by linear interpolation
SECTORS = 360  # of azimuth
# radians of azimuth between the rays of one beam: 10 mrad up to an elevation of 70 degrees
WIDEST = 0.03
HEIGHT = 1.5  # metres above the ground, of a sensor whose file does not state it
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
        return TimedRays(
            self.origins + self.directions * distance[:, None], directions, self.slices
        )


def ray_shares(rays: Rays) -> F64:
    """(N,) float64, 0 to 1: when during the sweep each ray is fired.

    Every lidar fires its rays in order.
    """
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
        rays: the rays of the sensor. ``cast`` accepts these, other rays of the same beams, and rays
            that continue them after a reflection from the ground: time slices in which none of them
            can meet a mover are left out.
    """

    def __init__(self, ray_scene: RayScene, time: float, duration: float, rays: TimedRays):
        self._static = ray_scene.static
        self._moving = _slices(ray_scene.scene, time, duration, rays, ray_scene.bodies)

    def cast(self, rays: TimedRays) -> Hits:
        """Nearest surface along each ray at its time."""
        packed: F32 = np.concatenate([rays.origins, rays.directions], axis=1).astype(np.float32)
        hits = self._static.cast(packed)
        order = np.argsort(rays.slices, kind="stable")
        ends = np.searchsorted(rays.slices[order], np.arange(len(self._moving) + 1))
        for surfaces, first, last in zip(self._moving, ends, ends[1:], strict=False):
            if surfaces is None or first == last:
                continue
            own = order[first:last]
            moving = surfaces.cast(packed[own])
            nearer = np.flatnonzero(moving.range < hits.range[own])
            for name in Hits.__dataclass_fields__:
                getattr(hits, name)[own[nearer]] = getattr(moving, name)[nearer]
        return hits


def time_slices(shares: F64, duration: float) -> I64:
    """(N,) int64: the time slice of each ray by its share of the sweep.

    0 if the scene is frozen.
    """
    count = SLICES if duration else 1
    slices: I64 = np.minimum((shares * count).astype(np.int64), count - 1)
    return slices


def _slices(
    scene: SimulatedScene, middle: float, duration: float, rays: TimedRays, bodies: Bodies
) -> list[Surfaces | None]:
    """The movers in each time slice, on a line between their places at the ends, in the posture of
    the middle.
    """
    count = SLICES if duration else 1
    times = [middle + side * duration / 2 for side in (0, -1, 1)]
    sight = _Sight.of(rays, count)
    present: list[tuple[Mover, Mesh, F64]] = []
    met = np.zeros(count, np.bool_)
    for mover in scene.movers:
        now, *ends = mover.motion.poses(times, scene.height)
        if now is not None:
            body = _body(mover, mover.motion.schedule(middle), bodies)
            first, last = (body.transformed(now if T is None else T) for T in ends)
            present.append((mover, first, last.vertices - first.vertices))
            met |= sight.may_meet(np.concatenate([first.bounds, last.bounds])[:, :2])
    owners = [mover for mover, _, _ in present]
    shares = (np.arange(count) + 0.5) / count
    # Every slice contains all movers: of two surfaces at the same range, their structure decides
    # which one is hit.
    return [
        Surfaces(owners, [Mesh(m.vertices + u * way, m.triangles) for _, m, way in present])
        if meets
        else None
        for u, meets in zip(shares, met, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class _Sight:
    """Where the rays of each time slice lead, in the plane.

    Attributes:
        origins: (S, 2) float64, metres: mean origin of the rays of each slice.
        spread: (S,) float64, metres from it to the farthest origin.
        seen: (S, SECTORS) bool: whether a slice has rays in a sector of azimuth; the first starts
            at -pi.
    """

    origins: F64
    spread: F64
    seen: Bool

    @classmethod
    def of(cls, rays: TimedRays, count: int) -> _Sight:
        azimuth = np.arctan2(rays.directions[:, 1], rays.directions[:, 0])
        seen = np.zeros((count, SECTORS), np.bool_)
        seen[rays.slices, _sector(azimuth) % SECTORS] = True
        number = np.maximum(np.bincount(rays.slices, minlength=count), 1)
        x, y = rays.origins[:, :2].T
        origins = np.stack(
            [np.bincount(rays.slices, each, count) / number for each in (x, y)], axis=1
        )
        spread = np.zeros(count)
        np.maximum.at(
            spread, rays.slices, np.hypot(x - origins[rays.slices, 0], y - origins[rays.slices, 1])
        )
        return cls(origins, spread, seen)

    def may_meet(self, corners: F64) -> Bool:
        """(S,) bool: the slices with rays that may meet what lies between (K, 2)
        corners, metres.
        """
        low = corners.min(0)
        high = corners.max(0)
        x, y = ((low + high) / 2 - self.origins).T
        radius = float(np.hypot(*(high - low))) / 2 + self.spread
        away = np.hypot(x, y)
        half = np.where(
            away > radius, np.arcsin(np.minimum(radius / np.maximum(away, 1e-9), 1)) + WIDEST, np.pi
        )
        first = _sector(np.arctan2(y, x) - half)
        last = _sector(np.arctan2(y, x) + half)
        meets = [
            self.seen[k, np.arange(a, b + 1) % SECTORS].any()
            for k, (a, b) in enumerate(zip(first, last, strict=True))
        ]
        return np.array(meets)


def _sector(azimuth: float | F64) -> I64:
    sector: I64 = np.floor((np.asarray(azimuth) / np.pi + 1) * SECTORS / 2).astype(np.int64)
    return sector


def _body(mover: Mover, distance: float, bodies: Bodies) -> Mesh:
    """The mover's body; that of a mover who waits is built once."""
    known = bodies.get(mover.instance)
    if known is None or known[0] != distance:
        known = bodies[mover.instance] = (distance, mover.body(distance))
    return known[1]


def sensor_poses(
    scene: SimulatedScene, sensor: Sensor, time: float, duration: float, shares: F64
) -> tuple[F64, I64]:
    """Poses of the sensor during a sweep.

    Args:
        scene: gives the motion.
        sensor: gives its height above the ground; ``HEIGHT`` if it has none.
        time: middle of the sweep, seconds.
        duration: of the sweep, seconds.
        shares: (N,) float64, 0 to 1: when each ray is fired.

    Returns:
        (T, 4, 4) float64 T_scene_sensor at each tick; (N,) int64 tick of each ray.
    """
    if not duration:
        return sensor_pose(scene, sensor, time)[None], np.zeros(len(shares), np.int64)
    knots = np.stack(
        [
            sensor_pose(scene, sensor, float(t))
            for t in time + duration * np.linspace(-0.5, 0.5, KNOTS)
        ]
    )
    at = (np.arange(TICKS) + 0.5) / TICKS * (KNOTS - 1)
    before = at.astype(np.int64)
    share = (at - before)[:, None, None]
    # turns of less than a milliradian
    poses: F64 = (1 - share) * knots[before] + share * knots[before + 1]
    return poses, (shares * TICKS).astype(np.int64)


def sensor_pose(scene: SimulatedScene, sensor: Sensor, time: float) -> F64:
    """T_scene_sensor (4, 4) float64, metres."""
    T = scene.sensor.pose(time, scene.height)
    assert T is not None  # checked by SimulatedScene
    T[:3, 3] += T[:3, 2] * (HEIGHT if sensor.height is None else sensor.height)
    return T


def by_tick(poses: F64, ticks: I64, points: F64, *, turn_only: bool = False) -> F64:
    """Transform (N, 3) points by the pose of each one's tick, one coordinate at a time."""
    out = np.empty((len(points), 3))
    (x, y, z) = np.ascontiguousarray(points.T)
    rows = np.ascontiguousarray(poses[:, :3].transpose(1, 2, 0))
    for axis in range(3):
        a, b, c = (rows[axis, column].take(ticks) for column in range(3))
        out[:, axis] = a * x + b * y + c * z + (0.0 if turn_only else rows[axis, 3].take(ticks))
    return out
