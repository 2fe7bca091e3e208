"""A street with a bend, kerbs, pavements, houses, trees, parked cars, traffic, and people close to
the walls.
"""

from __future__ import annotations

import numpy as np

from dynaviz.arrays import F64
from dynaviz.synthetic.simulate import objects
from dynaviz.synthetic.simulate.classes import ObjectClass
from dynaviz.synthetic.simulate.movers import Movement, Route, arrive, cruise, depart
from dynaviz.synthetic.simulate.scene import SimulatedScene, rolling
from dynaviz.synthetic.simulate.shapes import Mesh, box, grid

ENDS = 85.0  # length of street before and after the sensor's route, metres
BEND = np.radians(50)
RADIUS = 75.0
# offsets of lane centre, parking bays, kerb and house fronts, metres
LANE = 1.75
BAY = 4.6
KERB = 5.7
WALL = 9.2
PLACE = 6.2  # length of a parking space, metres
STEP = 0.13  # height of the kerb, metres


class Street:
    """The coordinates of a street: stations along its centre line and metres to the left of it."""

    def __init__(self, rng: np.random.Generator, way: float):
        self.length = way + 2 * ENDS
        self.middle = _middle(self.length)
        self.base = rolling(rng)
        # a parking space left free on both sides
        self.crossing = 3.0 + PLACE * round((ENDS + way + 11) / PLACE)

    def height(self, x: F64, y: F64) -> F64:
        """Height of the ground, metres: uneven terrain plus the profile of the street."""
        offsets = np.stack([x, y], -1)[..., None, :] - self.middle.xy
        return self.base(x, y) + _profile(np.sqrt((offsets**2).sum(-1).min(-1)))

    def lane(self, left: float) -> Route:
        """The lane ``left`` metres to the left.

        Lanes on the left run against the sensor's direction.
        """
        path = self.middle.shifted(left)
        return path if left < 0 else path.reversed()

    def station(self, path: Route, station: float, left: float) -> float:
        """Distance along a lane of a station of the street."""
        x, y, _ = self.middle.pose2d(station, left)
        return float(path.distance[np.argmin(np.hypot(path.xy[:, 0] - x, path.xy[:, 1] - y))])


def _middle(length: float) -> Route:
    """The centre line: straight, a bend halfway, straight again."""
    stations = np.arange(0, length, 0.5)
    turned = np.clip((stations - length / 2) / (RADIUS * BEND) + 0.5, 0, 1)
    yaw = BEND * turned**2 * (3 - 2 * turned)
    return Route(np.column_stack([np.cumsum(0.5 * np.cos(yaw)), np.cumsum(0.5 * np.sin(yaw))]))


def _profile(aside: F64) -> F64:
    """Height by distance from the centre line, metres.

    A crowned carriageway, a gutter, the kerb.
    """
    return np.where(aside < KERB, 0.06 * (1 - (aside / KERB) ** 2), STEP)


def street(
    rng: np.random.Generator, duration: float, speed: float, traffic: float
) -> SimulatedScene:
    """Build a street along which the sensor drives.

    To its right there is a gutter below the kerb; to its left the road rises to the pavement.

    Args:
        rng: random numbers for the whole scene.
        duration: duration of the recording, seconds.
        speed: speed of the sensor, m/s.
        traffic: relative number of movers; 1 is normal.
    """
    road = Street(rng, duration * speed)
    lane = road.lane(-LANE)
    scene = SimulatedScene(
        rng, duration, road.height, Movement(lane, cruise(road.station(lane, ENDS, -LANE), speed))
    )
    reserved = _parking_cars(scene, road, speed)
    _ground(scene, road)
    _fronts(scene, road)
    _kerbside(scene, road, reserved)
    _traffic(scene, road, speed, traffic)
    _people(scene, road, speed, traffic)
    _places(scene, road, reserved)
    return scene


def _places(scene: SimulatedScene, road: Street, reserved: tuple[float, float]) -> None:
    """Where further movers may act: pavements, lanes, and bays outside the reserved stations."""
    scene.places.walkways += [
        way for left in (7.2, -7.2) for way in (road.middle.shifted(left), road.lane(left))
    ]
    scene.places.lanes += [road.lane(LANE), road.lane(-LANE)]
    stations = np.arange(0, road.length, 0.5)
    for station in np.arange(20.0, road.length - 20, PLACE / 2):
        # those stations are for the right side only
        free = not reserved[0] - 15 < station < reserved[1] + 15
        for side in (-1, 1) if free else (1,):
            swing = np.interp(np.abs(stations - station), [2.5, 11], [BAY, LANE])
            path = road.middle.shifted(side * _eased(swing))
            path = path if side < 0 else path.reversed()
            scene.places.bays.append((path, road.station(path, station, side * BAY)))


