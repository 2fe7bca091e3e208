"""Choose paths and schedules for movers in the free space of a sequence."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F64, Bool
from dynaviz.synthetic.implants.implant_options import ImplantOptions
from dynaviz.synthetic.implants.implant_scene import Implant, MoverKind
from dynaviz.synthetic.implants.paths import (
    NEAREST,
    SPACING,
    Path,
    arcs,
    beside,
    followed,
    paced,
    road,
    stations,
    swerved,
)
from dynaviz.synthetic.implants.schedule import cruise, park, pause, stand
from dynaviz.synthetic.implants.space import TALL, SpaceAboveGround
from dynaviz.synthetic.implants.survey import CELL, Survey, part
from dynaviz.synthetic.simulate.movers import Route

MARGIN = 0.1  # metres to obstacles, in addition to the rounding of the grid
VISIBLE = 50.0  # metres from the sensor
# metres that a mover moves, and at least its length: nothing shows that one moves that moves less
MOVED = 0.9
SEEN = (
    0.5  # share of the frames near the sensor in which a mover is not hidden; 10 frames are enough
)
GLANCES = 20  # frames in which that is checked
LONG = 4.0  # seconds; in a shorter recording, a mover that waits would hardly move
STEEPEST = 0.15  # metres per metre
# metres from the sensor to vehicles that wait or park: nearer, one of them returns most points
STANDING = 8.0
# metres from the sensor; farther away, few rays hit a mover. Less if the ground is not visible as
# far
FADED = 50.0
IN_LANE = (
    0.8  # share of vehicles and cyclists that keep to a lane along the trajectory; the others cross
)
APART = 0.4  # metres to dynamic points and other movers
TRIPS = 3  # times and speeds to try
TRIED = 60  # best paths for which a schedule is checked
DRIVING = 3.0  # m/s; a faster sensor drives on a road
ROADWAY = 3.0  # metres from the middle of the sensor's lane
GOLDEN = (
    0.6180339887498949  # multiples of the golden ratio, without the whole part, are spread evenly
)
# seconds for which a mover that keeps pace goes on before the first and after the last frame
SPARE = 0.2
TIGHT = 0.6  # metres; a path this close to obstacles brushes along them


@dataclass(frozen=True)
class Kind:
    """What movers of a kind need and do.

    Attributes:
        discs: centres along the axis, metres, of the discs that cover the footprint.
        radius: of a disc, metres.
        speeds: lowest and highest, m/s.
        bend: standard deviation of the curvature, 1/m.
        lengths: shortest and longest path, metres.
        braking: m/s^2.
        far: metres from the sensor; movers are spread evenly up to this range, or as far as the
            ground is visible.
        berth: metres to the sensor, in addition to the radius.
        tall: height class in ``FreeSpace.clearance``.
    """

    discs: tuple[float, ...]
    radius: float
    speeds: tuple[float, float]
    bend: float
    lengths: tuple[float, float]
    braking: float
    far: float
    berth: float
    tall: str = "low"


KINDS: dict[MoverKind, Kind] = {
    "car": Kind(
        (-1.9, -0.95, 0.0, 0.95, 1.9), 1.05, (4.0, 12.0), 0.006, (14.0, 120.0), 2.5, 45.0, 2.0
    ),
    "truck": Kind(
        (-3.7, -2.2, -0.75, 0.75, 2.2, 3.7),
        1.5,
        (4.0, 9.0),
        0.004,
        (16.0, 120.0),
        2.0,
        45.0,
        5.0,
        "high",
    ),
    "cyclist": Kind((-0.45, 0.0, 0.45), 0.5, (3.0, 5.5), 0.01, (10.0, 80.0), 1.5, 40.0, 1.6),
    "person": Kind((-0.2, 0.0, 0.2), 0.38, (0.9, 1.7), 0.04, (4.0, 30.0), 1.0, 35.0, 1.4),
}
STOPS = ("waits", "parks", "stands")
ORDER: dict[str, MoverKind] = {
    "trucks": "truck",
    "cars": "car",
    "parks": "car",
    "cyclists": "cyclist",
    "persons": "person",
}
"""Kind of each option; the largest are placed first."""


@dataclass(frozen=True, eq=False)
class Plan:
    """The movers that found a place, and how many of each option did not."""

    implants: tuple[Implant, ...]
    missing: Counter[str]


def plan(options: ImplantOptions, survey: Survey, space: SpaceAboveGround) -> Plan:
    """Place movers one after another; the same options and scans give the same plan.

    Each mover takes the best of some random paths: arcs through the free space near the sensor, and
    paths that follow the trajectory at some offset. It keeps clear of every point that is not
    dynamic, of dynamic points and other movers at the time, and of the sensor.
    """
    planner = _Planner(survey, space)
    placed: list[Implant] = []
    missing: Counter[str] = Counter()
    first = 10 ** len(str(survey.instances)) if survey.instances else 0
    for stream, (option, name) in enumerate(ORDER.items()):
        for number in range(getattr(options, option)):
            rng = np.random.default_rng([options.seed, 1, stream, number])
            found = planner.place(name, option == "parks", number, first + len(placed) + 1, rng)
            if found is None:
                missing[option] += 1
            else:
                placed.append(found)
    return Plan(tuple(placed), missing)


@dataclass(frozen=True)
class Trip:
    """What a mover does on its path.

    Attributes:
        behaviour: ``cruise``, ``waits``, ``parks``, or ``stands``: at both ends of the path.
        frame: position of the frame at which it passes the anchor of the path.
        speed: m/s.
        wait: seconds, at the anchor.
        stop: time in seconds at which it has parked.
        away: metres from the sensor to the anchor, about.
    """

    behaviour: str
    frame: int
    speed: float
    wait: float
    stop: float
    away: float

    def schedule(self, path: Path, times: F64, braking: float, behaviour: str) -> F64:
        """(K, 2) seconds, and metres along the path."""
        along = Route(path.xy).distance
        length = float(along[-1])
        at = float(along[path.anchor])
        time = float(times[self.frame])
        if behaviour == "parks":
            return park(0.0, length, self.speed, self.stop, times[-1] + 1, braking)
        if behaviour == "waits":
            return pause(0.0, length, self.speed, at, time - self.wait / 2, self.wait, braking)
        if behaviour == "stands":
            time = self.stop if self.behaviour == "parks" else time
            return stand(length, self.speed, at, time, (times[0] - 1, times[-1] + 1), braking)
        return cruise(0.0, length, self.speed, at, time).round(3)

    def paced(self, path: Path, times: F64) -> Path:
        """A path to and fro that lasts for the whole recording."""
        before = times[self.frame] - times[0]
        after = times[-1] - times[self.frame]
        return paced(path, self.speed * (before + 1), self.speed * (after + 1))


class _Planner:
    """Places movers; each keeps clear of the earlier ones."""

    def __init__(self, survey: Survey, space: SpaceAboveGround) -> None:
        from scipy.spatial import cKDTree

        self._survey = survey
        self._space = space
        self._tracks: list[tuple[F64, float]] = []
        steps = np.hypot(*np.diff(survey.positions[:, :2], axis=0).T) / np.diff(survey.times)
        self._pace = float(np.median(steps)) if len(steps) else 0.0
        self._road = road(survey.positions[:, :2])
        if self._road:
            x, y, _ = self._road.at(np.arange(0, self._road.length, SPACING))
            self._lane = cKDTree(np.column_stack([x, y]))
        apart, _ = cKDTree(survey.positions[:, :2]).query(space.known_ground())
        self._faded = min(FADED, float(np.quantile(apart, 0.9)))

    def place(
        self, name: MoverKind, parks: bool, number: int, instance: int, rng: np.random.Generator
    ) -> Implant | None:
        """Place one mover, or return None if no path fits, also at other times and speeds."""
        tries = (self._place(name, parks, number, instance, rng) for _ in range(TRIPS))
        return next((mover for mover in tries if mover), None)

    def _place(
        self, name: MoverKind, parks: bool, number: int, instance: int, rng: np.random.Generator
    ) -> Implant | None:
        kind = KINDS[name]
        survey = self._survey
        brushes = name == "person" and number % 2 == 1
        trip = self._trip(kind, parks, number, rng)
        shape = int(rng.integers(2**31))
        along = self._along(kind, rng) if name == "car" and number % 4 == 1 and not parks else []
        for path, schedule, note in itertools.chain(along, self._ways(kind, trip, brushes, rng)):
            track = np.column_stack([path.xy, self._space.height(path.xy)]).round(3)
            mover = Implant(name, instance, shape, track, schedule, note)
            discs = footprints(mover, survey.times)
            berth = max(kind.berth, STANDING) if note in STOPS and kind.radius > 1 else kind.berth
            if self._free(discs, kind.radius, berth) and not self._pops(discs, kind.radius):
                self._tracks.append((discs, kind.radius))
                return mover
        return None

    def _ways(
        self, kind: Kind, trip: Trip, brushes: bool, rng: np.random.Generator
    ) -> Iterator[tuple[Path, F64, str]]:
        """Paths with schedules, the best first, and what they are called."""
        notes = {"cruise": "brushes along obstacles" if brushes else "moves"}
        times = self._survey.times
        paths = list(self._best_paths(kind, trip, brushes, rng))
        if kind is KINDS["person"]:
            paths = [trip.paced(path, times) for path in paths]
        for behaviour in (trip.behaviour, "stands"):
            for path in paths:
                yield (
                    path,
                    trip.schedule(path, times, kind.braking, behaviour),
                    notes.get(behaviour, behaviour),
                )

    def _along(self, kind: Kind, rng: np.random.Generator) -> Iterator[tuple[Path, F64, str]]:
        """Free paths with schedules of vehicles that keep pace with a sensor on a road, near it all
        the time.
        """
        if self._road is None or self._pace <= DRIVING:
            return
        survey = self._survey
        spare = self._pace * SPARE
        reached = stations(self._road, survey.positions[:, :2])
        times = np.concatenate(
            [[survey.times[0] - SPARE], survey.times, [survey.times[-1] + SPARE]]
        )
        for path, metres in beside(self._road, reached, kind.discs[-1] + spare, rng):
            if self._open(path.xy, kind).all():
                knots = np.concatenate([[metres[0] - spare], metres, [metres[-1] + spare]])
                yield path, np.column_stack([times, knots]).round(3), "keeps pace"

    def _trip(self, kind: Kind, parks: bool, number: int, rng: np.random.Generator) -> Trip:
        """What a mover does, when, where and how fast.

        Vehicles keep pace with the sensor if that is fast.
        """
        times = self._survey.times
        duration = times[-1] - times[0]
        waits = number % 3 == 2 and duration > LONG and not parks
        speed = float(rng.uniform(*kind.speeds))
        if kind.radius > 1:
            speed *= max(1.0, self._pace / float(np.mean(kind.speeds)))
        frame = int(rng.integers(len(times)))
        wait = min(float(rng.uniform(0.15, 0.4)) * duration, 8.0)
        stop = times[0] + float(rng.uniform(0.3, 0.6)) * duration
        away = NEAREST + (min(kind.far, self._faded) - NEAREST) * (
            (number + float(rng.random())) * GOLDEN % 1
        )
        return Trip(
            "parks" if parks else "waits" if waits else "cruise", frame, speed, wait, stop, away
        )

    def _best_paths(
        self, kind: Kind, trip: Trip, brushes: bool, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Free parts of random paths, the best first.

        For vehicles and cyclists, lanes first or crossings first.
        """
        anchor = self._survey.positions[trip.frame, :2]
        parks = trip.behaviour == "parks"
        walks = kind.radius < 0.4
        keeps_lane = bool(rng.random() < IN_LANE)
        candidates = [*arcs(anchor, trip.away, kind.bend, kind.lengths[1], rng)]
        crossing = len(candidates)
        if self._road and not walks:
            candidates += followed(self._road, anchor, trip.away, kind.lengths[1], rng)
        scored: list[tuple[bool, float, int, Path]] = []
        for number, candidate in enumerate(candidates):
            path = self._trimmed(candidate, kind)
            if path is None or (parks and SPACING * path.anchor < kind.lengths[0]):
                continue
            if parks:
                path = self._beside(Path(path.xy[: path.anchor + 1], path.anchor), kind)
            clear = self._space.clear(path.xy, kind.tall) - kind.radius
            score = min(SPACING * len(path.xy) / kind.lengths[1], 1.0) + 0.3 * rng.random()
            score += 0.5 * self._in_sight(anchor, path.xy[path.anchor])
            score += 1.5 * float((clear < TIGHT).mean()) if brushes else 0.0
            score -= float(clear[-1]) / 4 if parks else 0.0
            if walks and self._pace > DRIVING and self._road:  # persons do not walk on the road
                apart, _ = self._lane.query(path.xy)
                score -= float(np.mean(apart < ROADWAY))
            second = not walks and keeps_lane != (number >= crossing)
            scored.append((second, -score, number, path))
        tried: Counter[bool] = Counter()
        for second, _, _, path in sorted(scored):
            tried[second] += 1
            if tried[second] <= TRIED:
                yield path

    def _trimmed(self, path: Path, kind: Kind) -> Path | None:
        """The free part of a path around its anchor; None if it is too short or too steep."""
        free = self._open(path.xy, kind)
        if not free[path.anchor]:
            return None
        before = free[: path.anchor][::-1]
        after = free[path.anchor :]
        first = path.anchor - (int(before.argmin()) if not before.all() else len(before))
        last = path.anchor + (int(after.argmin()) if not after.all() else len(after)) - 1
        spare = int(np.ceil(kind.discs[-1] / SPACING))  # the body reaches beyond its centre
        first = first + spare
        last = last - spare
        if SPACING * (last - first) < kind.lengths[0] or not first <= path.anchor <= last:
            return None
        return Path(path.xy[first : last + 1], path.anchor - first)

    def _open(self, xy: F64, kind: Kind) -> Bool:
        """(N,) bool: whether a disc fits at each of (N, 2) points, on ground that is not steep."""
        z = self._space.height(xy)
        # False where the ground is unknown
        flat = np.abs(np.diff(z, append=z[-1])) <= STEEPEST * SPACING
        return flat & (self._space.clear(xy, kind.tall) >= kind.radius + MARGIN)

    def _beside(self, path: Path, kind: Kind) -> Path:
        """A path whose end swerves to the side, as far as there is room."""
        for aside in (2.5, -2.5, 2.0, -2.0, 1.5, -1.5, 1.0, -1.0):
            other = swerved(path, aside, kind.discs[-1])
            if self._open(other.xy, kind).all():
                return Path(other.xy[: len(path.xy)], other.anchor)
        return path

    def _in_sight(self, a: F64, b: F64) -> bool:
        """Whether no obstacle lies between two places, (2,) metres."""
        steps = np.linspace(0, 1, int(np.hypot(*(b - a)) / CELL) + 2)[:, None]
        column = np.floor((a + steps * (b - a)) / CELL).astype(np.int64) - self._space.origin
        column = column[((column >= 0) & (column < self._space.shape)).all(1)]
        return not (self._space.lowest[column[:, 0], column[:, 1]] < TALL["low"]).any()

    def _free(self, discs: F64, radius: float, berth: float) -> bool:
        """Whether a mover is seen to move, and keeps clear of the sensor, of dynamic points and of
        other movers.
        """
        survey = self._survey
        to_sensor = _distance(discs, survey.positions[:, None, :2])
        if (to_sensor < radius + berth).any():
            return False
        for other, other_radius in self._tracks:
            if (_distance(discs, other) < radius + other_radius + APART).any():
                return False
        for frame in np.flatnonzero(np.isfinite(discs[:, 0, 0])):
            points = self._moving(int(frame))
            if (
                len(points)
                and _distance(discs[frame : frame + 1], points[None]).min() < radius + APART
            ):
                return False
        return self._shows(discs, to_sensor)

    def _moving(self, frame: int) -> F64:
        """(N, 2) metres: where movers of the sequence are."""
        known = self._survey.dynamic[frame][:, :2].astype(np.float64)
        return np.concatenate([known, self._space.passed(part(frame, len(self._survey.times)))])

    def _shows(self, discs: F64, to_sensor: F64) -> bool:
        """Whether a mover, where the sensor sees it, moves by its length in enough frames."""
        near = np.flatnonzero(to_sensor < VISIBLE)
        if len(near) < max(1, min(10, SEEN * len(discs))):
            return False
        frames = near[np.unique(np.linspace(0, len(near) - 1, GLANCES).round().astype(int))]
        seen = frames[[not self._hidden(f, discs[f].mean(0)) for f in frames]]
        if len(seen) < SEEN * len(frames):
            return False
        centre = discs[seen].mean(1)
        length = float(np.hypot(*(discs[seen[0], -1] - discs[seen[0], 0])))
        # a shorter recording asks for less
        duration = min(1.0, float(self._survey.times[-1] - self._survey.times[0]))
        return float(np.hypot(*(centre - centre[0]).T).max()) >= max(MOVED, length) * duration

    def _hidden(self, frame: int, place: F64) -> bool:
        """Whether an obstacle or an earlier mover lies between the sensor and a
        place, (2,) metres.
        """
        sensor = self._survey.positions[frame, :2]
        if not self._in_sight(sensor, place):
            return True
        away = float(np.hypot(*(place - sensor)))
        ahead = (place - sensor) / max(away, 1e-9)
        for other, radius in self._tracks:
            offset = other[frame] - sensor
            along = offset @ ahead
            aside = offset @ np.array([-ahead[1], ahead[0]])
            if ((np.abs(aside) < radius) & (along > 0) & (along < away)).any():
                return True
        return False

    def _pops(self, discs: F64, radius: float) -> bool:
        """Whether a mover appears or disappears within the recording where the sensor sees it."""
        present = np.flatnonzero(np.isfinite(discs[:, 0, 0]))
        for frame, end in ((present[0], 0), (present[-1], len(discs) - 1)):
            near = np.hypot(*(discs[frame] - self._survey.positions[frame, :2]).T) < self._faded
            if frame != end and (near & self._survey.in_sight(frame, discs[frame], radius)).any():
                return True
        return False


def footprints(mover: Implant, times: F64) -> F64:
    """(F, D, 2) metres: centres of the mover's discs in the plane at some times.

    NaN while it is absent.
    """
    seconds, metres = mover.schedule.T
    x, y, yaw = mover.route.at(np.interp(times, seconds, metres))
    along = np.array(KINDS[mover.kind].discs)
    centres = np.stack(
        [x[:, None] + along * np.cos(yaw)[:, None], y[:, None] + along * np.sin(yaw)[:, None]],
        axis=-1,
    )
    centres[(times < seconds[0]) | (times > seconds[-1])] = np.nan
    return centres


def _distance(a: F64, b: F64) -> F64:
    """(F,) smallest distance between (F, A, 2) and (F, B, 2) in each frame.

    Infinite where one is absent.
    """
    offset = a[:, :, None] - b[:, None]
    apart = np.hypot(offset[..., 0], offset[..., 1])
    nearest: F64 = np.where(np.isnan(apart), np.inf, apart).min((1, 2))
    return nearest
