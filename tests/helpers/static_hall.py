"""A static hall with a box that changes its place in every frame: dense rays, exact labels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from dynaviz.arrays import F64, Bool
from dynaviz.contracts.scan import Label, Scan
from dynaviz.contracts.sensors import Sensor

RINGS, ELEVATION, HEIGHT = 40, (-22.0, 8.0), 1.8
# columns, and the degrees ahead that they cover; half a turn takes half the time
AZIMUTHS, VIEW = (
    220,
    180.0,
)
SENSOR = Sensor(
    name="hall", title="a sensor of 40 rings", rings=RINGS, elevation=ELEVATION, height=HEIGHT
)
WALLS = 14.0  # metres from the centre
HALF = np.array([0.6, 0.6, 0.7])  # half edges of the box, metres
PLACES = 10  # places of the box, on arcs around the sensor
NOISE = 0.01  # metres, along the ray


def hall(
    frames: int = PLACES,
    box: bool = True,
    seed: int = 0,
    standing: Sequence[tuple[F64, F64]] = (),
    fixed: bool = False,
) -> list[Scan]:
    """Scans of a slowly moving sensor; the box is 0.2 m above the ground, 6 to 9 m away.

    Args:
        frames: number of scans.
        box: whether there is the box that changes its place.
        seed: of the noise.
        standing: centre and half edges, (3,) metres each, of boxes that stand still.
        fixed: whether the sensor does not move.
    """
    random, scans = np.random.default_rng(seed), []
    for frame in range(frames):
        T_world_sensor = np.eye(4)
        T_world_sensor[:3, 3] = origin = np.array(
            [0.0 if fixed else 0.07 * frame, 0.0 if fixed else 0.03 * frame, HEIGHT]
        )
        rays = _rays(random.uniform(0, VIEW / AZIMUTHS))
        with np.errstate(divide="ignore"):
            walls = ((np.where(rays > 0, WALLS, -WALLS) - origin) / rays)[:, :2].min(1)
            ground = np.where(rays[:, 2] < 0, -origin[2] / rays[:, 2], np.inf)
        still = np.minimum.reduce(
            [walls, ground, *(_to_box(origin, rays, *each) for each in standing)]
        )
        moving = _to_box(origin, rays, _place(frame), HALF) if box else np.inf
        ranges = np.minimum(still, moving) + random.normal(0, NOISE, len(rays))
        labels = np.where(moving < still, Label.DYNAMIC, Label.STATIC).astype(np.uint8)
        points = (origin + ranges[:, None] * rays).astype(np.float32)
        scans.append(Scan(frame, points, T_world_sensor, 100_000_000 * frame, labels))
    return scans


def seen_through(scans: list[Scan], least: int = 4) -> Bool:
    """(N,) bool, all points.

    Box points with rays on all sides, ending far behind, in at least ``least`` other scans.

    The 12 rays that are nearest in angle must pass within 0.2 m of the point and end at least 1 m
    behind it.
    """
    found = []
    for scan in scans:
        times = np.zeros(len(scan), np.int64)
        rows = np.flatnonzero(scan.labels == Label.DYNAMIC)
        for other in scans:
            away, mine = other.points - other.position, scan.points[rows] - other.position
            ranges, r = np.linalg.norm(away, axis=1), np.linalg.norm(mine, axis=1)
            angles, rays = cKDTree(away / ranges[:, None]).query(mine / r[:, None], k=12)
            passing = (angles * r[:, None] < 0.2) & (ranges[rays] > r[:, None] + 1.0)
            times[rows] += passing.all(1)
        found.append(times >= least)
    return np.concatenate(found)


def _place(frame: int) -> F64:
    place = frame * 7 % PLACES
    azimuth, distance = np.radians(16 * place - 72), 6.5 + 2.0 * (place % 2)
    return np.array([distance * np.cos(azimuth), distance * np.sin(azimuth), 0.2 + HALF[2]])


def _rays(first: float) -> F64:
    """(RINGS * AZIMUTHS, 3): unit vectors."""
    columns = first + np.linspace(-VIEW / 2, VIEW / 2, AZIMUTHS, endpoint=False)
    azimuth, elevation = np.meshgrid(
        np.radians(columns), np.radians(np.linspace(*ELEVATION, RINGS))
    )
    flat = np.cos(elevation)
    return np.stack(
        [flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], -1
    ).reshape(-1, 3)


def _to_box(origin: F64, rays: F64, centre: F64, half: F64) -> F64:
    """Ranges to the box, metres; infinite for misses."""
    with np.errstate(divide="ignore"):
        sides = [(centre + side * half - origin) / rays for side in (-1, 1)]
    enter, leave = np.minimum(*sides).max(1), np.maximum(*sides).min(1)
    return np.where((enter > 0) & (enter < leave), enter, np.inf)