def _ground(scene: SimulatedScene, road: Street) -> None:
    stations = np.arange(0, road.length, 1.0)
    across = np.linspace(-KERB, KERB, 9)
    strips = [(ObjectClass.ROAD, across), (ObjectClass.SIDEWALK, np.array([KERB, KERB, 7.5, WALL]))]
    strips += [(ObjectClass.TERRAIN, np.array([WALL, 11, 14, 18, 23, 29, 36, 44, 52]))]
    for kind, left in strips:
        heights = _profile(np.abs(left))
        # the pavement begins with the vertical face of the kerb
        heights[0] = _profile(np.abs(left[:1]) - 1e-6)[0]
        for side in (left,) if kind == ObjectClass.ROAD else (left, -left):
            scene.add(_strip(road, stations, side, heights), kind)


def _strip(road: Street, stations: F64, left: F64, heights: F64) -> Mesh:
    x, y, _ = road.middle.offset(*np.meshgrid(stations, left, indexing="ij"))
    return grid(np.stack([x, y, road.base(x, y) + heights], -1))


def _fronts(scene: SimulatedScene, road: Street) -> None:
    """Row houses with gaps; on the left, halfway along, open country."""
    for side in (-1, 1):
        station = 4.0
        plot = 0
        while station < road.length - 20:
            width = scene.rng.uniform(10, 17)
            middle = station + width / 2
            plot = plot + 1
            if side > 0 and abs(middle - road.length / 2 - 8) < 20:
                _open(scene, road, middle, width)
            elif plot % 4 == 3:
                _garden(scene, road, middle, width, side)
            else:
                # keeps straight fronts off the pavement in the bend
                aside = WALL + width**2 / 500 * (side > 0)
                x, y, yaw = road.middle.pose2d(middle, side * aside)
                scene.house(
                    x,
                    y,
                    yaw + np.pi * (side > 0),
                    width,
                    scene.rng.uniform(8, 11),
                    int(scene.rng.integers(2, 5)),
                )
            station += width + 0.1


def _garden(scene: SimulatedScene, road: Street, middle: float, width: float, side: int) -> None:
    """A gap between houses: fence or wall in front, a hedge and trees behind."""
    x, y, yaw = road.middle.pose2d(middle, side * (WALL + 0.2))
    if scene.rng.random() < 0.6:
        scene.put(objects.fence(width), ObjectClass.FENCE, x, y, yaw)
    else:
        scene.put(box(width, 0.3, 1.9), ObjectClass.OTHER_STRUCTURE, x, y, yaw)
    x, y, yaw = road.middle.pose2d(middle, side * (WALL + 9))
    scene.put(objects.bush(scene.rng, width, 1.2, 2.0), ObjectClass.VEGETATION, x, y, yaw)
    for along in (-0.25, 0.25):
        x, y, _ = road.middle.pose2d(
            middle + along * width, side * (WALL + scene.rng.uniform(3.5, 6.5))
        )
        scene.tree(x, y)


def _open(scene: SimulatedScene, road: Street, middle: float, width: float) -> None:
    for _ in range(2):
        along = middle + scene.rng.uniform(-width / 2, width / 2)
        left = WALL + scene.rng.uniform(2, 25)
        x, y, yaw = road.middle.pose2d(along, left)
        scene.put(
            objects.bush(scene.rng, 1.5, 1.5, scene.rng.uniform(0.5, 1.2)),
            ObjectClass.VEGETATION,
            x,
            y,
            yaw,
        )


def _kerbside(scene: SimulatedScene, road: Street, reserved: tuple[float, float]) -> None:
    """Parked cars, street trees, lamps, signs, bins, benches and parked bicycles."""
    for side in (-1, 1):
        for count, station in enumerate(np.arange(3.0, road.length - 3, PLACE)):
            taken = (side < 0 and reserved[0] < station < reserved[1]) or abs(
                station - road.crossing
            ) < 1
            if not taken and scene.rng.random() < 0.5:
                x, y, yaw = road.middle.pose2d(
                    station + scene.rng.uniform(-0.4, 0.4),
                    side * (BAY + scene.rng.uniform(-0.1, 0.1)),
                )
                scene.put(
                    objects.car(scene.rng),
                    ObjectClass.CAR,
                    x,
                    y,
                    yaw + np.pi * (scene.rng.random() < 0.3),
                    scene.rng.uniform(0.1, 0.7),
                )
            x, y, yaw = road.middle.pose2d(station + 3.1, side * (KERB + 0.6))
            _furniture(scene, (count + 2 * side) % 6, x, y, yaw - side * np.pi / 2)


