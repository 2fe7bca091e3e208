"""A city square with a crowd: houses on three sides, a street with traffic on the fourth, trees, kiosks, a fountain."""

from __future__ import annotations

import numpy as np

from dynaviz.scan import F64
from dynaviz.simulate import things
from dynaviz.simulate.classes import Kind
from dynaviz.simulate.movers import Path, Ride, Schedule, cruise, depart
from dynaviz.simulate.scene import Scene, rolling
from dynaviz.simulate.shapes import box, grid, join, tube

HALF = 34.0  # of the square's side, metres; the street runs beyond its edge at y = -HALF
LANES = (-37.0, -40.5)


def square(rng: np.random.Generator, duration: float, speed: float, traffic: float) -> Scene:
    """Build a square for a sensor that stands for a third of the time and then drives across it in a bend.

    Args:
        rng: chooses everything.
        duration: of the recording, seconds.
        speed: of the sensor once it goes, m/s.
        traffic: how much of it; 1 is usual.
    """
    route = Path([(-14, -14), (-2, -13), (10, -12), (14, 2), (8, 15), (-8, 16), (-20, 15), (-21, 0), (-20, -20)], rounds=4)
    scene = Scene(rolling(rng, 0.002), Ride(route, depart(2.0, speed, duration / 3, 1.0)))
    _ground(scene)
    _houses(scene, rng)
    _furniture(scene, rng)
    _crowd(scene, rng, duration, traffic)
    _traffic(scene, rng, duration, traffic)
    return scene


def _ground(scene: Scene) -> None:
    for kind, low, high, step in (
        (Kind.SIDEWALK, -HALF, HALF + 8, 1.0),
        (Kind.ROAD, -HALF - 9, -HALF, 1.0),
        (Kind.TERRAIN, -HALF - 60, -HALF - 9, 3.0),
    ):
        x, y = np.meshgrid(np.arange(-90, 90.1, 1.5), np.linspace(low, high, round((high - low) / step) + 1), indexing="ij")
        scene.add(grid(np.stack([x, y, scene.height(x, y)], -1)), kind)


def _houses(scene: Scene, rng: np.random.Generator) -> None:
    """Three sides of houses, each with a lane between two of them that one looks through."""
    for side, yaw in ((0, np.pi), (1, np.pi / 2), (2, -np.pi / 2)):
        along = -HALF
        for plot in range(5):
            width = rng.uniform(11, 14.5)
            middle = along + width / 2
            x, y = ((middle, HALF), (-HALF, middle), (HALF, middle))[side]
            yaw_out = yaw if side == 0 else -yaw
            if plot != 3:
                scene.house(rng, x, y, yaw_out, width, 10.0, int(rng.integers(3, 6)))
            along += width


def _furniture(scene: Scene, rng: np.random.Generator) -> None:
    basin = tube([(0, 0, -0.2), (0, 0, 0.6)], 3.0, 20)
    scene.put(join([basin, tube([(0, 0, 0), (0, 0, 2.2)], (0.5, 0.25), 10)]), Kind.OTHER_STRUCTURE, -3, 2)
    for x, y in ((-26, 5), (24, 20)):
        roof = box(4.4, 3.6, 0.15, at=(0, 0, 2.7))
        scene.put(join([box(3.4, 2.6, 2.7), roof]), Kind.OTHER_STRUCTURE, x, y, rng.uniform(0, np.pi))
    for count, x in enumerate(np.arange(-30, 31, 7.5)):
        scene.tree(rng, x, -28 + rng.uniform(-1, 1))
        scene.tree(rng, x + 3, 28 + rng.uniform(-1, 1))
        scene.put(things.bench(), Kind.OTHER_OBJECT, x + 3.5, -26.5, np.pi / 2)
        if count % 2:
            scene.put(things.lamp(5, 0.8), Kind.POLE, x + 3.7, -31, np.pi / 2)
            scene.put(things.lamp(5, 0.8), Kind.POLE, x, 24, -np.pi / 2)
    for x in np.arange(-32, 33, 2.5):
        scene.put(tube([(0, 0, -0.2), (0, 0, 0.9)], 0.08), Kind.POLE, x, -32.8)
    for x, y in rng.uniform((12, -22), (28, -8), (6, 2)):
        scene.put(things.table(), Kind.OTHER_OBJECT, x, y, rng.uniform(0, np.pi))
    for x in np.arange(-4, 4, 0.8):
        scene.put(things.bicycle(), Kind.PARKED_BICYCLE, x, -29.8, np.pi / 2)
    for x in np.arange(-60, 61, 6.5):
        if rng.random() < 0.6:
            scene.put(things.car(rng), Kind.CAR, x, -HALF - 7.9, 0, rng.uniform(0.1, 0.7))


def _crowd(scene: Scene, rng: np.random.Generator, duration: float, traffic: float) -> None:
    """People across the square in all directions and along the house fronts; some stand first."""
    for count in range(round(36 * traffic)):
        walk, pace = _walk(rng, close_to_wall=count % 4 == 0), rng.uniform(0.9, 1.6)
        goes = depart(_start(rng, walk, pace, duration), pace, duration * rng.uniform(0.3, 0.7), 1.0)
        scene.walk(walk, goes if count % 5 == 1 else cruise(_start(rng, walk, pace, duration), pace), rng)
    for _ in range(round(4 * traffic)):
        walk = _walk(rng, close_to_wall=False)
        scene.move(Kind.MOVING_BICYCLIST, walk, cruise(_start(rng, walk, 3.5, duration), 3.5), things.cyclist, rng)


def _walk(rng: np.random.Generator, close_to_wall: bool) -> Path:
    """A bent way across the open part of the square, or one half a metre to a metre from the fronts."""
    inside = HALF - 12
    if close_to_wall:
        gap = HALF - rng.uniform(0.7, 1.8)
        corners: F64 = np.array([(-gap, -inside), (-gap, gap), (gap, gap), (gap, -inside)])
    else:
        way = rng.uniform(0, 2 * np.pi)
        ends = inside * np.array([(np.cos(way), np.sin(way)), (np.cos(way + 2.6), np.sin(way + 2.6))])
        corners = np.array([ends[0], rng.uniform(-14, 14, 2), ends[1]])
    path = Path(corners, rounds=4)
    return path if rng.random() < 0.5 else path.reversed()


def _start(rng: np.random.Generator, path: Path, pace: float, duration: float) -> float:
    """So that most of the time is spent on the path."""
    return float(rng.uniform(0, max(1.0, path.length - 0.8 * pace * duration)))


def _traffic(scene: Scene, rng: np.random.Generator, duration: float, traffic: float) -> None:
    """Cars and lorries on the street, a delivery van that leaves the square."""
    lanes = [Path([(-88, LANES[0]), (88, LANES[0])]), Path([(88, LANES[1]), (-88, LANES[1])])]
    count = max(4, round(0.5 * duration * traffic))
    for index in range(count):
        pace = 9.0
        start = 88 + rng.uniform(-20, 20) - pace * duration * (index + 0.5) / count
        schedule: Schedule = cruise(start, pace)
        lorry = index % 4 == 2
        scene.move(
            Kind.MOVING_TRUCK if lorry else Kind.MOVING_CAR, lanes[index % 2], schedule,
            things.truck(rng) if lorry else things.car(rng), rng,
        )
    out = Path([(27, 3), (27, -8), (26, -24), (25, LANES[0]), (40, LANES[0]), (88, LANES[0])], rounds=4)
    scene.move(Kind.MOVING_TRUCK, out, depart(5, 4.0, 0.4 * duration), things.truck(rng), rng)
