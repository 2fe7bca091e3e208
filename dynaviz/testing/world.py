"""A small simulated world for checks.

A sensor drives over a crossing with walls, static boxes and moving boxes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F64
from dynaviz.contracts.scan import Label, Scan
from dynaviz.contracts.sensors import Sensor

# degrees, metres
RINGS = 24
ELEVATION = (-24.0, 10.0)
HEIGHT = 1.8
SENSOR = Sensor(
    name="check", title="a sensor of 24 rings", rings=RINGS, elevation=ELEVATION, height=HEIGHT
)
AZIMUTHS = 400
NOISE = 0.01  # metres, along the ray
SIZE = 30.0  # metres from the centre to the walls
# Static boxes: centre, half edges. Moving boxes: centre, half edges, step per frame. Metres.
STATIC_BOXES = [
    ((8.0, 6.0, 1.0), (2.2, 0.9, 1.0)),
    ((-9.0, -6.0, 1.0), (2.2, 0.9, 1.0)),
    ((4.0, -9.0, 2.0), (0.2, 0.2, 2.0)),
]
MOVING_BOXES = [
    ((-14.0, 3.0, 1.1), (2.2, 0.9, 0.8), (1.9, 0.0, 0.0)),
    ((16.0, -3.0, 0.9), (2.2, 0.9, 0.8), (-1.6, 0.0, 0.0)),
    ((12.0, -6.0, 0.8), (0.4, 0.4, 0.9), (-0.9, 0.3, 0.0)),
    ((-6.0, 9.0, 0.9), (0.4, 0.4, 0.9), (0.8, -0.3, 0.0)),
]
# degrees and metres, so that surfaces cross voxels at all angles
WORLD_POSE = (
    17.0,
    0.31,
    0.17,
    0.23,
)
SLOPE = np.array([0.04, 0.03, 1.0])  # direction normal to the ground


@dataclass(frozen=True)
class InMemory:
    """A sequence of scans in memory."""

    scans: Sequence[Scan]
    name: str = "crossing"
    sensor: Sensor = SENSOR

    @property
    def has_labels(self) -> bool:
        """Whether any scan has ground truth."""
        return any(scan.labels is not None for scan in self.scans)

    def __len__(self) -> int:
        return len(self.scans)

    def __getitem__(self, position: int) -> Scan:
        return self.scans[position]


def crossing(frames: int = 12, seed: int = 0) -> list[Scan]:
    """Scans with exact labels; the same seed gives the same scans.

    Args:
        frames: number of scans, 0.1 s apart.
        seed: random seed of the range noise.
    """
    random = np.random.default_rng(seed)
    directions = _directions()
    scans = []
    for frame in range(frames):
        T_world_sensor = _pose(frame)
        origin = T_world_sensor[:3, 3]
        rays = directions @ T_world_sensor[:3, :3].T
        static = np.minimum.reduce(
            [_room(origin, rays), *(_box(origin, rays, *box) for box in STATIC_BOXES)]
        )
        moving = np.minimum.reduce(
            [
                _box(origin, rays, tuple(np.add(centre, np.multiply(frame, step))), half)
                for centre, half, step in MOVING_BOXES
            ]
        )
        ranges = np.minimum(static, moving) + random.normal(0, NOISE, len(rays))
        labels = np.where(moving < static, Label.DYNAMIC, Label.STATIC).astype(np.uint8)
        points = (origin + ranges[:, None] * rays).astype(np.float32)
        scans.append(Scan(frame, points, T_world_sensor, 100_000_000 * frame, labels))
    return [moved(scan, turn(*WORLD_POSE)) for scan in scans]


def moved(scan: Scan, T: F64) -> Scan:
    """The scan in a world that is transformed by T, (4, 4)."""
    points = (scan.points @ T[:3, :3].T + T[:3, 3]).astype(np.float32)
    return Scan(scan.index, points, T @ scan.T_world_sensor, scan.stamp_ns, scan.labels)


def turn(degrees: float, x: float, y: float, z: float) -> F64:
    """(4, 4) pose: a rotation about z, degrees, then a shift, metres."""
    angle = np.radians(degrees)
    T = np.eye(4)
    T[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    T[:3, 3] = x, y, z
    return T


def _directions() -> F64:
    """(RINGS * AZIMUTHS, 3) unit vectors, sensor frame.

    Off the axes, so that no ray runs along a voxel face.
    """
    elevation, azimuth = np.meshgrid(
        np.radians(np.linspace(*ELEVATION, RINGS)),
        np.linspace(-np.pi, np.pi, AZIMUTHS, endpoint=False) + 0.003,
        indexing="ij",
    )
    horizontal = np.cos(elevation)
    return np.stack(
        [horizontal * np.cos(azimuth), horizontal * np.sin(azimuth), np.sin(elevation)], -1
    ).reshape(-1, 3)


def _pose(frame: int) -> F64:
    return turn(1.5 * frame, 0.6 * frame - 3.0, 0.05 * frame, HEIGHT)


def _room(origin: F64, rays: F64) -> F64:
    """Ranges to the sloping ground and the walls, metres."""
    with np.errstate(divide="ignore"):
        walls = ((np.where(rays > 0, SIZE, -SIZE) - origin) / rays)[:, :2].min(1)
        ground = -(origin @ SLOPE) / (rays @ SLOPE)
    ranges: F64 = np.where(ground > 0, np.minimum(ground, walls), walls)
    return ranges


def _box(origin: F64, rays: F64, centre: tuple[float, ...], half: tuple[float, ...]) -> F64:
    """Ranges to a box from outside, metres; infinite for misses."""
    with np.errstate(divide="ignore"):
        low, high = ((np.add(centre, np.multiply(side, half)) - origin) / rays for side in (-1, 1))
    enter = np.minimum(low, high).max(1)
    leave = np.maximum(low, high).min(1)
    return np.where((enter > 0) & (enter < leave), enter, np.inf)
