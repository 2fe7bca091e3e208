"""A scene: static meshes, movers, the ground and the sensor's motion.

With helpers that the builders share.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from dynaviz.arrays import F64
from dynaviz.errors import UsageError
from dynaviz.synthetic.simulate import objects
from dynaviz.synthetic.simulate.classes import REFLECTANCE, ObjectClass
from dynaviz.synthetic.simulate.movers import Height, Movement, Mover, Route, Schedule
from dynaviz.synthetic.simulate.shapes import Mesh


@dataclass(frozen=True, eq=False)
class MeshPart:
    """A static object: mesh in the scene frame, class and reflectance from 0 to 1; glass.

    Whether it is a pane.
    """

    mesh: Mesh
    kind: ObjectClass
    reflectance: float
    glass: bool = False


@dataclass(eq=False)
class Places:
    """Where movers may act in a scene; no random numbers are needed to find them.

    Routes are in metres, scene frame.

    Attributes:
        walls: along walls, whose free side is on the left.
        obstacles: parked cars and pillars: x, y, yaw, half length and half width (metres, radians).
        walkways: where people walk.
        lanes: where vehicles drive.
        bays: ways of vehicles into a free bay and out again, and the distance at which they park.
    """

    walls: list[Route] = field(default_factory=list)
    obstacles: list[tuple[float, float, float, float, float]] = field(default_factory=list)
    walkways: list[Route] = field(default_factory=list)
    lanes: list[Route] = field(default_factory=list)
    bays: list[tuple[Route, float]] = field(default_factory=list)


@dataclass(eq=False)
class SimulatedScene:
    """A scene for the simulator. The scene frame has z up and the ground near z = 0.

    Attributes:
        rng: random numbers for the whole scene.
        duration: duration of the recording, seconds.
        height: height of the ground in metres at x, y in the scene frame.
        sensor: motion of the vehicle that carries the sensor.
        parts: static objects.
        movers: moving objects; instance numbers are positions in this list, from 1.
        places: where further movers may act.
    """

    rng: np.random.Generator
    duration: float
    height: Height
    sensor: Movement
    parts: list[MeshPart] = field(default_factory=list)
    movers: list[Mover] = field(default_factory=list)
    places: Places = field(default_factory=Places)

    def __post_init__(self) -> None:
        """Raise UsageError if the recording is longer than the sensor's route, before anything is
        built.
        """
        if self.sensor.pose(self.duration, self.height) is None:
            raise UsageError(
                f"the sensor's route takes less than {self.duration:.0f} s. Give fewer frames "
                "(--frames)"
            )

    def add(self, mesh: Mesh, kind: ObjectClass, reflectance: float | None = None) -> None:
        """Add a static mesh in the scene frame."""
        self.parts.append(
            MeshPart(mesh, kind, REFLECTANCE.get(kind, 0.4) if reflectance is None else reflectance)
        )

    def put(
        self,
        mesh: Mesh,
        kind: ObjectClass,
        x: float,
        y: float,
        yaw: float = 0,
        reflectance: float | None = None,
    ) -> None:
        """Place a static mesh on the ground."""
        z = float(self.height(np.array([x]), np.array([y]))[0])
        self.add(mesh.moved(x, y, z, yaw=yaw), kind, reflectance)
        if kind == ObjectClass.CAR:
            self.places.obstacles.append(
                (x, y, yaw, *(np.ptp(mesh.bounds, axis=0)[:2] / 2).tolist())
            )

    def tree(self, x: float, y: float, highest: float = 9.0) -> None:
        """Add a tree, at least 6.5 m high."""
        height = self.rng.uniform(6.5, highest)
        self.put(objects.trunk(self.rng, height), ObjectClass.TRUNK, x, y)
        self.put(objects.crown(self.rng, height), ObjectClass.VEGETATION, x, y)

    def house(
        self, x: float, y: float, yaw: float, width: float, depth: float, storeys: int
    ) -> None:
        """Add a house; its front is centred at x, y and faces along yaw + 90 degrees."""
        walls, panes = objects.house(self.rng, width, depth, storeys)
        self.put(walls, ObjectClass.BUILDING, x, y, yaw, self.rng.uniform(0.3, 0.7))
        # glass returns little light from far away
        self.put(panes, ObjectClass.BUILDING, x, y, yaw, 0.06)
        self.parts[-1] = replace(self.parts[-1], glass=True)
        along = np.linspace(-width / 2, width / 2, 20)
        self.places.walls.append(
            Route(np.column_stack([x + along * np.cos(yaw), y + along * np.sin(yaw)]))
        )

    def move(
        self,
        kind: ObjectClass,
        path: Route,
        schedule: Schedule,
        body: Mesh | Callable[[float], Mesh],
    ) -> None:
        """Add an object that moves along a route."""
        shape = body if callable(body) else lambda _: body
        upright = kind in (ObjectClass.MOVING_PERSON, ObjectClass.MOVING_BICYCLIST)
        reflectance = self.rng.uniform(0.12, 0.7)
        self.movers.append(
            Mover(kind, len(self.movers) + 1, Movement(path, schedule, upright), shape, reflectance)
        )

    def walk(self, path: Route, schedule: Schedule) -> None:
        """Add a person who walks along a route."""
        height = self.rng.uniform(1.55, 1.9)
        self.move(
            ObjectClass.MOVING_PERSON,
            path,
            schedule,
            lambda distance: objects.person(distance, height),
        )


def rolling(rng: np.random.Generator, steepness: float = 0.004) -> Callable[[F64, F64], F64]:
    """Smooth uneven ground: waves with lengths of 6 to 90 m and amplitudes of ``steepness`` times
    their length.
    """
    lengths = np.array([90.0, 60.0, 35.0, 20.0, 11.0, 6.0])
    directions, phases = rng.uniform(0, 2 * np.pi, (2, len(lengths)))

    def height(x: F64, y: F64) -> F64:
        total = np.zeros(np.broadcast(x, y).shape)
        for length, a, phase in zip(lengths, directions, phases, strict=True):
            total += (
                steepness
                * length
                * np.sin(2 * np.pi / length * (x * np.cos(a) + y * np.sin(a)) + phase)
            )
        return total

    return height