def _furniture(scene: SimulatedScene, kind: int, x: float, y: float, inward: float) -> None:
    """One object on the edge of the pavement, facing the carriageway."""
    if kind in (0, 3):
        scene.tree(x, y, highest=7.5)
    elif kind == 1:
        scene.put(objects.lamp(), ObjectClass.POLE, x, y, inward)
    elif kind == 2:
        scene.put(objects.sign(), ObjectClass.TRAFFIC_SIGN, x, y, inward + np.pi / 2)
    elif kind == 4:
        scene.put(objects.bicycle(), ObjectClass.PARKED_BICYCLE, x, y, inward + np.pi / 2)
    else:
        scene.put(box(0.5, 0.45, 1.1), ObjectClass.OTHER_OBJECT, x, y, inward)


def _parking_cars(scene: SimulatedScene, road: Street, speed: float) -> tuple[float, float]:
    """One car parks and one parked car leaves.

    Returns the stations between which their bays stay free.
    """
    halfway = ENDS + scene.duration * speed / 2
    into = halfway + max(12.0, 0.3 * scene.duration * speed)  # the car parks ahead of the sensor
    out_of = into + 13
    stations = np.arange(0, road.length, 0.5)
    swing_in = np.interp(stations, [into - 14, into - 4], [LANE, BAY])
    path = road.middle.shifted(-_eased(swing_in))
    end = road.station(path, into, -BAY)
    latest = (
        into - ENDS - 5.0
    ) / 6.0 + 2.0  # to brake takes 2 s longer; at first, the car is 5 m ahead of the sensor
    stands = min(0.45 * scene.duration, latest)
    scene.move(ObjectClass.MOVING_CAR, path, arrive(end, 6.0, stands), objects.car(scene.rng))
    swing_out = np.interp(stations, [out_of + 2, out_of + 12], [BAY, LANE])
    path = road.middle.shifted(-_eased(swing_out))
    scene.move(
        ObjectClass.MOVING_CAR,
        path,
        depart(road.station(path, out_of, -BAY), 7.0, 0.5 * scene.duration),
        objects.car(scene.rng),
    )
    return into - 16, out_of + 16


def _eased(left: F64) -> F64:
    """Smooth lateral offsets between lane and bay."""
    share = (left - LANE) / (BAY - LANE)
    return LANE + (BAY - LANE) * share**2 * (3 - 2 * share)


def _traffic(scene: SimulatedScene, road: Street, speed: float, traffic: float) -> None:
    """Oncoming cars and lorries, spread over the recording.

    Cars and cyclists ahead of and behind the sensor.
    """
    oncoming = road.lane(LANE)
    same = road.lane(-LANE)
    edge = road.lane(-3.1)
    cars = max(2, round(0.2 * scene.duration * traffic))
    pace = 11.0
    for count in range(cars):
        meet = scene.duration * (count + scene.rng.uniform(0.3, 0.7)) / cars
        start = road.station(oncoming, ENDS + speed * meet, LANE) - pace * meet
        lorry = count % 4 == 1
        scene.move(
            ObjectClass.MOVING_TRUCK if lorry else ObjectClass.MOVING_CAR,
            oncoming,
            cruise(start, pace),
            objects.truck(scene.rng) if lorry else objects.car(scene.rng),
        )
    here = road.station(same, ENDS, -LANE)
    scene.move(ObjectClass.MOVING_CAR, same, cruise(here + 38, speed + 1.5), objects.car(scene.rng))
    scene.move(ObjectClass.MOVING_CAR, same, cruise(here - 24, speed), objects.car(scene.rng))
    for gap, lead in ((11, 0.8), (26, -1.0)):
        scene.move(
            ObjectClass.MOVING_BICYCLIST,
            edge,
            cruise(road.station(edge, ENDS + gap, -3.1), speed + lead),
            objects.cyclist,
        )


def _people(scene: SimulatedScene, road: Street, speed: float, traffic: float) -> None:
    """People along the walls and under the trees in both directions; one crosses.

    One stands for half of the time.
    """
    lefts = (7.0, -7.0, 7.7, -7.7, 8.5, -8.5)
    for count in range(max(8, round(1.5 * scene.duration * traffic))):
        left = lefts[count % 6]
        pace = scene.rng.uniform(1.1, 1.6)
        path = road.middle.shifted(left + 0.12 * np.sin(road.middle.distance / 3.0))
        path = path if count % 4 < 2 else path.reversed()
        meet = scene.rng.uniform(0, scene.duration)
        start = (
            road.station(path, ENDS + speed * meet + scene.rng.uniform(2, 22), left) - pace * meet
        )
        scene.walk(path, cruise(start, pace))
    halfway = ENDS + scene.duration * speed / 2
    standing = road.middle.shifted(-7.3)
    scene.walk(
        standing, depart(road.station(standing, halfway + 6, -7.3), 1.4, scene.duration / 2, 1.0)
    )
    across = Route(
        [road.middle.pose2d(road.crossing, left)[:2] for left in np.linspace(8.0, -8.0, 60)]
    )
    scene.walk(across, cruise(max(0.0, across.length / 2 - 1.3 * scene.duration / 2), 1.3))
