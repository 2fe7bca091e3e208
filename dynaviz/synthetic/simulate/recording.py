"""Record a scene with a moving sensor."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F32, F64, I32, U8, U16
from dynaviz.contracts.scan import Label
from dynaviz.contracts.sensors import load_sensor
from dynaviz.spatial import geometry
from dynaviz.synthetic.simulate import poses
from dynaviz.synthetic.simulate.behaviour import populate
from dynaviz.synthetic.simulate.classes import ObjectClass
from dynaviz.synthetic.simulate.effects import BEHAVIOUR
from dynaviz.synthetic.simulate.hall import hall
from dynaviz.synthetic.simulate.lidar import RayScene, receive, sweep_rays
from dynaviz.synthetic.simulate.measurement import Returns, measure
from dynaviz.synthetic.simulate.presets import Preset
from dynaviz.synthetic.simulate.scene import SimulatedScene
from dynaviz.synthetic.simulate.square import square
from dynaviz.synthetic.simulate.street import street
from dynaviz.synthetic.simulate.sweep import sensor_pose

WORKERS = 2  # sweeps simulated at the same time
BUILDERS = {"street": street, "square": square, "hall": hall}


@dataclass(frozen=True, eq=False)
class SimulatedSweep:
    """One sweep as a mapping system provides it, with ground truth.

    Attributes:
        index: number of the frame.
        time: seconds since the start.
        points: (N, 3) float32, metres, world frame. The world frame is the true sensor pose at
            frame 0.
        intensity: (N,) float32, 0 to 1.
        lidar: (N,) uint8, number of the lidar, for sensors that merge several.
        kinds: (N,) uint16, an ``ObjectClass`` per point.
        instances: (N,) int32, the mover's instance number, 0 for static objects.
        T_world_sensor: (4, 4) float64, metres: the pose with its error, which also transformed the
            points.
        T_scene_world: (4, 4) float64, metres: pose of the world frame in the scene frame, without
            error.
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
        return np.where(self.kinds >= ObjectClass.MOVING_CAR, Label.DYNAMIC, Label.STATIC).astype(
            np.uint8
        )


def build(preset: Preset, frames: int, seed: int = 0) -> SimulatedScene:
    """Build the scene of a preset, with its events spread over the number of frames."""
    duration = frames / (load_sensor(preset.sensor).rate or 10.0)
    scene = BUILDERS[preset.scene](
        np.random.default_rng([seed, 0]), duration, preset.speed, preset.traffic
    )
    if any(getattr(preset.effects, name) for name in BEHAVIOUR):
        populate(scene, preset.effects, np.random.default_rng([seed, 3]))
    return scene


def record_sweeps(
    scene: SimulatedScene,
    preset: Preset,
    frames: int,
    seed: int = 0,
    share: Iterable[int] | None = None,
) -> Iterator[SimulatedSweep]:
    """Simulate the sweeps in order, two at a time.

    Each has its own random numbers, so they do not depend on others.

    Args:
        scene: the scene of the preset.
        preset: sensor, accuracy of the poses, and effects.
        frames: number of sweeps of the sequence.
        seed: random seed.
        share: numbers of the sweeps to simulate; all by default.
    """
    recorder = SceneRecorder(scene, preset, frames, seed)
    with ThreadPoolExecutor(WORKERS) as pool:
        waiting: deque[Future[SimulatedSweep]] = deque()
        for index in range(frames) if share is None else share:
            waiting.append(pool.submit(recorder.sweep, index))
            if len(waiting) > WORKERS:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


class SceneRecorder:
    """Simulates any sweep of a sequence.

    Args:
        scene: the scene of the preset.
        preset: sensor, accuracy of the poses, and effects.
        frames: number of sweeps.
        seed: random seed.
    """

    def __init__(self, scene: SimulatedScene, preset: Preset, frames: int, seed: int = 0):
        self.scene = scene
        self.effects = preset.effects
        self.seed = seed
        self.sensor = load_sensor(preset.sensor)
        self._ray_scene = RayScene(scene)
        # builds the structure, before threads share it
        self._ray_scene.static.cast(np.zeros((1, 6), np.float32))
        self._T_scene_world = sensor_pose(scene, self.sensor, 0.0)
        errors = poses.slow_errors(np.random.default_rng([seed, 1]), frames, preset.pose_noise)
        if self.effects.drift_m or self.effects.drift_deg:
            true = np.stack([sensor_pose(scene, self.sensor, self._time(k)) for k in range(frames)])
            errors = geometry.compose(
                poses.drift(np.random.default_rng([seed, 6]), true, self.effects), errors
            )
        if self.effects.jitter_m or self.effects.jitter_deg:
            errors = geometry.compose(
                errors, poses.jitter(np.random.default_rng([seed, 7]), frames, self.effects)
            )
        self._errors = errors

    def _time(self, index: int) -> float:
        return index / (self.sensor.rate or 10.0)

    def sweep(self, index: int) -> SimulatedSweep:
        """Simulate the sweep with this number."""
        time = self._time(index)
        T_scene_sensor = sensor_pose(self.scene, self.sensor, time)
        found = self._returns(index, time, T_scene_sensor)
        true = geometry.compose(geometry.inverse(self._T_scene_world), T_scene_sensor)
        T_world_sensor = geometry.compose(true, self._errors[index])
        points = geometry.transform(T_world_sensor, found.points)
        return SimulatedSweep(
            index,
            time,
            points,
            found.intensity,
            found.lidar,
            found.kinds,
            found.instances,
            T_world_sensor,
            self._T_scene_world,
        )

    def _returns(self, index: int, time: float, T_scene_sensor: F64) -> Returns:
        if self.effects.optical:
            return measure(self._ray_scene, self.sensor, index, self.effects, self.seed)
        rng = np.random.default_rng([self.seed, 2, index])
        rays = sweep_rays(self.sensor, index, rng)
        hits = self._ray_scene.cast(rays, T_scene_sensor, time)
        distance, seen, kinds, intensity = receive(hits, self.sensor, rng)
        points = rays.origins[seen] + rays.directions[seen] * distance[seen, None]
        instances = np.where(kinds == ObjectClass.OUTLIER, 0, hits.instance).astype(np.int32)
        return Returns(points, intensity[seen], rays.lidar[seen], kinds[seen], instances[seen])
