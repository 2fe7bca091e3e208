"""Moving objects: a route over the ground, a schedule along it, and a body that follows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dynaviz.arrays import F64
from dynaviz.synthetic.simulate.classes import ObjectClass
from dynaviz.synthetic.simulate.shapes import Mesh

Height = Callable[[F64, F64], F64]
"""Height of the ground in metres at x, y."""

Schedule = Callable[[float], float]
"""Distance along a route in metres at a time in seconds."""


class Route:
    """A smooth path over the ground.

    Args:
        points: (P, 2) metres; either dense, or corners that are smoothed by ``rounds`` of corner
            cutting.
        rounds: number of rounds of corner cutting, each at a quarter of the sides (Chaikin's rule).
    """

    def __init__(self, points: ArrayLike, rounds: int = 0):
        xy = np.asarray(points, np.float64)
        for _ in range(rounds):
            cut = np.stack([0.75 * xy[:-1] + 0.25 * xy[1:], 0.25 * xy[:-1] + 0.75 * xy[1:]], axis=1)
            xy = np.concatenate([xy[:1], cut.reshape(-1, 2), xy[-1:]])
        steps = np.diff(xy, axis=0)
        self.xy = xy
        self.distance = np.concatenate([[0], np.cumsum(np.hypot(*steps.T))])
        tangents = np.gradient(xy, axis=0)
        self.yaw = np.unwrap(np.arctan2(tangents[:, 1], tangents[:, 0]))

    @property
    def length(self) -> float:
        """Length, metres."""
        return float(self.distance[-1])

    def at(self, distance: float | F64) -> tuple[F64, F64, F64]:
        """X, y (metres) and heading (radians) at distances along the route, clamped to its ends."""
        x, y, yaw = (
            np.interp(distance, self.distance, column) for column in (*self.xy.T, self.yaw)
        )
        return x, y, yaw

    def offset(self, distance: float | F64, left: float | F64) -> tuple[F64, F64, F64]:
        """X, y and heading at distances along the route, shifted to the left (negative.

        To the right).
        """
        x, y, yaw = self.at(distance)
        return x - left * np.sin(yaw), y + left * np.cos(yaw), yaw

    def pose2d(self, distance: float, left: float = 0.0) -> tuple[float, float, float]:
        """X, y and heading of one position, as in ``offset``."""
        x, y, yaw = (float(value) for value in self.offset(distance, left))
        return x, y, yaw

    def shifted(self, left: float | F64) -> Route:
        """A parallel route, shifted to the left by one distance or by one per point."""
        x, y, _ = self.offset(self.distance, left)
        return Route(np.column_stack([x, y]))

    def reversed(self) -> Route:
        """The route in the opposite direction."""
        return Route(self.xy[::-1])


def cruise(start: float, speed: float) -> Schedule:
    """Move at constant speed."""
    return lambda time: start + speed * time


def depart(start: float, speed: float, time: float, acceleration: float = 1.5) -> Schedule:
    """Stand until a time, then accelerate to a speed."""
    return lambda now: start + _run_up(now - time, speed, acceleration)


def arrive(end: float, speed: float, time: float, acceleration: float = 1.5) -> Schedule:
    """Approach at a speed and brake, to stand from a time on."""
    return lambda now: end - _run_up(time - now, speed, acceleration)


def _run_up(elapsed: float, speed: float, acceleration: float) -> float:
    """Distance covered from a standing start, metres."""
    elapsed = max(elapsed, 0.0)
    until = speed / acceleration
    return acceleration * elapsed**2 / 2 if elapsed < until else speed * (elapsed - until / 2)


@dataclass(frozen=True, eq=False)
class Movement:
    """Motion along a route.

    Attributes:
        path: the route.
        schedule: distance along the route over time.
        upright: True keeps the z axis vertical; False follows the slope of the ground, as a vehicle
            does.
    """

    path: Route
    schedule: Schedule
    upright: bool = False

    def pose(self, time: float, height: Height) -> F64 | None:
        """(4, 4) float64 pose on the ground in the scene frame, or None before and
        after the route.
        """
        return self.poses([time], height)[0]

    def poses(self, times: Sequence[float], height: Height) -> list[F64 | None]:
        """The pose at each of some times, as ``pose`` gives it."""
        distances = np.array([self.schedule(time) for time in times])
        on_route = (distances >= 0) & (distances <= self.path.length)
        x, y, yaw = self.path.at(distances)
        found = (_upright if self.upright else _leaning)(x, y, yaw, height)
        return [T if there else None for T, there in zip(found, on_route, strict=True)]


def _upright(x: F64, y: F64, yaw: F64, height: Height) -> F64:
    """(T, 4, 4) poses with a vertical z axis."""
    poses = np.tile(np.eye(4), (len(x), 1, 1))
    poses[:, 0, 0] = np.cos(yaw)
    poses[:, 1, 0] = np.sin(yaw)
    poses[:, 0, 1] = -np.sin(yaw)
    poses[:, 1, 1] = poses[:, 0, 0]
    poses[:, :3, 3] = np.stack([x, y, height(x, y)], axis=1)
    return poses


def _leaning(x: F64, y: F64, yaw: F64, height: Height) -> F64:
    """(T, 4, 4) poses of a vehicle with four wheels, 2.6 m by 1.4 m apart."""
    poses = np.tile(np.eye(4), (len(x), 1, 1))
    forward = np.stack([np.cos(yaw), np.sin(yaw)])
    left = np.stack([-np.sin(yaw), np.cos(yaw)])
    wheels = (
        np.stack([1.3 * forward, -1.3 * forward, 0.7 * left, -0.7 * left], axis=1)
        + np.stack([x, y])[:, None]
    )
    for T, ground, x_axis, y_axis, place in zip(
        poses, height(*wheels).T, forward.T, left.T, np.stack([x, y], axis=1), strict=True
    ):
        front, rear, port, starboard = ground
        X = np.array([*x_axis, (front - rear) / 2.6])
        X /= np.linalg.norm(X)
        Y = np.array([*y_axis, (port - starboard) / 1.4])
        Y -= X * np.sum(X * Y)
        Y /= np.linalg.norm(Y)
        T[:3, 0] = X
        T[:3, 1] = Y
        T[:3, 2] = np.cross(X, Y)
        T[:3, 3] = *place, (front + rear + port + starboard) / 4
    return poses


@dataclass(frozen=True, eq=False)
class Mover:
    """An object that moves at some time, and is therefore dynamic in every scan.

    Attributes:
        kind: one of the moving classes.
        instance: instance number, from 1.
        motion: its motion over time.
        body: its mesh after some distance (legs swing as it moves), standing on z = 0 and facing
            along x.
        reflectance: 0 to 1.
    """

    kind: ObjectClass
    instance: int
    motion: Movement
    body: Callable[[float], Mesh]
    reflectance: float = 0.4

    def mesh(self, time: float, height: Height) -> Mesh | None:
        """Its mesh in the scene frame at a time, or None before and after its motion."""
        T = self.motion.pose(time, height)
        return None if T is None else self.body(self.motion.schedule(time)).transformed(T)
