"""A hall with a flat ceiling, beams, pillars, racks, tables, people and a forklift."""

from __future__ import annotations

import numpy as np

from dynaviz.arrays import F64
from dynaviz.synthetic.simulate import objects
from dynaviz.synthetic.simulate.classes import ObjectClass
from dynaviz.synthetic.simulate.movers import Movement, Route, cruise, depart
from dynaviz.synthetic.simulate.scene import SimulatedScene, rolling
from dynaviz.synthetic.simulate.shapes import Mesh, box, boxes, grid, join, quads, tube

# half length, half width and height, metres
X = 24.0
Y = 13.0
CEILING = 5.5
AISLES = (-10.6, 5.4, 9.4, -9.4)  # y of the lines along which people walk, metres


def hall(rng: np.random.Generator, duration: float, speed: float, traffic: float) -> SimulatedScene:
    """Build a hall in which a small robot with the sensor drives a loop.

    Args:
        rng: random numbers for the whole scene.
        duration: duration of the recording, seconds.
        speed: speed of the sensor, m/s.
        traffic: relative number of movers; 1 is normal.
    """
    route = Route(
        [(-16, -4), (0, -4), (13, -4), (13, 4), (0, 4), (-19, 4), (-19, -4), (0, -4), (13, -4)],
        rounds=4,
    )
    scene = SimulatedScene(rng, duration, rolling(rng, 0.0003), Movement(route, cruise(1.0, speed)))
    _shell(scene)
    _furniture(scene)
    _people(scene, traffic)
    _places(scene)
    return scene


def _places(scene: SimulatedScene) -> None:
    """Where further movers may act.

    Along the walls between the racks, around the pillars, along the aisles.
    """
    ends = [
        ((X, -Y), (-X, -Y)),
        ((-X, -Y), (-X, -2)),
        ((-X, 2), (-X, Y)),
        ((X, Y), (X, -2)),
        ((X, -6), (X, -Y)),
    ]
    scene.places.walls += [
        _inward(Route(np.linspace(a, b, 40))) for a, b in [*ends, ((-X, Y), (X, Y))]
    ]
    scene.places.obstacles += [
        (x, y, 0.0, 0.4, 0.4) for x in np.arange(-18, 19, 6.0) for y in (-7.4, 7.4)
    ]
    aisles = [Route(np.linspace((-X + 1.5, y), (X - 1.5, y), 60)) for y in (*AISLES, -5.5)]
    scene.places.walkways += [way for aisle in aisles for way in (aisle, aisle.reversed())]
    scene.places.lanes += [aisles[-1], aisles[1]]
    scene.places.bays += [
        (aisle, stop) for aisle in aisles[:3] for stop in np.arange(8.0, 38.0, 3.0)
    ]


def _inward(wall: Route) -> Route:
    """The wall in the direction that has the hall on the left."""
    x, y, _ = wall.offset(wall.length / 2, 1.0)
    return wall if abs(x) < X and abs(y) < Y else wall.reversed()


def _shell(scene: SimulatedScene) -> None:
    """Floor, ceiling and beams, walls with two open gates, two rows of pillars."""
    x, y = np.meshgrid(np.arange(-X, X + 0.1, 1.0), np.arange(-Y, Y + 0.1, 1.0), indexing="ij")
    scene.add(grid(np.stack([x, y, scene.height(x, y)], -1)), ObjectClass.OTHER_GROUND, 0.35)
    ceiling = quads([[(-X, -Y, CEILING), (-X, Y, CEILING), (X, Y, CEILING), (X, -Y, CEILING)]])
    beams = boxes([(x, 0, CEILING - 0.25) for x in np.arange(-X + 4, X, 4)], (0.3, 2 * Y, 0.5))
    ducts = tube([(-X, 6, CEILING - 0.8), (X, 6, CEILING - 0.8)], 0.35, 10)
    walls = [
        _wall((-X, -Y), (X, -Y)),
        _wall((X, Y), (-X, Y)),
        _wall((-X, Y), (-X, 2)),
        _wall((-X, -2), (-X, -Y)),
    ]
    walls += [
        _wall((X, -Y), (X, -6)),
        _wall((X, -2), (X, Y)),
        _wall((-X, 2), (-X, -2), 3.5),
        _wall((X, -6), (X, -2), 3.5),
    ]
    scene.add(join([ceiling, beams, ducts, *walls]), ObjectClass.BUILDING)
    for x in np.arange(-18, 19, 6.0):
        for y in (-7.4, 7.4):
            scene.put(
                join([tube([(0, 0, -0.1), (0, 0, CEILING)], 0.25, 12), box(0.8, 0.8, 0.25)]),
                ObjectClass.BUILDING,
                x,
                y,
            )


def _wall(start: tuple[float, float], end: tuple[float, float], above: float = -0.2) -> Mesh:
    """A wall between two corners; it starts at height ``above``, over an open gate."""
    (a, b) = start
    (c, d) = end
    return quads([[(a, b, above), (c, d, above), (c, d, CEILING), (a, b, CEILING)]])


def _furniture(scene: SimulatedScene) -> None:
    for x in np.arange(-18, 19, 6.0):
        for y in (-12.4, 12.4):
            scene.put(objects.shelf(scene.rng), ObjectClass.OTHER_OBJECT, x, y)
        if x < 18 and scene.rng.random() < 0.7:
            scene.put(
                objects.table(),
                ObjectClass.OTHER_OBJECT,
                x + 2.8,
                float(scene.rng.choice([-7.4, 7.4])),
                np.pi / 2,
            )
    for x, y in scene.rng.uniform((-7, -1.8), (7, 1.8), (9, 2)):
        scene.put(
            box(*scene.rng.uniform(0.4, 1.3, 3)),
            ObjectClass.OTHER_OBJECT,
            x,
            y,
            scene.rng.uniform(0, np.pi),
        )
    scene.put(objects.fence(8.0, 1.1), ObjectClass.FENCE, -2, -2.8)


def _people(scene: SimulatedScene, traffic: float) -> None:
    """People along and across the aisles, one of whom stands for half of the time; a forklift."""
    for count in range(round(9 * traffic)):
        path = _aisle(scene.rng, AISLES[count % 4] + scene.rng.uniform(-0.5, 0.5))
        pace = scene.rng.uniform(0.8, 1.5)
        start = scene.rng.uniform(0, max(1.0, path.length - pace * scene.duration))
        scene.walk(path, cruise(start, pace))
    standing = Route([(1.2, 7.2), (1.4, 5.2), (4, 5.3), (14, 5.4), (22, 5.4)], rounds=4)
    scene.walk(standing, depart(1.0, 1.3, scene.duration / 2, 1.0))
    across = Route([(16.4, -11.4), (16.5, 0), (16.4, 11.4)], rounds=3)
    scene.walk(across, cruise(0, 1.1))
    haul = Route(
        [(21, -11), (20.5, -5.6), (10, -5.6), (-10, -5.5), (-21.5, -5.6), (-21.5, 9)], rounds=4
    )
    scene.move(
        ObjectClass.MOVING_OTHER_VEHICLE,
        haul,
        depart(3, 1.8, 0.25 * scene.duration),
        objects.forklift(scene.rng),
    )


def _aisle(rng: np.random.Generator, y: float) -> Route:
    x: F64 = np.linspace(-X + 1.5, X - 1.5, 60)
    path = Route(np.column_stack([x, y + 0.25 * np.sin(x / 3)]))
    return path if rng.random() < 0.5 else path.reversed()
