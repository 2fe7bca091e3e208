"""Record a scene with a moving sensor and write the sweeps in the public benchmark's layout."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynaviz.arrays import F32, F64, I32, U8, U16
from dynaviz.errors import UsageError
from dynaviz.io.benchmark import BenchmarkWriter
from dynaviz.scan import Label
from dynaviz.sensors import Sensor, load_sensor
from dynaviz.simulate.classes import CLASS_NAMES, ObjectClass
from dynaviz.simulate.hall import hall
from dynaviz.simulate.lidar import RayScene, receive, sweep_rays
from dynaviz.simulate.presets import PRESETS, Preset
from dynaviz.simulate.scene import SimulatedScene
from dynaviz.simulate.square import square
from dynaviz.simulate.street import street
from dynaviz.spatial import geometry

VERSION = 1  # increase whenever the same preset and seed give different points
BUILDERS = {"street": street, "square": square, "hall": hall}


@dataclass(frozen=True, eq=False)
class SimulatedSweep:
    """One sweep as a mapping system provides it, with ground truth.

    Attributes:
        index: number of the frame.
        time: seconds since the start.
        points: (N, 3) float32, metres, world frame. The world frame is the true sensor pose at frame 0.
        intensity: (N,) float32, 0 to 1.
        lidar: (N,) uint8, number of the lidar, for sensors that merge several.
        kinds: (N,) uint16, an ``ObjectClass`` per point.
        instances: (N,) int32, the mover's instance number, 0 for static objects.
        T_world_sensor: (4, 4) float64, metres: the pose with its error, which also transformed the points.
        T_scene_world: (4, 4) float64, metres: pose of the world frame in the scene frame, without error.
    """

    index: int
    time: float
    points: F32
    intensity: F32
    lidar: U8
    kinds: U16
    instances: I32
    T_world_sensor: F64
    T_scene_world: F64

    @property
    def labels(self) -> U8:
        """(N,) uint8, a ``Label`` per point."""
        return np.where(self.kinds >= ObjectClass.MOVING_CAR, Label.DYNAMIC, Label.STATIC).astype(np.uint8)


def build(preset: Preset, frames: int, seed: int = 0) -> SimulatedScene:
    """Build the scene of a preset, with its events spread over the number of frames."""
    duration = frames / (load_sensor(preset.sensor).rate or 10.0)
    return BUILDERS[preset.scene](np.random.default_rng([seed, 0]), duration, preset.speed, preset.traffic)


def record_sweeps(scene: SimulatedScene, preset: Preset, frames: int, seed: int = 0) -> Iterator[SimulatedSweep]:
    """Simulate one sweep after another. Each has its own random numbers, so sweeps do not depend on each other."""
    sensor = load_sensor(preset.sensor)
    ray_scene = RayScene(scene)
    errors = _pose_errors(np.random.default_rng([seed, 1]), frames, preset.pose_noise)
    T_scene_world = _sensor_pose(scene, sensor, 0.0)
    for index in range(frames):
        rng = np.random.default_rng([seed, 2, index])
        yield _record_sweep(ray_scene, sensor, index, T_scene_world, errors[index], rng)


def _record_sweep(
    ray_scene: RayScene, sensor: Sensor, index: int, T_scene_world: F64, error: F64, rng: np.random.Generator
) -> SimulatedSweep:
    time = index / (sensor.rate or 10.0)
    T_scene_sensor = _sensor_pose(ray_scene.scene, sensor, time)
    rays = sweep_rays(sensor, index, rng)
    hits = ray_scene.cast(rays, T_scene_sensor, time)
    distance, returned, kinds, intensity = receive(hits, sensor, rng)
    in_sensor = rays.origins[returned] + rays.directions[returned] * distance[returned, None]
    T_world_sensor = geometry.compose(geometry.compose(geometry.inverse(T_scene_world), T_scene_sensor), error)
    points = geometry.transform(T_world_sensor, in_sensor)
    instances = np.where(kinds == ObjectClass.OUTLIER, 0, hits.instance).astype(np.int32)
    return SimulatedSweep(
        index,
        time,
        points,
        intensity[returned],
        rays.lidar[returned],
        kinds[returned],
        instances[returned],
        T_world_sensor,
        T_scene_world,
    )


def _sensor_pose(scene: SimulatedScene, sensor: Sensor, time: float) -> F64:
    T = scene.sensor.pose(time, scene.height)
    assert T is not None  # checked by SimulatedScene
    T[:3, 3] += T[:3, 2] * (sensor.height or 0.0)
    return T


def _pose_errors(rng: np.random.Generator, frames: int, noise: tuple[float, float]) -> F64:
    """(frames, 4, 4) pose errors that drift like those of a SLAM system: each keeps 0.8 of the previous one."""
    from scipy.spatial.transform import Rotation

    steps = rng.normal(size=(frames, 6))
    for k in range(1, frames):
        steps[k] = 0.8 * steps[k - 1] + 0.6 * steps[k]
    errors = np.tile(np.eye(4), (frames, 1, 1))
    errors[:, :3, :3] = Rotation.from_rotvec(np.radians(noise[1]) * steps[:, 3:]).as_matrix()
    errors[:, :3, 3] = noise[0] * steps[:, :3]
    return errors


def simulate(
    preset: str,
    out: Path,
    frames: int | None = None,
    seed: int = 0,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Path:
    """Write a simulated sequence: scans in the world frame, one labelled cloud of all scans, and ``sequence.toml``.

    The same preset, frames and seed give the same bytes. The folder is written completely or not at all.

    Args:
        preset: a name in ``PRESETS``.
        out: folder to create; it must not exist yet.
        frames: number of sweeps; None for the preset's default.
        seed: random seed; each seed gives another scene of the same kind.
        progress: called with the number of finished sweeps and the total.

    Raises:
        UsageError: for an unknown preset, a negative seed, or a number of frames below 1 or beyond the sensor's route.
        DataError: if ``out`` exists or cannot be written.
    """
    if preset not in PRESETS:
        raise UsageError(f"unknown scene '{preset}'. Known: {', '.join(PRESETS)}")
    chosen, out = PRESETS[preset], Path(out)
    frames = chosen.frames if frames is None else frames
    if frames < 1 or seed < 0:
        raise UsageError(f"frames {frames}, seed {seed}: invalid. Give at least one frame and a seed of at least 0")
    merged = bool(load_sensor(chosen.sensor).mounts)
    with BenchmarkWriter(out) as writer:
        for sweep in record_sweeps(build(chosen, frames, seed), chosen, frames, seed):
            lidar = sweep.lidar if merged else None
            writer.append(sweep.index, sweep.points, sweep.T_world_sensor, sweep.intensity, lidar)
            writer.append_truth(sweep.points, sweep.labels, sweep.kinds, sweep.instances)
            progress(sweep.index + 1, frames)
        facts = {"name": out.name, "title": chosen.title, "preset": chosen.name, "sensor": chosen.sensor, "seed": seed}
        facts |= {"frames": frames, "rate": load_sensor(chosen.sensor).rate, "generator": VERSION}
        writer.describe(facts, CLASS_NAMES)
    return out
