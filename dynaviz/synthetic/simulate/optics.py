"""What a beam meets on its way.

See-through surfaces, depth edges, mirrors, retro-reflectors, rain.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dynaviz.arrays import F64, I32, I64, U16, Bool
from dynaviz.contracts.sensors import Sensor
from dynaviz.synthetic.simulate.classes import ObjectClass
from dynaviz.synthetic.simulate.effects import Effects
from dynaviz.synthetic.simulate.lidar import REFLECTING, Hits, beams
from dynaviz.synthetic.simulate.sweep import MovingSweep, TimedRays

PASSES = 4  # leaves and panes that a ray can pass
SKIN = 0.02  # metres behind a surface where a passing ray goes on
SUBRAYS = 4  # around the central ray of a beam
EDGE = 0.05  # metres; a larger step between neighbouring rays makes their beams be sampled
# times the range noise: a return nearer to a surface cannot be told from one of that surface
WASHED = 3.0
APERTURE = 0.01  # metres; diameter of the beam at the sensor
DROP_REACH = 25.0  # metres up to which a drop or a grain returns enough light
HALO = 0.2  # metres behind a retro-reflector from which its halo hides other surfaces


def see_through(
    rays: TimedRays, hits: Hits, sweep: MovingSweep, effects: Effects, rng: np.random.Generator
) -> Hits:
    """Let rays pass leaves and panes; a ray that passes and meets nothing has no return.

    Every leaf that a ray meets lets it pass with the probability ``vegetation_gap``, every pane
    with ``glass``.
    """
    going = np.arange(len(hits.range))
    for _ in range(PASSES):
        kinds = hits.kind[going]
        glass = hits.glass[going]
        chance = np.where(
            glass,
            effects.glass,
            np.where(kinds == ObjectClass.VEGETATION, effects.vegetation_gap, 0.0),
        )
        going = going[rng.random(len(going)) < chance]
        if not len(going):
            break
        start = hits.range[going] + SKIN
        behind = sweep.cast(rays[going].continued(start, rays.directions[going]))
        _assign(hits, going, replace(behind, range=behind.range + start))
    return hits


def _assign(hits: Hits, rows: I64, values: Hits) -> None:
    for name in Hits.__dataclass_fields__:
        getattr(hits, name)[rows] = getattr(values, name)


def near_edges(ranges: F64, sensor: Sensor) -> Bool:
    """(N,) bool: rays that do not continue the plane through their neighbours in azimuth or in
    elevation.

    On a plane, the inverse of the horizontal range is linear in the tangent of the elevation. A
    sensor without rings has no neighbours; then all rays count.
    """
    if not sensor.rings:
        return np.ones(len(ranges), np.bool_)
    elevations = np.radians(beams(sensor))
    inverse = 1 / (
        ranges.reshape(max(1, len(sensor.mounts)), -1, sensor.rings) * np.cos(elevations)
    )
    squared = inverse**2
    across = np.abs((np.roll(inverse, 1, axis=1) + np.roll(inverse, -1, axis=1)) / 2 - inverse)
    levels = np.tan(elevations)
    share = (levels[1:-1] - levels[:-2]) / (levels[2:] - levels[:-2])
    up = np.zeros(inverse.shape)
    up[:, :, 1:-1] = np.abs(
        (1 - share) * inverse[:, :, :-2] + share * inverse[:, :, 2:] - inverse[:, :, 1:-1]
    )
    # in metres: a change of the inverse range, times the square of the nearer range around
    nearest = squared.copy()
    for axis in (1, 2):
        nearest = np.maximum(
            nearest, np.maximum(np.roll(squared, 1, axis=axis), np.roll(squared, -1, axis=axis))
        )
    return (np.maximum(across, up) > EDGE * nearest).reshape(-1)


def around(directions: F64, radius: F64, angle: F64) -> F64:
    """(N, 3) unit directions at (N,) angles ``radius`` from (N, 3) directions, turned about them by
    ``angle``.
    """
    x, y, z = np.ascontiguousarray(directions.T)
    flat = np.maximum(np.hypot(x, y), 1e-9)
    aside = np.cos(angle)
    up = np.sin(angle)
    unit = np.empty((len(x), 3))
    unit[:, 0] = turned_x = x + radius * (aside * (-y / flat) + up * (-z * x / flat))
    unit[:, 1] = turned_y = y + radius * (aside * (x / flat) + up * (-z * y / flat))
    unit[:, 2] = turned_z = z + radius * (up * flat)
    unit /= np.sqrt(turned_x**2 + turned_y**2 + turned_z**2)[:, None]
    return unit


def mix(
    rays: TimedRays,
    hits: Hits,
    sweep: MovingSweep,
    effects: Effects,
    sensor: Sensor,
    rng: np.random.Generator,
) -> Hits:
    """Give beams their width: at depth edges one return collects light from several surfaces.

    The beam is sampled by the central ray and four others. Of the surfaces less than ``pulse_m``
    apart in range, the sensor reports the brightest group, at the mean range weighted by the light.
    Class and instance are defined by ``_identify``.
    """
    chosen = np.flatnonzero(near_edges(hits.range, sensor))
    every = np.tile(chosen, SUBRAYS)
    start = rng.uniform(0, 2 * np.pi, len(chosen))
    radius = effects.divergence_mrad / 2000 * np.sqrt(rng.random(len(every)))
    angle = np.tile(start, SUBRAYS) + np.repeat(np.arange(SUBRAYS) * np.pi / 2, len(chosen))
    beams = rays[every]
    around_it = sweep.cast(
        TimedRays(beams.origins, around(beams.directions, radius, angle), beams.slices)
    )
    samples = [
        _take(hits, chosen),
        *(_take(around_it, rows) for rows in np.arange(len(every)).reshape(SUBRAYS, -1)),
    ]
    columns = {
        name: np.stack([getattr(s, name) for s in samples], axis=1)
        for name in Hits.__dataclass_fields__
    }
    _assign(
        hits,
        chosen,
        combine(Hits(**columns), effects.pulse_m, WASHED * (sensor.range_noise or 0.01)),
    )
    return hits


def _take(hits: Hits, rows: I64) -> Hits:
    return Hits(*(getattr(hits, name)[rows] for name in Hits.__dataclass_fields__))


def combine(samples: Hits, pulse: float, washed: float) -> Hits:
    """The returns of beams that are sampled by several rays.

    Args:
        samples: hits with arrays (N, S); the first column is the central ray.
        pulse: metres; surfaces nearer to each other than this give one return.
        washed: metres; a return this near to a surface belongs to it.
    """
    ranges = samples.range
    seen = np.isfinite(ranges)
    finite = np.where(seen, ranges, 1e9)
    light = np.where(
        seen, samples.reflectance * (0.4 + 0.6 * samples.facing) / np.maximum(finite, 0.1) ** 2, 0.0
    )
    near = (np.abs(finite[:, :, None] - finite[:, None, :]) < pulse) & seen[:, None, :]
    power = (near * light[:, None, :]).sum(2)
    row = np.arange(len(ranges))
    members: Bool = near[row, power.argmax(1)] & np.any(seen, axis=1, keepdims=True)
    weights = np.where(members, light, 0.0)
    total = np.maximum(weights.sum(1), 1e-300)
    mean = np.where(
        members.any(1), (weights * np.where(members, finite, 0.0)).sum(1) / total, np.inf
    )
    kind, instance, owner = _identify(samples, members, weights, finite, mean, washed)
    share = (members * samples.reflectance).sum(1) / ranges.shape[1]
    return Hits(mean, samples.facing[row, owner], kind, instance, share, samples.glass[row, owner])


def _identify(
    samples: Hits, members: Bool, weights: F64, finite: F64, mean: F64, washed: float
) -> tuple[U16, I32, I64]:
    """Class, instance and (N,) sample that owns each return.

    A return within ``washed`` of one of its surfaces belongs to the nearest such surface. Others
    are mixed pixels if their surfaces are separated by a step; they are dynamic, with the instance
    of the mover, if a mover adds light.
    """
    away = np.where(
        members, np.abs(finite - np.where(np.isfinite(mean), mean, 0.0)[:, None]), np.inf
    )
    owner = away.argmin(1)
    row = np.arange(len(mean))
    low = np.where(members, finite, np.inf).min(1)
    high = np.where(members, finite, -np.inf).max(1)
    ordered = np.sort(np.where(members, finite, high[:, None]), axis=1)
    with np.errstate(invalid="ignore"):
        step = np.diff(ordered, axis=1).max(1) > 0.5 * (high - low)
    mixed = members.any(1) & (away[row, owner] > washed) & step
    moving = np.where(samples.instance > 0, weights, 0.0)
    mover = moving.argmax(1)
    dynamic = moving[row, mover] > 0
    kind = samples.kind[row, owner]
    instance = samples.instance[row, owner]
    label = np.where(dynamic, ObjectClass.MOVING_MIXED_PIXEL, ObjectClass.MIXED_PIXEL)
    kind = np.where(mixed, label, kind).astype(kind.dtype)
    instance = np.where(mixed, np.where(dynamic, samples.instance[row, mover], 0), instance).astype(
        instance.dtype
    )
    return kind, instance, owner


def mirror(
    rays: TimedRays, hits: Hits, sweep: MovingSweep, effects: Effects, rng: np.random.Generator
) -> Hits:
    """Mirror some rays on the ground (puddles, wet or polished floors).

    Their returns appear below the ground.

    The return of a mirrored mover is dynamic. A mirrored ray that meets nothing keeps the return
    from the ground.
    """
    ground = np.flatnonzero(np.isin(hits.kind, REFLECTING))
    ground = ground[rng.random(len(ground)) < effects.multipath]
    up = rays.directions[ground] * (1.0, 1.0, -1.0)
    there = sweep.cast(rays[ground].continued(hits.range[ground] - SKIN, up))
    found = np.isfinite(there.range)
    kind = np.where(there.instance > 0, ObjectClass.MOVING_OUTLIER, ObjectClass.OUTLIER).astype(
        hits.kind.dtype
    )
    total = hits.range[ground] + there.range
    _assign(
        hits, ground[found], _take(replace(there, range=total, kind=kind), np.flatnonzero(found))
    )
    return hits


def bloom(directions: F64, hits: Hits, effects: Effects, rng: np.random.Generator) -> Hits:
    """Give rays that pass a retro-reflector (a traffic sign) its range, the more likely the nearer
    they pass.

    Args:
        directions: (N, 3) float64, unit length.
        hits: what the rays hit; changed in place.
        effects: gives the radius of the halo.
        rng: random numbers.
    """
    from scipy.spatial import cKDTree

    chance = rng.random(len(hits.range))
    signs = np.flatnonzero((hits.kind == ObjectClass.TRAFFIC_SIGN) & (hits.facing > 0.3))
    if not len(signs):
        return hits
    radius = 2 * np.sin(np.radians(effects.bloom_deg) / 2)
    low = directions[signs].min(0) - radius
    high = directions[signs].max(0) + radius
    around_them = np.flatnonzero(((directions >= low) & (directions <= high)).all(1))
    found_near = cKDTree(directions[signs]).query(
        directions[around_them], distance_upper_bound=radius
    )
    distance, near = (np.asarray(each) for each in found_near)
    within = np.isfinite(distance) & (distance > 0)
    found = around_them[within]
    distance = distance[within]
    sign = signs[near[within]]
    lit = (chance[found] > distance / radius) & (hits.range[found] > hits.range[sign] + HALO)
    _assign(hits, found[lit], _take(hits, sign[lit]))
    return hits


def rain(hits: Hits, effects: Effects, sensor: Sensor, rng: np.random.Generator) -> F64:
    """(N,) metres to the first drop or grain in each beam, infinite if the beam reaches its
    surface.

    The beam is a cone; the number of drops in it is Poisson distributed with the density
    ``rain_per_m3``.
    """
    widening = max(effects.divergence_mrad, 1.0) / 1000
    volume = rng.exponential(1 / effects.rain_per_m3, len(hits.range))
    distance = (np.cbrt(APERTURE**3 + 12 / np.pi * widening * volume) - APERTURE) / widening
    hit = (distance < np.minimum(hits.range, DROP_REACH)) & (distance > sensor.min_range)
    return np.where(hit, distance, np.inf)
