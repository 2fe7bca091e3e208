"""Scans of a road with cars, as several sensors see it, and returns below it."""

from __future__ import annotations

import numpy as np

SENSORS = {  # elevations of the rings and limits of the azimuth, degrees; height above the road
    "128 rings": (np.linspace(-25, 15, 128), (-180, 180), 1.9),
    "64 rings": (np.linspace(-24.8, 2, 64), (-180, 180), 1.73),
    "32 rings": (np.linspace(-30, 10, 32), (-180, 180), 1.84),
    "front, 120 degrees": (np.linspace(-12.5, 12.5, 125), (-60, 60), 1.8),
}
KINDS = ("mirror", "clump", "sheet", "scatter")
STEP = 0.5  # degrees between the rays of a ring


def road(rng: np.random.Generator, sensor: str, cars: int = 30) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) float64, metres from the sensor: what it sees of a sloping road with cars and a wall.

    And which of these are on the road, (N,) bool.
    """
    elevations, (first, last), height = SENSORS[sensor]
    azimuth, elevation = (
        np.radians(each).ravel()
        for each in np.meshgrid(np.arange(first, last, STEP), elevations, indexing="ij")
    )
    ahead = np.stack([np.cos(azimuth), np.sin(azimuth)], 1)
    up = np.tan(elevation)
    slope = rng.uniform(-0.05, 0.05, 2)
    descent = ahead @ slope - up
    far = np.where(descent > 0, height / np.maximum(descent, 1e-9), 1e9)  # where rays meet the road
    flat = np.full(len(far), True)
    obstacles = [(rng.uniform(4, 40), rng.uniform(-np.pi, np.pi), 1.5) for _ in range(cars)]
    for distance, towards, top in [*obstacles, (60.0, 0.0, 9.0)]:
        half = np.pi if top > 2 else 2.0 / distance
        aside = np.abs((azimuth - towards + np.pi) % (2 * np.pi) - np.pi)
        above = height - distance * descent
        hit = (aside < half) & (far > distance) & (above > 0) & (above < top)
        far[hit] = distance
        flat[hit] = False
    seen = far < 80
    points = np.column_stack([ahead * far[:, None], far * up])[seen]
    return points + rng.normal(0, 0.01, points.shape), flat[seen]


def below(
    rng: np.random.Generator, points: np.ndarray, flat: np.ndarray, height: float, kind: str
) -> np.ndarray:
    """(K, 3) float64, metres from the sensor: returns from beyond the road, on rays that meet it.

    Args:
        rng: decides their number, place and depth.
        points: (N, 3), metres from the sensor.
        flat: (N,) bool: which of these are on the road.
        height: of the sensor above the road, metres.
        kind: ``mirror``: images of objects in a wet patch; ``clump``, ``sheet``, ``scatter``:
            returns below such a patch, at one depth, and anywhere.
    """
    road = points[flat]
    away = np.hypot(*road[:, :2].T)
    centre = road[rng.choice(np.flatnonzero((away > 4) & (away < 45))), :2]
    size = rng.uniform(1, 5)
    if kind == "mirror":
        up = points[:, 2] + height
        on_road = points[:, :2] * (height / (height + np.maximum(up, 0)))[:, None]
        wet = ~flat & (up > 0.4) & (np.hypot(*(on_road - centre).T) < size)
        wet &= rng.random(len(points)) < rng.uniform(0.05, 1)
        return points[wet] * [1, 1, 0] + np.outer(-height - up[wet], [0, 0, 1])
    number = int(rng.integers(50, len(points) // 40))
    if kind == "scatter":
        rays = rng.choice(road, number)
        depth = rng.uniform(0.8, 8, number)
    else:
        patch = road[np.hypot(*(road[:, :2] - centre).T) < size]
        rays = rng.choice(patch, min(number, len(patch)), replace=False)
        deep = 0.03 if kind == "sheet" else rng.uniform(0.05, 1)
        depth = np.maximum(rng.uniform(1.5, 6) + rng.normal(0, deep, len(rays)), 0.6)
    return rays * (1 + depth / height)[:, None]
