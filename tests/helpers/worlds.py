"""A little world to test on.

A room whose floor and walls stand still, and a box that slides through it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dynaviz.arrays import F64
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.testing import InMemory


def pose(x: float, y: float = 0.0, z: float = 1.0) -> F64:
    """(4, 4) T_world_sensor, looking along x."""
    T_world_sensor = np.eye(4)
    T_world_sensor[:3, 3] = x, y, z
    return T_world_sensor


def thinned(scans: list[Scan]) -> list[Scan]:
    """Every other point of scans that have labels, and one ray origin each."""
    return [
        replace(scan, points=scan.points[::2], labels=scan.labels[::2], origins=None)
        for scan in scans
    ]


def room(frames: int = 6, rays: int = 3000, seed: int = 0, labelled: bool = True) -> InMemory:
    """Rays from a moving sensor to the surfaces of a 16 x 12 x 4 m room and to a 1 m box that moves
    1.2 m a frame.
    """
    random = np.random.default_rng(seed)
    low, high = np.array([-6.0, -6.0, 0.0]), np.array([10.0, 6.0, 4.0])
    scans = []
    for frame in range(frames):
        T_world_sensor = pose(0.2 * frame)
        origin = T_world_sensor[:3, 3]
        direction = random.normal(size=(rays, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        wall = np.where(direction > 0, (high - origin) / direction, (low - origin) / direction).min(
            1
        )
        centre = np.array([-3.0 + 1.2 * frame, 2.5, 0.5])
        near, far = np.sort(
            [(centre - 0.5 - origin) / direction, (centre + 0.5 - origin) / direction], axis=0
        )
        enter, leave = near.max(1), far.min(1)
        moving = (enter > 0) & (enter < leave) & (enter < wall)
        points = origin + direction * np.where(moving, enter, wall)[:, None]
        scans.append(
            Scan(
                index=10 + frame,
                points=points.astype(np.float32),
                T_world_sensor=T_world_sensor,
                stamp_ns=100_000_000 * frame,
                labels=moving.astype(np.uint8) if labelled else None,
                instances=moving.astype(np.int32) if labelled else None,
            )
        )
    return InMemory(scans, "room", Sensor(name="test", title="a test's sensor", height=1.0))
