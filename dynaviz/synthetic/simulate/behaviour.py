"""Movers that touch, brush and stop: the behaviour at which methods fail.

Each acts near the sensor at some time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from dynaviz.arrays import F64
from dynaviz.synthetic.ray_caster import RayCaster
from dynaviz.synthetic.simulate import objects
from dynaviz.synthetic.simulate.classes import ObjectClass
from dynaviz.synthetic.simulate.effects import Effects
from dynaviz.synthetic.simulate.lidar import REFLECTING
from dynaviz.synthetic.simulate.movers import (
    Height,
    Movement,
    Mover,
    Route,
    Schedule,
    arrive,
    cruise,
    depart,
)
from dynaviz.synthetic.simulate.scene import SimulatedScene
from dynaviz.synthetic.simulate.shapes import Mesh

# metres between a walker and a wall, and between a car and a parked car
BRUSH = 0.2
PASS = 0.5
# half widths of a person with arms and of a car, metres
SHOULDER = 0.31
CAR_SIDE = 0.88
# metres that the middle of a walker and of a car keep from anything static
WALKING = 0.25
DRIVING = 0.85
# metres from the sensor at the time of the event
NEAREST = 3.0
FARTHEST = 14.0
GROUP = ((0.0, 0.0), (0.0, 0.55), (-0.42, 0.27), (-0.42, -0.28), (-0.84, 0.0), (-0.84, 0.55))
"""Places in a crowd, metres ahead and to the left; the arms of neighbours touch."""
TRIES = 40  # candidates for the place of an event


@dataclass(frozen=True, eq=False)
class Anchored(Movement):
    """A motion on the spot: the body changes with the schedule, the pose stays that of the start of
    the path.
    """

    def poses(self, times: Sequence[float], height: Height) -> list[F64 | None]:
        """(4, 4) float64 pose on the ground in the scene frame, for each time."""
        return Movement(self.path, lambda _: 0.0, upright=True).poses(times, height)


def populate(scene: SimulatedScene, effects: Effects, rng: np.random.Generator) -> None:
    """Add the movers of the effects to a scene, with random numbers of their own."""
    stage = Stage(scene, rng)
    acts: dict[str, Callable[[Stage, float], None]] = {
        "brushing": _brush,
        "passing": _pass,
        "crowds": _crowd,
        "doors": _door,
        "trolleys": _trolley,
        "sitting": _sit,
        "animals": _animal,
        "parking": _park,
    }
    for name, act in acts.items():
        number = getattr(effects, name)
        for k in range(number):
            stage.turn = k
            act(stage, scene.duration * (k + 0.5) / number)


class Stage:
    """The scene as the movers see it: where there is room, and where the sensor is.

    Attributes:
        scene: the scene; movers are added to it.
        rng: random numbers.
        turn: number of the mover among those of its kind.
        taken: (2,) places where vehicles park, metres.
    """

    def __init__(self, scene: SimulatedScene, rng: np.random.Generator):
        self.scene = scene
        self.rng = rng
        self.turn = 0
        self.taken: list[F64] = []
        self._static = RayCaster(part.mesh for part in scene.parts if part.kind not in REFLECTING)
        self._times = np.arange(0, scene.duration + 0.1, 0.1)
        self._sensor = np.array([self.sensor(float(t)) for t in self._times])

    def sensor(self, time: float) -> F64:
        """(2,) metres: the sensor at a time."""
        path = self.scene.sensor.path
        return np.array(path.at(self.scene.sensor.schedule(time))[:2])

    def clearance(self, xy: F64) -> F64:
        """(N,) metres from anything static to the axis of a body at (N, 2) places."""
        ground = self.scene.height(xy[:, 0], xy[:, 1])
        levels = [np.column_stack([xy, ground + z]).astype(np.float32) for z in (0.3, 0.8, 1.4)]
        lowest: F64 = np.min([self._static.clearance(level) for level in levels], axis=0).astype(
            np.float64
        )
        return lowest

    def near(self, routes: Iterable[Route], time: float) -> Iterator[tuple[Route, float]]:
        """Routes with their point near the sensor at a time (distance along the route, metres), in
        random order.
        """
        here = self.sensor(time)
        found = []
        for route in routes:
            away = np.hypot(*(route.xy - here).T)
            for at in np.flatnonzero((away > NEAREST) & (away < FARTHEST))[::4]:
                found.append((route, float(route.distance[at])))
        if not found:
            found = [(route, route.length / 2) for route in routes]
        for k in self.rng.permutation(len(found))[:TRIES]:
            yield found[int(k)]

    def free(self, route: Route, start: float, end: float, room: float) -> bool:
        """Whether a body of this half width, metres, has room between two distances
        along a route.
        """
        steps = np.arange(max(start, 0.0), min(end, route.length), 0.3)
        return len(steps) > 1 and bool(
            self.clearance(np.column_stack(route.at(steps)[:2])).min() > room
        )

    def apart(self, route: Route, schedule: Schedule, least: float = 1.6) -> bool:
        """Whether a mover keeps this distance from the sensor, metres."""
        places = np.column_stack(route.at(np.array([schedule(float(t)) for t in self._times]))[:2])
        return bool(np.hypot(*(places - self._sensor).T).min() > least)

    def person(self, route: Route, schedule: Schedule) -> None:
        """Add a person."""
        height = self.rng.uniform(1.55, 1.9)
        self.add(
            ObjectClass.MOVING_PERSON,
            Movement(route, schedule, True),
            lambda d: objects.person(d, height),
        )

    def add(
        self, kind: ObjectClass, motion: Movement, body: Mesh | Callable[[float], Mesh]
    ) -> None:
        """Add a mover."""
        shape = body if callable(body) else lambda _: body
        number = len(self.scene.movers) + 1
        self.scene.movers.append(Mover(kind, number, motion, shape, self.rng.uniform(0.12, 0.7)))


def through(route: Route, at: float, time: float, pace: float) -> Schedule:
    """Pass a point of a route at a time; wait at both ends of the route."""
    return lambda now: float(np.clip(at + pace * (now - time), 0.0, route.length))


def halting(route: Route, at: float, time: float, pace: float, wait: float) -> Schedule:
    """As ``through``, but stand at the point for ``wait`` seconds, half of them before the time."""
    return lambda now: float(
        np.clip(
            at + pace * (min(now - time + wait / 2, 0.0) + max(now - time - wait / 2, 0.0)),
            0.0,
            route.length,
        )
    )


def _brush(stage: Stage, time: float) -> None:
    """A walker along a wall, or around a parked car or a pillar (every second one)."""
    places = stage.scene.places
    pace = stage.rng.uniform(0.9, 1.4)
    walls = [wall.shifted(BRUSH + SHOULDER) for wall in places.walls]
    rounds = [_around(*obstacle) for obstacle in places.obstacles]
    routes = rounds if stage.turn % 2 and rounds else walls
    for route, at in stage.near(routes, time):
        path, centre = _free_part(stage, route, at)
        if path is None:
            continue
        schedule = through(path, centre, time, pace)
        if stage.apart(path, schedule):
            return stage.person(path, schedule)
    return None


def _free_part(stage: Stage, route: Route, at: float) -> tuple[Route | None, float]:
    """The part of a route around a point on which a walker has room, at least 4 m long.

    And the point on it.
    """
    steps = np.arange(0, route.length, 0.2)
    places = np.column_stack(route.at(steps)[:2])
    blocked = np.flatnonzero(stage.clearance(places) < WALKING)
    low = blocked[blocked * 0.2 <= at].max(initial=-1) + 1
    high = blocked[blocked * 0.2 > at].min(initial=len(steps))
    if high - low < 20:
        return None, 0.0
    return Route(places[low:high]), at - low * 0.2


def _around(x: float, y: float, yaw: float, long: float, wide: float) -> Route:
    """One and a half rounds about an obstacle, at the distance of a walker who brushes along it."""
    gap = BRUSH + SHOULDER
    corners = []
    turn = np.linspace(0, np.pi / 2, 6)
    for quarter, (a, b) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1), (1, 1), (-1, 1))):
        angle = turn + quarter * np.pi / 2
        corners += [(a * long + gap * np.cos(t), b * wide + gap * np.sin(t)) for t in angle]
    corner = np.array(corners)
    steps = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(corner, axis=0).T))])
    dense = np.arange(0, steps[-1], 0.15)
    local = np.column_stack([np.interp(dense, steps, column) for column in corner.T])
    c = np.cos(yaw)
    s = np.sin(yaw)
    return Route(local @ np.array([[c, s], [-s, c]]) + (x, y))


def _pass(stage: Stage, time: float) -> None:
    """A car that passes parked cars.

    Its lane is shifted until it drives past the nearest one at 0.5 m.
    """
    indoors = not any(part.kind == ObjectClass.ROAD for part in stage.scene.parts)
    lanes = stage.scene.places.lanes
    lane = lanes[stage.turn % len(lanes)]
    pace = 1.8 if indoors else stage.rng.uniform(5.0, 8.0)
    side = 0.55 if indoors else CAR_SIDE
    path = _beside(lane, stage.scene.places.obstacles, PASS + side)
    body = objects.forklift(stage.rng) if indoors else objects.car(stage.rng)
    kind = ObjectClass.MOVING_OTHER_VEHICLE if indoors else ObjectClass.MOVING_CAR
    away = np.hypot(*(path.xy - stage.sensor(time)).T)
    for ahead in (0.0, 8.0, -8.0, 16.0, -16.0):
        at = float(np.clip(path.distance[away.argmin()] + ahead, 0, path.length))
        schedule = cruise(at - pace * time, pace)
        if stage.apart(path, schedule, 1.8 if indoors else 2.6):
            return stage.add(kind, Movement(path, schedule), body)
    return None


def _beside(
    lane: Route, obstacles: list[tuple[float, float, float, float, float]], gap: float
) -> Route:
    """The lane shifted towards the obstacles at its side, so that ``gap`` metres remain to the
    nearest.
    """
    offsets = []
    for x, y, _, _, wide in obstacles:
        k = int(np.argmin(np.hypot(*(lane.xy - (x, y)).T)))
        dx, dy = np.array([x, y]) - lane.xy[k]
        left = -np.sin(lane.yaw[k]) * dx + np.cos(lane.yaw[k]) * dy
        if 1.2 < abs(left) < 4.5:
            offsets.append(left - np.sign(left) * wide)
    if not offsets:
        return lane
    edge = min(offsets, key=abs)
    return lane.shifted(edge - np.sign(edge) * gap)


def _crowd(stage: Stage, time: float) -> None:
    """Six people who walk closely together, stop, and go on.

    One who comes towards them squeezes past.
    """
    for way, at in stage.near(stage.scene.places.walkways, time):
        schedule = halting(way, at, time, 1.1, 0.2 * stage.scene.duration)
        if not (stage.free(way, at - 3, at + 3, 0.7) and stage.apart(way, schedule, 2.4)):
            continue
        for ahead, left in GROUP:
            stage.person(way.shifted(left - 0.15), _led(schedule, ahead, way.length))
        back = way.reversed().shifted(0.55)
        stage.person(back, through(back, max(0.0, back.length - at), time, 1.2))
        return


def _led(schedule: Schedule, ahead: float, length: float) -> Schedule:
    return lambda now: float(np.clip(schedule(now) + ahead, 0.0, length))


def _door(stage: Stage, time: float) -> None:
    """A door in a wall: it opens in 1.5 s, stays open for a fifth of the time, and closes."""
    stays = 0.2 * stage.scene.duration

    def share(now: float) -> float:
        return float(
            np.clip(min(now - time + stays / 2, time + stays / 2 - now) / 1.5 + 1.0, 0.0, 1.0)
        )

    for wall, at in stage.near(stage.scene.places.walls, time):
        hinge = wall.pose2d(at, 0.02)
        swing = wall.pose2d(at + 0.5, 0.6)[:2]
        if at > wall.length - 1.2 or stage.clearance(np.array([swing]))[0] < 0.45:
            continue
        direction = np.array([np.cos(hinge[2]), np.sin(hinge[2])])
        path = Route(np.array([hinge[:2], hinge[:2] + direction]))
        return stage.add(ObjectClass.MOVING_DOOR, Anchored(path, share, True), objects.door)
    return None


def _trolley(stage: Stage, time: float) -> None:
    """Someone pushes a trolley and stops with it for a while."""
    for way, at in stage.near(stage.scene.places.walkways, time):
        schedule = halting(way, at, time, 1.0, 0.15 * stage.scene.duration)
        if stage.free(way, at - 3, at + 3, 0.4) and stage.apart(way, schedule):
            stage.person(way, schedule)
            pushed = Movement(way, _led(schedule, 0.85, way.length), True)
            return stage.add(ObjectClass.MOVING_OTHER_VEHICLE, pushed, objects.trolley())
    return None


def _sit(stage: Stage, time: float) -> None:
    """A bench at a wall, which is static, and someone who walks up to it and sits down."""
    for wall, at in stage.near(stage.scene.places.walls, time):
        x, y, yaw = wall.pose2d(at, 0.45)
        if not 4.5 < at < wall.length - 1.0 or stage.clearance(np.array([(x, y)]))[0] < 0.35:
            continue
        path = Route(
            [
                wall.pose2d(at - 4.0, 1.6)[:2],
                wall.pose2d(at - 2.0, 1.3)[:2],
                wall.pose2d(at, 0.95)[:2],
            ],
            rounds=3,
        )
        schedule = _clipped(arrive(path.length, 1.1, time))
        if not stage.apart(path, schedule):
            continue
        stage.scene.put(objects.bench(), ObjectClass.OTHER_OBJECT, x, y, yaw + np.pi / 2)
        body = partial(objects.sitter, end=path.length, height=stage.rng.uniform(1.55, 1.9))
        return stage.add(ObjectClass.MOVING_PERSON, Movement(path, schedule, True), body)
    return None


def _clipped(schedule: Schedule) -> Schedule:
    """Wait at the start of the route."""
    return lambda now: max(0.0, schedule(now))


def _animal(stage: Stage, time: float) -> None:
    """A dog that runs from side to side and stops to sniff."""
    for way, at in stage.near(stage.scene.places.walkways, time):
        path = way.shifted(0.35 * np.sin(way.distance / 1.3))
        schedule = halting(path, at, time, 1.9, 0.1 * stage.scene.duration)
        if stage.free(path, at - 4, at + 4, 0.2) and stage.apart(path, schedule):
            return stage.add(ObjectClass.MOVING_ANIMAL, Movement(path, schedule, True), objects.dog)
    return None


def _park(stage: Stage, time: float) -> None:
    """A vehicle that arrives and parks, waits for 30 % of the recording, and leaves."""
    duration = stage.scene.duration
    bays = stage.scene.places.bays
    come = 0.3 * duration
    go = 0.6 * duration
    here = stage.sensor(0.5 * duration)
    order = sorted(
        bays, key=lambda bay: float(abs(np.hypot(*(np.array(bay[0].at(bay[1])[:2]) - here)) - 8.0))
    )
    indoors = not any(part.kind == ObjectClass.ROAD for part in stage.scene.parts)
    slow, room = (0.3, 0.5) if indoors else (1.0, DRIVING)
    for path, stop in order:
        place = np.array(path.at(stop)[:2])
        if any(np.hypot(*(place - other)) < 7.0 for other in stage.taken):
            continue
        schedule = _parked(arrive(stop, 5.0, come), depart(stop, 5.0, go), stop, go, slow)
        if stage.free(path, stop - 9 * slow, stop + 9 * slow, room) and stage.apart(
            path, schedule, 2.0
        ):
            body = objects.forklift(stage.rng) if indoors else objects.car(stage.rng)
            kind = ObjectClass.MOVING_OTHER_VEHICLE if indoors else ObjectClass.MOVING_CAR
            stage.taken.append(place)
            return stage.add(kind, Movement(path, schedule), body)
    return None


def _parked(coming: Schedule, leaving: Schedule, stop: float, go: float, slow: float) -> Schedule:
    """Arrive, wait, leave; at a share ``slow`` of the speed."""
    return lambda now: stop + slow * ((coming(now) if now < go else leaving(now)) - stop)
