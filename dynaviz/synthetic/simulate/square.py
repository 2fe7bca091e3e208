"""A city square with a crowd.

Houses on three sides, a street with traffic on the fourth, trees, kiosks, fountain.
"""

from __future__ import annotations

import numpy as np

from dynaviz.arrays import F64
from dynaviz.synthetic.simulate import objects
from dynaviz.synthetic.simulate.classes import ObjectClass
from dynaviz.synthetic.simulate.movers import Movement, Route, Schedule, cruise, depart
from dynaviz.synthetic.simulate.scene import SimulatedScene, rolling
from dynaviz.synthetic.simulate.shapes import box, grid, join, tube

HALF = 34.0  # half the square's side, metres; the street runs along its edge at y = -HALF
LANES = (-36.2, -39.5)
FOUNTAIN = (-3.0, 2.0)
GATE = 26.0  # x of the exit for vehicles, metres


def square(
    rng: np.random.Generator, duration: float, speed: float, traffic: float
) -> SimulatedScene:
    """Build a square; the sensor stands for a third of the time and then drives across it in a
    curve.

    Args:
        rng: random numbers for the whole scene.
        duration: duration of the recording, seconds.
        speed: speed of the sensor once it moves, m/s.
        traffic: relative number of movers; 1 is normal.
    """
    route = Route(
        [
            (-14, -14),
            (-2, -13),
            (10, -12),
            (14, 2),
            (8, 15),
            (-8, 16),
            (-20, 15),
            (-21, 0),
            (-20, -20),
        ],
        rounds=4,
    )
    scene = SimulatedScene(
        rng, duration, rolling(rng, 0.002), Movement(route, depart(2.0, speed, duration / 3, 1.0))
    )
    _ground(scene)
    _houses(scene)
    _furniture(scene)
    _crowd(scene, traffic)
    _traffic(scene, traffic)
    _places(scene)
    return scene


def _places(scene: SimulatedScene) -> None:
    """Where further movers may act.

    Ways across the square, lanes, and gaps in the row of parked cars.
    """
    ends = [
        ((-26, -8), (26, -10)),
        ((-24, 12), (24, 9)),
        ((-18, -22), (18, 22)),
        ((-22, 20), (22, -18)),
    ]
    scene.places.walkways += [Route(np.linspace(a, b, 60)) for a, b in ends]
    scene.places.walkways += [way.reversed() for way in scene.places.walkways]
    scene.places.lanes += [Route([(88, LANES[1]), (-88, LANES[1])])]
    bay = -HALF - 7.9
    for x in np.arange(-45, 46, 1.5):
        way = Route(
            [
                (88, LANES[1]),
                (x + 10, LANES[1]),
                (x + 4, bay),
                (x - 4, bay),
                (x - 10, LANES[1]),
                (-88, LANES[1]),
            ],
            4,
        )
        scene.places.bays.append(
            (way, float(way.distance[np.argmin(np.hypot(*(way.xy - (x, bay)).T))]))
        )


def _ground(scene: SimulatedScene) -> None:
    for kind, low, high, step in (
        (ObjectClass.SIDEWALK, -HALF, HALF + 8, 1.0),
        (ObjectClass.ROAD, -HALF - 9, -HALF, 1.0),
        (ObjectClass.TERRAIN, -HALF - 60, -HALF - 9, 3.0),
    ):
        x, y = np.meshgrid(
            np.arange(-90, 90.1, 1.5),
            np.linspace(low, high, round((high - low) / step) + 1),
            indexing="ij",
        )
        scene.add(grid(np.stack([x, y, scene.height(x, y)], -1)), kind)


def _houses(scene: SimulatedScene) -> None:
    """Houses on three sides, each with a gap between two houses."""
    for side, yaw in ((0, np.pi), (1, -np.pi / 2), (2, np.pi / 2)):
        along = -HALF
        for plot in range(5):
            width = scene.rng.uniform(11, 14.5)
            middle = along + width / 2
            x, y = ((middle, HALF), (-HALF, middle), (HALF, middle))[side]
            if plot != 3:
                scene.house(x, y, yaw, width, 10.0, int(scene.rng.integers(3, 6)))
            along += width


