"""One sweep with sensor effects, from the rays to points in the frame of the pose that the sweep is
given.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F32, F64, I32, I64, U8, U16, Bool
from dynaviz.contracts.sensors import Sensor
from dynaviz.spatial import geometry
from dynaviz.synthetic.simulate import optics
from dynaviz.synthetic.simulate.classes import ObjectClass
from dynaviz.synthetic.simulate.effects import NAMES, Effects
from dynaviz.synthetic.simulate.lidar import Hits, Rays, RayScene, receive, sweep_rays
from dynaviz.synthetic.simulate.sweep import (
    MovingSweep,
    TimedRays,
    by_tick,
    ray_shares,
    sensor_poses,
    time_slices,
)

STEEPEST = 20.0  # limit of the tangent of the incidence angle, for noise
BEAMS = 40  # beams of a sensor without rings, which fires them in turn


@dataclass(frozen=True, eq=False)
class Returns:
    """The returns of one sweep.

    Attributes:
        points: (N, 3) float64, metres, sensor frame in the middle of the sweep.
        intensity: (N,) float32, 0 to 1.
        lidar: (N,) uint8, number of the lidar.
        kinds: (N,) uint16, an ``ObjectClass`` per point.
        instances: (N,) int32, the mover's instance number, 0 for none.
    """

    points: F64
    intensity: F32
    lidar: U8
    kinds: U16
    instances: I32


def measure(
    ray_scene: RayScene, sensor: Sensor, index: int, effects: Effects, seed: int
) -> Returns:
    """Simulate a sweep whose middle is at the time of its frame.

    Args:
        ray_scene: the scene prepared for ray casting.
        sensor: the sensor.
        index: number of the frame.
        effects: effects of the sensor.
        seed: random seed of the sequence.
    """
    rng = np.random.default_rng([seed, 2, index])  # as without effects
    nominal = sweep_rays(sensor, index, rng)
    time = index / (sensor.rate or 10.0)
    shares = ray_shares(nominal)
    poses, ticks = sensor_poses(ray_scene.scene, sensor, time, effects.sweep_s, shares)
    actual = _beam_errors(nominal, sensor, effects, seed)
    rays = TimedRays(
        by_tick(poses, ticks, nominal.origins),
        by_tick(poses, ticks, actual, turn_only=True),
        time_slices(shares, effects.sweep_s),
    )
    sweep = MovingSweep(ray_scene, time, effects.sweep_s, rays)
    hits = _meet(rays, sweep, sensor, effects, lambda name: _stream(seed, index, name))
    distance, seen, kinds, intensity = receive(hits, sensor, rng, effects.dropout)
    seen &= _kept(hits, effects, _stream(seed, index, "dropout_range"))
    distance = distance + _noise(hits, effects, _stream(seed, index, "noise_range_m"))
    instances = np.where(kinds == ObjectClass.OUTLIER, 0, hits.instance).astype(np.int32)
    if effects.rain_per_m3:
        drops = optics.rain(hits, effects, sensor, _stream(seed, index, "rain_per_m3"))
        wet = np.isfinite(drops)
        distance = np.where(wet, drops, distance)
        kinds = np.where(wet, ObjectClass.AIRBORNE, kinds).astype(np.uint16)
        seen = seen | wet
        instances = np.where(wet, 0, instances).astype(np.int32)
        intensity = np.where(wet, np.float32(0.02), intensity)
    assert sensor.max_range is not None
    seen &= (distance >= sensor.min_range) & (distance <= sensor.max_range)
    points = _placed(nominal, distance, None if effects.raw else (poses, ticks))
    if not effects.raw:
        middle = sensor_poses(ray_scene.scene, sensor, time, 0.0, np.zeros(1))[0][0]
        points = geometry.apply(geometry.inverse(middle), points)
    return Returns(points[seen], intensity[seen], nominal.lidar[seen], kinds[seen], instances[seen])


def _stream(seed: int, index: int, name: str) -> np.random.Generator:
    """Random numbers of one effect in one frame."""
    return np.random.default_rng([seed, 4, index, NAMES.index(name)])


def _beam_errors(rays: Rays, sensor: Sensor, effects: Effects, seed: int) -> F64:
    """(N, 3) true directions in the sensor frame.

    Each beam has constant errors that the calibration missed.
    """
    if not effects.beam_deg:
        return rays.directions
    rings = sensor.rings or BEAMS
    errors = np.radians(effects.beam_deg) * np.random.default_rng([seed, 5]).normal(
        size=(len(sensor.mounts) or 1, rings, 2)
    )
    # of each lidar: the rays of a lidar are a multiple of its rings
    beam = np.arange(len(rays.lidar)) % rings
    turn, lift = errors[rays.lidar, beam].T
    radius = np.hypot(turn, lift)
    angle = np.arctan2(lift, turn)
    return optics.around(rays.directions, radius, angle)


def _meet(
    rays: TimedRays,
    sweep: MovingSweep,
    sensor: Sensor,
    effects: Effects,
    stream: Callable[[str], np.random.Generator],
) -> Hits:
    """What the beams meet."""
    hits = sweep.cast(rays)
    if effects.vegetation_gap or effects.glass:
        hits = optics.see_through(rays, hits, sweep, effects, stream("vegetation_gap"))
    if effects.divergence_mrad:
        hits = optics.mix(rays, hits, sweep, effects, sensor, stream("divergence_mrad"))
    if effects.multipath:
        hits = optics.mirror(rays, hits, sweep, effects, stream("multipath"))
    if effects.bloom_deg:
        hits = optics.bloom(rays.directions, hits, effects, stream("bloom_deg"))
    return hits


def _kept(hits: Hits, effects: Effects, rng: np.random.Generator) -> Bool:
    """(N,) bool: returns that are not lost for their range or angle of incidence.

    The share lost is ``dropout_range`` at 100 m, in proportion to the range, and
    ``dropout_incidence`` at grazing incidence, in proportion to the fourth power of 1 minus the
    cosine of incidence.
    """
    far = effects.dropout_range * np.minimum(hits.range, 1e3) / 100
    grazing = effects.dropout_incidence * (1 - np.clip(hits.facing, 0, 1)) ** 4
    kept: Bool = rng.random(len(far)) >= 1 - (1 - far) * (1 - grazing)
    return kept


def _noise(hits: Hits, effects: Effects, rng: np.random.Generator) -> F64:
    """(N,) metres: noise in addition to the sensor's, in proportion to range and tangent of
    incidence.
    """
    facing = np.clip(hits.facing, 1 / STEEPEST, 1)
    far = effects.noise_range_m * np.minimum(hits.range, 1e3) / 100
    grazing = effects.noise_incidence_m * np.sqrt(1 - facing**2) / facing
    deviation: F64 = np.sqrt(far**2 + grazing**2) * rng.normal(size=len(far))
    return deviation


def _placed(rays: Rays, distance: F64, moving: tuple[F64, I64] | None) -> F64:
    """(N, 3) points along the nominal rays.

    Raw in the sensor frame, or deskewed in the scene frame.
    """
    points = (
        rays.origins + rays.directions * np.where(np.isfinite(distance), distance, 0.0)[:, None]
    )
    return points if moving is None else by_tick(*moving, points)
