"""The lidar model: ray directions, ray casting and returns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F32, F64, I32, U8, U16, Bool
from dynaviz.contracts.sensors import Sensor
from dynaviz.spatial import geometry
from dynaviz.synthetic.ray_caster import RayCaster
from dynaviz.synthetic.simulate.classes import ObjectClass
from dynaviz.synthetic.simulate.movers import Mover
from dynaviz.synthetic.simulate.scene import MeshPart, SimulatedScene
from dynaviz.synthetic.simulate.shapes import Mesh

# low-discrepancy steps: golden ratio and plastic number
GOLDEN = (
    0.6180339887498949,
    0.7548776662466927,
)
REFLECTING = (ObjectClass.ROAD, ObjectClass.SIDEWALK, ObjectClass.TERRAIN, ObjectClass.OTHER_GROUND)


@dataclass(frozen=True, eq=False)
class Rays:
    """The rays of one sweep, in the sensor frame.

    Attributes:
        directions: (N, 3) float64, unit length.
        origins: (N, 3) float64, metres.
        lidar: (N,) uint8, number of the lidar, for sensors that merge several.
    """

    directions: F64
    origins: F64
    lidar: U8


@dataclass(frozen=True, eq=False)
class Hits:
    """The surfaces that the rays hit; all arrays (N,).

    Attributes:
        range: metres to the surface, infinite if nothing is hit.
        facing: cosine between ray and surface normal, 0 to 1.
        kind, instance: class and instance of the surface's object.
        reflectance: reflectance of the surface, 0 to 1.
        glass: bool, whether the surface is a window pane.
    """

    range: F64
    facing: F64
    kind: U16
    instance: I32
    reflectance: F64
    glass: Bool

    def where(self, chosen: Bool, other: Hits) -> Hits:
        """These hits, with those of ``other`` in the chosen places, (N,) bool."""
        return Hits(
            *(
                np.where(chosen, getattr(other, f), getattr(self, f))
                for f in Hits.__dataclass_fields__
            )
        )


def mounts(sensor: Sensor) -> list[F64]:
    """T_sensor_lidar (4, 4) of each lidar."""
    from scipy.spatial.transform import Rotation

    poses = []
    for *shift, roll, pitch, yaw in sensor.mounts or ((0.0,) * 6,):
        T = np.eye(4)
        T[:3, :3] = Rotation.from_euler("xyz", (roll, pitch, yaw), degrees=True).as_matrix()
        T[:3, 3] = shift
        poses.append(T)
    return poses


def sweep_rays(sensor: Sensor, frame: int, rng: np.random.Generator) -> Rays:
    """All rays of one sweep.

    A spinning sensor starts each sweep at a random fraction of an azimuth step.
    """
    directions = []
    origins = []
    lidar = []
    for number, T in enumerate(mounts(sensor)):
        azimuth, elevation = (
            _non_repetitive(sensor, frame)
            if sensor.points_per_sweep
            else _rings(sensor, rng.random())
        )
        horizontal = np.cos(elevation)
        local = np.stack(
            [horizontal * np.cos(azimuth), horizontal * np.sin(azimuth), np.sin(elevation)], axis=1
        )
        directions.append(geometry.apply(T, local) - T[:3, 3])
        origins.append(np.broadcast_to(T[:3, 3], local.shape))
        lidar.append(np.full(len(local), number, np.uint8))
    return Rays(np.concatenate(directions), np.concatenate(origins), np.concatenate(lidar))


def beams(sensor: Sensor) -> F64:
    """(rings,) float64, degrees: elevations of all beams from the lowest up.

    Rings and elevation must be known.
    """
    assert sensor.elevation
    assert sensor.rings
    return np.array(sensor.elevations or np.linspace(*sensor.elevation, sensor.rings))


def _rings(sensor: Sensor, start: float) -> tuple[F64, F64]:
    """Azimuth and elevation over the field of view, radians, firing by firing, from the lowest beam
    up.
    """
    assert sensor.azimuth_step
    low, high = sensor.azimuth
    firings = np.arange(int((high - low) / sensor.azimuth_step))
    elevations = beams(sensor)
    within = (
        np.arange(len(elevations)) / len(elevations) + start
    ) % 1  # the beams of one firing follow one another
    azimuth = low + sensor.azimuth_step * (firings[:, None] + within)
    return np.radians(azimuth.ravel()), np.radians(
        np.broadcast_to(elevations, azimuth.shape).ravel()
    )


def _non_repetitive(sensor: Sensor, frame: int) -> tuple[F64, F64]:
    """Azimuth and elevation, radians.

    A non-repetitive pattern that fills the field of view evenly over many sweeps.
    """
    assert sensor.points_per_sweep
    assert sensor.elevation
    count = frame * sensor.points_per_sweep + np.arange(sensor.points_per_sweep)
    across, up = (count * share % 1 for share in GOLDEN)
    fields = (sensor.azimuth, sensor.elevation)
    azimuth, elevation = (
        low + (high - low) * u for (low, high), u in zip(fields, (across, up), strict=True)
    )
    return np.radians(azimuth), np.radians(elevation)


Bodies = dict[int, tuple[float, Mesh]]
"""The latest body of each mover by its number, and the distance for which it was built."""


class RayScene:
    """A scene prepared for ray casting: static meshes once, moving meshes again for each sweep."""

    def __init__(self, scene: SimulatedScene):
        self.scene = scene
        self.static = Surfaces(scene.parts, [part.mesh for part in scene.parts])
        self.bodies: Bodies = {}

    def cast(self, rays: Rays, T_scene_sensor: F64, time: float) -> Hits:
        """Hits of the rays of a sensor at a pose and time, seconds."""
        origins = geometry.apply(T_scene_sensor, rays.origins)
        directions = geometry.apply(T_scene_sensor, rays.directions) - T_scene_sensor[:3, 3]
        packed = np.concatenate([origins, directions], axis=1).astype(np.float32)
        static = self.static.cast(packed)
        present = [
            (m, mesh)
            for m in self.scene.movers
            if (mesh := m.mesh(time, self.scene.height)) is not None
        ]
        if not present:
            return static
        moving = Surfaces([mover for mover, _ in present], [mesh for _, mesh in present]).cast(
            packed
        )
        nearer = moving.range < static.range
        return static.where(nearer, moving)


class Surfaces:
    """Meshes of some objects, and what the objects are."""

    def __init__(self, owners: list[MeshPart] | list[Mover], meshes: list[Mesh]):
        self._meshes = RayCaster(meshes)
        # The last row is for misses.
        self._kind = np.array([o.kind for o in owners] + [0], np.uint16)
        self._instance = np.array([getattr(o, "instance", 0) for o in owners] + [0], np.int32)
        self._reflectance = np.array([o.reflectance for o in owners] + [0.0])
        self._glass = np.array([getattr(o, "glass", False) for o in owners] + [False])

    def cast(self, rays: F32) -> Hits:
        """Nearest surface along (N, 6) float32 rays: origin and direction."""
        distance, facing, number = self._meshes.cast(rays)
        owner = np.minimum(number, len(self._kind) - 1)
        kind = self._kind[owner]
        instance = self._instance[owner]
        return Hits(distance, facing, kind, instance, self._reflectance[owner], self._glass[owner])


def receive(
    hits: Hits, sensor: Sensor, rng: np.random.Generator, lost: float = 0.04
) -> tuple[F64, Bool, U16, F32]:
    """The sensor's measurements of the hits.

    A bright surface at a right angle returns light up to ``max_range``; dark surfaces and grazing
    angles reduce the range. A share ``lost`` of the returns is lost. One in 2000 returns from the
    ground is a multipath return and lies too far.

    Returns:
        (N,) range with noise, metres; (N,) bool, whether a ray returns; (N,) class; (N,) intensity
        from 0 to 1.
    """
    count = len(hits.range)
    assert sensor.max_range is not None
    reach = (
        sensor.max_range * np.sqrt(hits.reflectance / 0.8) * np.clip(hits.facing, 1e-3, 1) ** 0.1
    )
    reach = np.minimum(reach * rng.normal(1, 0.12, count), sensor.max_range)
    seen = (hits.range < reach) & (hits.range >= sensor.min_range) & (rng.random(count) > lost)
    detour = (rng.random(count) < 0.0005) & np.isin(hits.kind, REFLECTING)
    longer = np.where(detour, rng.uniform(1.15, 1.8, count), 1.0)
    distance = hits.range * longer + rng.normal(0, sensor.range_noise or 0.0, count)
    kind = np.where(detour, ObjectClass.OUTLIER, hits.kind).astype(np.uint16)
    intensity = np.clip(
        hits.reflectance * (0.4 + 0.6 * hits.facing) * rng.normal(1, 0.08, count), 0, 1
    )
    seen &= (distance >= sensor.min_range) & (distance <= sensor.max_range)
    return distance, seen, kind, intensity.astype(np.float32)
