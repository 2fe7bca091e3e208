"""A small street with exact truth, seen by a spinning lidar: boxes, ground, one moving box.

Scans are cast in closed form. ``sweep`` is the duration of a turn, during which the sensor moves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

BOXES = np.array(
    [
        # centre x y z, size x y z
        *[(x, 9.0 + 0.7 * (k % 3), 3.0, 6.0, 1.0, 6.0) for k, x in enumerate(range(-24, 40, 8))],
        *[(x, -8.0 - 0.5 * (k % 2), 2.5, 5.0, 1.0, 5.0) for k, x in enumerate(range(-20, 40, 7))],
        *[(x, 6.0, 2.0, 0.4, 0.4, 4.0) for x in range(-15, 35, 10)],
        *[(x, -5.5, 0.8, 4.0, 1.8, 1.6) for x in (-9, 3, 15, 27)],
        (36.0, 0.0, 3.0, 1.0, 24.0, 6.0),
        (-26.0, 0.0, 3.0, 1.0, 24.0, 6.0),
    ]
)
HEIGHT = 1.7  # metres; of the sensor above the ground
RATE = 10.0  # scans per second
SWEEP = 0.1  # seconds
FARTHEST = 50.0  # metres


@dataclass(frozen=True)
class Sweep:
    """A scan with its truth.

    Attributes:
        seconds: time of the scan, and of its first point.
        points: (N, 3) float32, metres, sensor frame, each at its own time.
        times: (N,) float64, seconds after the first point.
        world: (N, 3) float64, metres: where the points are.
        dynamic: (N,) bool.
        T: (4, 4) float64, metres: T_world_sensor at the time of the scan.
    """

    seconds: float
    points: np.ndarray
    times: np.ndarray
    world: np.ndarray
    dynamic: np.ndarray
    T: np.ndarray


def pose(seconds: float, speed: float = 5.0) -> np.ndarray:
    """T_world_sensor: along the street, with turns to both sides."""
    T = np.eye(4)
    yaw = 0.35 * np.sin(1.3 * seconds)
    pitch = 0.01 * np.sin(2.0 * seconds)
    T[:3, :3] = Rotation.from_euler("ZY", [yaw, pitch]).as_matrix()
    T[:3, 3] = -8 + speed * seconds, 1.2 * np.sin(0.8 * seconds), HEIGHT
    return T


def car(seconds: float) -> np.ndarray:
    """The moving box."""
    return np.array([[24.0 - 7.0 * seconds, 2.2, 0.85, 4.0, 1.8, 1.5]])


@cache
def rays(rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions (N, 3), column by column, and the share of the sweep of each (N,)."""
    elevation = np.radians(np.linspace(-22.0, 12.0, rows))
    azimuth = np.pi - np.arange(columns) * 2 * np.pi / columns
    A, E = np.meshgrid(azimuth, elevation, indexing="ij")
    directions = np.stack([np.cos(E) * np.cos(A), np.cos(E) * np.sin(A), np.sin(E)], -1)
    return directions.reshape(-1, 3), np.repeat(np.arange(columns) / columns, rows)


def hits(origins: np.ndarray, directions: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Distance to the first box on each ray, (N,) metres; infinite without one."""
    low = boxes[:, :3] - boxes[:, 3:] / 2
    high = boxes[:, :3] + boxes[:, 3:] / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / directions
        a = (low[None] - origins[:, None]) * inverse[:, None]
        b = (high[None] - origins[:, None]) * inverse[:, None]
        near = np.minimum(a, b).max(-1)
        far = np.maximum(a, b).min(-1)
    return np.where((near <= far) & (near > 0.05), near, np.inf).min(1)


def sweep_at(
    seconds: float, rows: int, columns: int, moving: bool, way: Callable[[float], np.ndarray] = pose
) -> Sweep:
    """A scan; during a sweep of ``SWEEP`` seconds if moving, otherwise in one moment."""
    directions, share = rays(rows, columns)
    offsets = share * SWEEP if moving else np.zeros(len(share))
    blocks = np.unique(np.round(offsets, 3))
    row = np.searchsorted(blocks, np.round(offsets, 3))
    T = np.array([way(seconds + each) for each in blocks])[row]
    offsets = blocks[row]
    world = np.einsum("nij,nj->ni", T[:, :3, :3], directions)
    origins = T[:, :3, 3]
    with np.errstate(divide="ignore"):
        ground = np.where(world[:, 2] < -1e-6, -origins[:, 2] / world[:, 2], np.inf)
    static = np.minimum(hits(origins, world, BOXES), ground)
    mover = hits(origins, world, car(seconds))
    ranges = np.minimum(static, mover)
    seen = ranges < FARTHEST
    points = (directions[seen] * ranges[seen, None]).astype(np.float32)
    placed = origins[seen] + world[seen] * ranges[seen, None]
    return Sweep(seconds, points, offsets[seen], placed, (mover < static)[seen], way(seconds))


@cache
def drive(
    frames: int = 14, rows: int = 16, columns: int = 240, moving: bool = False, rate: float = RATE
) -> tuple[Sweep, ...]:
    """Scans of the street."""
    return tuple(sweep_at(k / rate, rows, columns, moving) for k in range(frames))
