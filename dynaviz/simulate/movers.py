"""What moves: a path over the ground, how far along it at which time, and a body carried along."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dynaviz.arrays import F64
from dynaviz.simulate.classes import ObjectClass
from dynaviz.simulate.shapes import Mesh

Height = Callable[[F64, F64], F64]
"""Height of the ground in metres at x, y."""

Schedule = Callable[[float], float]
"""Distance along a path in metres at a time in seconds."""


class Route:
    """A smooth way over the ground.

    Args:
        points: (P, 2) metres; close together, or the corners of a way that ``rounds`` of cutting make smooth.
        rounds: how often to cut every corner at a quarter of its sides (Chaikin's rule).
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
        """Metres from end to end."""
        return float(self.distance[-1])

    def at(self, distance: float | F64) -> tuple[F64, F64, F64]:
        """X, y (metres) and heading (radians) at distances along the path; its ends beyond them."""
        x, y, yaw = (np.interp(distance, self.distance, column) for column in (*self.xy.T, self.yaw))
        return x, y, yaw

    def beside(self, distance: float | F64, left: float | F64) -> tuple[F64, F64, F64]:
        """X, y and heading of places to the left of the path (to the right where negative)."""
        x, y, yaw = self.at(distance)
        return x - left * np.sin(yaw), y + left * np.cos(yaw), yaw

    def spot(self, distance: float, left: float = 0.0) -> tuple[float, float, float]:
        """One place on or beside the path: x, y, heading."""
        x, y, yaw = (float(value) for value in self.beside(distance, left))
        return x, y, yaw

    def shifted(self, left: float | F64) -> Route:
        """The path that runs beside this one, by one distance or one for each of its points."""
        x, y, _ = self.beside(self.distance, left)
        return Route(np.column_stack([x, y]))

    def reversed(self) -> Route:
        """The same way in the other direction."""
        return Route(self.xy[::-1])


def cruise(start: float, speed: float) -> Schedule:
    """At one speed all the time."""
    return lambda time: start + speed * time


def depart(start: float, speed: float, time: float, acceleration: float = 1.5) -> Schedule:
    """Stand until a time, then go."""
    return lambda now: start + _run_up(now - time, speed, acceleration)


def arrive(end: float, speed: float, time: float, acceleration: float = 1.5) -> Schedule:
    """Come and brake, to stand from a time on."""
    return lambda now: end - _run_up(time - now, speed, acceleration)


def _run_up(elapsed: float, speed: float, acceleration: float) -> float:
    """Metres covered from standing."""
    elapsed, until = max(elapsed, 0.0), speed / acceleration
    return acceleration * elapsed**2 / 2 if elapsed < until else speed * (elapsed - until / 2)


@dataclass(frozen=True, eq=False)
class Ride:
    """Going along a path.

    Attributes:
        path: the way.
        schedule: how far along it at a time.
        upright: stay plumb; else lean with the slope of the ground, as what has wheels does.
    """

    path: Route
    schedule: Schedule
    upright: bool = False

    def pose(self, time: float, height: Height) -> F64 | None:
        """(4, 4) float64 pose on the ground in the scene frame, or None while beyond either end of the path."""
        distance = self.schedule(time)
        if not 0 <= distance <= self.path.length:
            return None
        x, y, yaw = self.path.spot(distance)
        return _upright(x, y, yaw, height) if self.upright else _leaning(x, y, yaw, height)


def _upright(x: float, y: float, yaw: float, height: Height) -> F64:
    c, s, z = np.cos(yaw), np.sin(yaw), height(np.array([x]), np.array([y]))[0]
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, z], [0, 0, 0, 1]])


def _leaning(x: float, y: float, yaw: float, height: Height) -> F64:
    """Standing on four wheels, 2.6 m by 1.4 m apart."""
    forward, left = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    wheels = np.array([x, y]) + np.array([1.3 * forward, -1.3 * forward, 0.7 * left, -0.7 * left])
    front, rear, port, starboard = height(*wheels.T)
    X = np.array([*forward, (front - rear) / 2.6])
    X /= np.linalg.norm(X)
    Y = np.array([*left, (port - starboard) / 1.4])
    Y -= X * np.sum(X * Y)
    Y /= np.linalg.norm(Y)
    T = np.eye(4)
    T[:3, 0], T[:3, 1], T[:3, 2] = X, Y, np.cross(X, Y)
    T[:3, 3] = x, y, (front + rear + port + starboard) / 4
    return T


@dataclass(frozen=True, eq=False)
class Mover:
    """An object that moves at some time, and so is dynamic in every scan.

    Attributes:
        kind: a moving class.
        instance: its number, from 1.
        ride: where it is when.
        body: its mesh, standing on z = 0 and looking along x, after so many metres of way (legs swing with it).
        reflectance: share of the light that comes back.
    """

    kind: ObjectClass
    instance: int
    ride: Ride
    body: Callable[[float], Mesh]
    reflectance: float = 0.4

    def mesh(self, time: float, height: Height) -> Mesh | None:
        """Its mesh in the scene frame at a time, or None while it is not there."""
        T = self.ride.pose(time, height)
        return None if T is None else self.body(self.ride.schedule(time)).transformed(T)
