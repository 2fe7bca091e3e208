"""Random paths over the ground: arcs, and paths along the trajectory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F64
from dynaviz.synthetic.simulate.movers import Route

SPACING = 0.5  # metres between points of a path
# paths to choose from
ARCS = 300
FOLLOWED = 120
NEAREST = 4.0  # metres from the sensor
WITHIN = 0.3  # share of the wanted distance to the sensor
LANE = 3.5  # metres, width of a lane
# lanes to the left of the sensor's: most movers come towards it on the next lane
LANES = (
    -1,
    0,
    1,
    1,
    1,
    2,
)
# paths that keep pace with the sensor, and metres to it in its lane; half in others
BESIDE = 200
GAP = (8.0, 25.0)
FINE = 0.05  # metres between places at which the sensor is looked for on the road
AHEAD = 60.0  # metres by which the trajectory is extended at both ends


@dataclass(frozen=True, eq=False)
class Path:
    """A path: (P, 2) float64, metres, in the direction of travel.

    And the row that is reached at a chosen time.
    """

    xy: F64
    anchor: int


def arcs(
    sensor: F64, away: float, bend: float, longest: float, rng: np.random.Generator
) -> list[Path]:
    """Arcs in random directions through random places about ``away`` metres from the sensor, (2,)
    metres.
    """
    distance = _around(away, ARCS, rng)
    angle = rng.uniform(0, 2 * np.pi, ARCS)
    heading = rng.uniform(0, 2 * np.pi, ARCS)
    curvature = rng.normal(0, bend, ARCS)
    anchor = int(longest / 2 / SPACING)
    s = SPACING * np.arange(-anchor, anchor + 1)
    # Points of an arc with chords of SPACING: each step turns by curvature * SPACING.
    turn = heading[:, None] + curvature[:, None] * (s + SPACING / 2)
    x, y = (np.cumsum(SPACING * f(turn), axis=1) for f in (np.cos, np.sin))
    start = sensor + np.stack([distance * np.cos(angle), distance * np.sin(angle)], axis=1)
    xy = np.stack([x - x[:, anchor, None], y - y[:, anchor, None]], axis=-1) + start[:, None]
    return [Path(points, anchor) for points in xy]


def _around(away: float, count: int, rng: np.random.Generator) -> F64:
    """(N,) random distances around one, metres, that are not too near to the sensor."""
    near: F64 = np.maximum(NEAREST, away * rng.uniform(1 - WITHIN, 1 + WITHIN, count))
    return near


def road(positions: F64) -> Route | None:
    """The trajectory, (F, 2) metres, smoothed, and extended at both ends.

    None if the sensor hardly moves.
    """
    kept = [0]
    for row in range(1, len(positions)):
        if np.hypot(*(positions[row] - positions[kept[-1]])) > 1.5:
            kept.append(row)
    if len(kept) < 4:
        return None
    middle = positions[kept]
    middle[1:-1] = (middle[:-2] + middle[1:-1] + middle[2:]) / 3  # smooths the noise of the poses
    ends = [(middle[0] - middle[2], middle[0]), (middle[-1] - middle[-3], middle[-1])]
    first, last = (end + AHEAD * direction / np.hypot(*direction) for direction, end in ends)
    return Route(np.concatenate([[first], middle, [last]]), rounds=2)


def followed(
    route: Route, sensor: F64, away: float, longest: float, rng: np.random.Generator
) -> list[Path]:
    """Paths in the lanes of a road, about ``away`` metres ahead of or behind the sensor, (2,)
    metres.

    Those on its left lead mostly in the opposite direction.
    """
    station = route.distance[np.hypot(*(route.xy - sensor).T).argmin()]
    found = []
    for ahead in _around(away, FOLLOWED, rng) * rng.choice((-1, 1), FOLLOWED):
        left = float(rng.choice(LANES) * LANE + rng.normal(0, 0.3))
        along = station + ahead
        opposite = (left > 0) == (rng.random() < 0.8)
        line = route.shifted(left)
        at = float(np.interp(along, route.distance, line.distance))
        low = max(0.0, at - longest / 2)
        high = min(line.length, at + longest / 2)
        if high - low < 2 * SPACING or not low <= at <= high:
            continue
        s = np.arange(low, high, SPACING)
        x, y, _ = line.at(s)
        xy = np.stack([x, y], axis=1)
        anchor = int(np.clip((at - low) / SPACING, 0, len(s) - 1))
        found.append(Path(xy[::-1], len(s) - 1 - anchor) if opposite else Path(xy, anchor))
    return found


def stations(route: Route, positions: F64) -> F64:
    """(F,) metres along a route, never backwards, that are nearest to (F, 2) positions of the
    sensor.
    """
    from scipy.spatial import cKDTree

    fine = np.arange(0, route.length, FINE)
    x, y, _ = route.at(fine)
    _, nearest = cKDTree(np.column_stack([x, y])).query(positions)
    reached: F64 = np.maximum.accumulate(fine[nearest])
    return reached


def beside(
    route: Route, reached: F64, spare: float, rng: np.random.Generator
) -> list[tuple[Path, F64]]:
    """Paths in the lanes of a road at some distance ahead of, behind or next to the sensor all the
    time.

    Args:
        route: the road.
        reached: (F,) metres along it, of the sensor.
        spare: metres of path before the first and after the last position.
        rng: chooses lanes and distances.

    Returns:
        Of each, the path and (F,) metres along it.
    """
    found = []
    for _ in range(BESIDE):
        lane = int(rng.integers(-1, 2))
        ahead = float(rng.uniform(*GAP) * rng.choice((-1, 1)))
        line = route.shifted(lane * LANE + float(rng.normal(0, 0.3)))
        at = np.interp(
            reached + (ahead if lane == 0 else 0.5 * ahead), route.distance, line.distance
        )
        first = at[0] - spare
        last = at[-1] + spare
        if first >= 0 and last <= line.length:
            x, y, _ = line.at(np.arange(first, last, SPACING))
            found.append((Path(np.column_stack([x, y]), 0), at - first))
    return found


def paced(path: Path, before: float, after: float) -> Path:
    """A path to and fro that goes on for at least some metres before and after the anchor of a
    path.
    """
    turn = path.xy[-1] - path.xy[-2], path.xy[0] - path.xy[1]
    # the turn goes over the left
    steps = [0.1 * np.array([-y, x]) / np.hypot(x, y) for x, y in turn]
    forth = np.concatenate([path.xy, path.xy[-1:] + steps[0]])
    back = np.concatenate([path.xy[::-1], path.xy[:1] + steps[1]])
    length = SPACING * (len(path.xy) - 1)
    early = max(0, int(np.ceil((before - SPACING * path.anchor) / length)))
    late = max(0, int(np.ceil((after - length + SPACING * path.anchor) / length)))
    legs = [forth if leg % 2 == 0 else back for leg in range(-early, late + 1)]
    return Path(np.concatenate(legs)[:-1], sum(map(len, legs[:early])) + path.anchor)


def swerved(path: Path, aside: float, beyond: float) -> Path:
    """A path whose last 14 m move to the side (metres to the left), and go on straight for the
    length of a bumper.
    """
    line = Route(path.xy)
    left = np.clip((line.distance - line.distance[-1] + 14.0) / 10.0, 0, 1)
    shifted = line.shifted(aside * left**2 * (3 - 2 * left)).xy
    direction = (shifted[-1] - shifted[-2]) / np.hypot(*(shifted[-1] - shifted[-2]))
    steps = SPACING * np.arange(1, int(np.ceil(beyond / SPACING)) + 1)
    return Path(
        np.concatenate([shifted, shifted[-1] + steps[:, None] * direction]), len(shifted) - 1
    )