def _furniture(scene: SimulatedScene) -> None:
    basin = tube([(0, 0, -0.2), (0, 0, 0.6)], 3.0, 20)
    scene.put(
        join([basin, tube([(0, 0, 0), (0, 0, 2.2)], (0.5, 0.25), 10)]),
        ObjectClass.OTHER_STRUCTURE,
        *FOUNTAIN,
    )
    for x, y in ((-26.0, 5.0), (24.0, 20.0)):
        roof = box(4.4, 3.6, 0.15, at=(0, 0, 2.7))
        scene.put(
            join([box(3.4, 2.6, 2.7), roof]),
            ObjectClass.OTHER_STRUCTURE,
            x,
            y,
            scene.rng.uniform(0, np.pi),
        )
    for count, x in enumerate(np.arange(-30, 25, 7.5)):
        scene.tree(x + 3, 27.5 + scene.rng.uniform(-1, 1))
        if x < GATE - 7:
            scene.tree(x, -28 + scene.rng.uniform(-1, 1))
            scene.put(objects.bench(), ObjectClass.OTHER_OBJECT, x + 3.5, -26.5, np.pi / 2)
        if count % 2:
            scene.put(objects.lamp(5, 0.8), ObjectClass.POLE, x - 3.7, -31, np.pi / 2)
            scene.put(objects.lamp(5, 0.8), ObjectClass.POLE, x, 24, -np.pi / 2)
    for x in np.arange(-32, GATE - 4, 2.5):
        scene.put(tube([(0, 0, -0.2), (0, 0, 0.9)], 0.08), ObjectClass.POLE, x, -32.8)
    for x, y in scene.rng.uniform((-30, -20), (-24, -3), (6, 2)):
        scene.put(objects.table(), ObjectClass.OTHER_OBJECT, x, y, scene.rng.uniform(0, np.pi))
    for x in np.arange(-4, 4, 0.8):
        scene.put(objects.bicycle(), ObjectClass.PARKED_BICYCLE, x, -29.8, np.pi / 2)
    for x in np.arange(-60, 61, 6.5):
        if scene.rng.random() < 0.6:
            scene.put(
                objects.car(scene.rng),
                ObjectClass.CAR,
                x,
                -HALF - 7.9,
                0,
                scene.rng.uniform(0.1, 0.7),
            )


def _crowd(scene: SimulatedScene, traffic: float) -> None:
    """People across the square in all directions and along the house fronts; some stand at first.

    Cyclists.
    """
    for count in range(round(28 * traffic)):
        pace = scene.rng.uniform(0.9, 1.6)
        stands = scene.duration * scene.rng.uniform(0.3, 0.7) if count % 5 == 1 else None
        scene.walk(*_way(scene, pace, stands, close_to_wall=count % 4 == 0))
    for _ in range(round(4 * traffic)):
        scene.move(ObjectClass.MOVING_BICYCLIST, *_way(scene, 3.5), objects.cyclist)


def _way(
    scene: SimulatedScene,
    pace: float,
    stands: float | None = None,
    close_to_wall: bool = False,
) -> tuple[Route, Schedule]:
    """A random route across the square; repeated until it stays more than 2 m from the sensor."""
    while True:
        path = _walk(scene.rng, close_to_wall)
        start = float(scene.rng.uniform(0, max(1.0, path.length - 0.8 * pace * scene.duration)))
        schedule = cruise(start, pace) if stands is None else depart(start, pace, stands, 1.0)
        times = np.arange(0, scene.duration, 0.2)
        here = np.array([path.at(schedule(time))[:2] for time in times])
        sensor = np.array([scene.sensor.path.at(scene.sensor.schedule(time))[:2] for time in times])
        if np.hypot(*(here - sensor).T).min() > 2.0:
            return path, schedule


def _walk(rng: np.random.Generator, close_to_wall: bool) -> Route:
    """A curved route across the open part of the square, or one 0.7 to 1.8 m from the fronts."""
    inside = HALF - 12
    if close_to_wall:
        gap = HALF - rng.uniform(0.7, 1.8)
        corners: F64 = np.array([(-gap, -inside), (-gap, gap), (gap, gap), (gap, -inside)])
    else:
        way = rng.uniform(0, 2 * np.pi)
        ends = inside * np.array(
            [(np.cos(way), np.sin(way)), (np.cos(way + 2.6), np.sin(way + 2.6))]
        )
        corners = np.array([ends[0], rng.uniform(-14, 14, 2), ends[1]])
    path = Route(corners, rounds=4)
    if np.hypot(*(path.xy - FOUNTAIN).T).min() < 4.0:
        return _walk(rng, close_to_wall)
    return path if rng.random() < 0.5 else path.reversed()


def _traffic(scene: SimulatedScene, traffic: float) -> None:
    """Cars and a lorry on the street, and a car that leaves the square."""
    lanes = [Route([(-88, LANES[0]), (88, LANES[0])]), Route([(88, LANES[1]), (-88, LANES[1])])]
    count = max(4, round(0.5 * scene.duration * traffic))
    for index in range(count):
        pace = 9.0
        start = 88 + scene.rng.uniform(-20, 20) - pace * scene.duration * (index + 0.5) / count
        schedule: Schedule = cruise(start, pace)
        lorry = index == 2
        scene.move(
            ObjectClass.MOVING_TRUCK if lorry else ObjectClass.MOVING_CAR,
            lanes[index % 2],
            schedule,
            objects.truck(scene.rng) if lorry else objects.car(scene.rng),
        )
    out = Route(
        [(27, 3), (27, -8), (GATE, -24), (GATE, LANES[0]), (40, LANES[0]), (88, LANES[0])], rounds=4
    )
    scene.move(
        ObjectClass.MOVING_CAR, out, depart(5, 4.0, 0.4 * scene.duration), objects.car(scene.rng)
    )
