"""What the benchmarks run on: a street of 120 000 points a frame, made here, or the scans of a folder."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from dynaviz.io.pcd import read_pcd
from dynaviz.scan import Scan
from dynaviz.sensors import load_sensor

SENSOR = load_sensor("hdl64e")


def street(frames: int) -> list[Scan]:
    """A sensor of 64 rings drives 0.8 m a frame between house fronts; parked boxes, and three that drive."""
    random = np.random.default_rng(0)
    azimuth, elevation = np.meshgrid(np.linspace(-np.pi, np.pi, 1900), np.radians(np.linspace(-24.8, 8.0, 64)))
    flat = np.cos(elevation)
    direction = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], -1).reshape(-1, 3)
    parked = [(x, y, 0.8) for x in range(-60, 160, 9) for y in (-5.0, 5.5)]
    scans = []
    for index in range(frames):
        T_world_sensor = np.eye(4)
        T_world_sensor[:3, 3] = origin = 0.8 * index, 0.1 * math.sin(index), 1.73
        driving = [(15 + 1.5 * index, -2.0, 0.8), (-30 + 2.0 * index, 2.0, 0.8), (120 - index, 2.5, 0.8)]
        with np.errstate(divide="ignore"):
            inverse = 1.0 / direction
        reach = np.full(len(direction), 80.0)
        down, level = direction[:, 2] < 0, direction[:, 1] != 0
        reach[down] = np.minimum(reach[down], -origin[2] * inverse[down, 2])
        front = np.where(direction[:, 1] > 0, 11.0 - origin[1], -9.0 - origin[1]) * inverse[:, 1]
        reach[level] = np.minimum(reach, front)[level]
        for centre in parked + driving:
            corner = np.array([2.0, 0.9, 0.8])
            near, far = np.sort([(centre + side * corner - origin) * inverse for side in (-1, 1)], 0)
            enter = near.max(1)
            reach = np.where((enter > 0) & (enter < far.min(1)), np.minimum(reach, enter), reach)
        seen = reach < 80.0
        points = origin + direction[seen] * (reach + random.normal(0, 0.02, len(reach)))[seen, None]
        scans.append(Scan(index, points.astype(np.float32), T_world_sensor))
    return scans


def read(folder: Path, frames: int | None) -> list[Scan]:
    clouds = (read_pcd(path) for path in sorted((folder / "pcd").glob("*.pcd"))[:frames])
    return [Scan(index, cloud.xyz, cloud.T_world_sensor) for index, cloud in enumerate(clouds)]
