"""Estimate what carries the sensor, a vehicle or a mount, from what moves rigidly with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dynaviz.arrays import F64, I64, Bool, Intp
from dynaviz.contracts.at_sensor import CUBE, HOUSING, in_sensor_frame
from dynaviz.contracts.scan import Scan
from dynaviz.sources.drive import Drive
from dynaviz.sources.sensing import ScanRays, stance
from dynaviz.spatial import geometry

# scans that are read, and between which the sensor must have moved
SCANS = 16
FEWEST = 6
# metres or degrees between two of them: static objects do not stay in their cubes
STEP = 1.0
TURN = 15.0
REACH = 3.0  # metres; a carrier does not extend farther from the sensor
# metres from the vertical axis through the sensor, within which each part of a carrier begins;
# vehicles beside it do not
NEAR = 2.0
ALWAYS = 0.8  # share of the scans in which a cube must contain points
RIGID = (
    0.04  # metres: standard deviation of their middle; that of a person who keeps step is larger
)
ABOVE_GROUND = 0.3  # metres; the ground stays below the sensor, too


def estimate_carrier(sequence: Drive) -> tuple[tuple[int, int, int], ...]:
    """The cubes in the sensor frame that contain the same points wherever the sensor is
    (``Sensor.carrier``).

    Who comes along keeps no distance so exactly, nor does a wall: methods judge these. Sideways, a
    vehicle in the next lane or the wall of a tunnel may keep it, but it is farther away than the
    near side of a carrier.

    Simulated sequences have no carrier and are not read. A sensor that does not move shows no
    carrier.

    Raises:
        DataError: for data that cannot be read.
    """
    if sequence.exact or len(sequence) < FEWEST:
        return ()
    last: Scan | None = None
    seen = list[F64]()  # of each scan: the middle of the points in each cube
    for position in np.unique(np.linspace(0, len(sequence) - 1, SCANS).astype(int)).tolist():
        scan = sequence[position]
        if last is not None and not _moved(last.T_world_sensor, scan.T_world_sensor):
            continue
        last = scan
        with np.errstate(invalid="ignore"):
            squared = scan.squared_ranges()
            near = np.flatnonzero((squared > HOUSING**2) & (squared < REACH**2))
        local = in_sensor_frame(scan, near)
        cubes, of = np.unique(np.floor(local / CUBE), axis=0, return_inverse=True)
        seen.append(_means(local, of.reshape(-1), len(cubes)))
    if last is None or len(seen) < FEWEST:
        return ()
    middles = np.concatenate(seen)
    found, of, counts = np.unique(
        np.floor(middles / CUBE), axis=0, return_inverse=True, return_counts=True
    )
    apart = middles - _means(middles, of.reshape(-1), len(found))[of.reshape(-1)]
    spread = np.sqrt(_means(apart**2, of.reshape(-1), len(found)).sum(1))
    cubes = found[(counts >= ALWAYS * len(seen)) & (spread < RIGID)].astype(np.int64)
    if not len(cubes):
        return ()
    up, height = stance(last, ScanRays.of(last))
    if height is not None:
        lowest = cubes @ up + np.minimum(up, 0.0).sum()  # corner of each
        cubes = cubes[CUBE * lowest > ABOVE_GROUND - height]
    return tuple((x, y, z) for x, y, z in cubes[_begins_near(cubes, up)].tolist())


def with_carrier(sequence: Drive) -> Drive:
    """The sequence, with an estimate of what carries the sensor if that is unknown.

    See ``estimate_carrier``.
    """
    if sequence.sensor.carrier or not (carrier := estimate_carrier(sequence)):
        return sequence
    return sequence.with_sensor(replace(sequence.sensor, carrier=carrier))


def _begins_near(cubes: I64, up: F64) -> Bool:
    """(C,) bool: cubes within ``REACH`` that join others, also at a corner, up to one near the
    axis through the sensor that points up, (3,) in its frame.
    """
    half = int(REACH / CUBE) + 2  # one more: the border stays empty
    at = tuple((cubes + half).T)
    grid = np.zeros((2, *(2 * half,) * 3), np.bool_)
    found, joined = grid
    found[at] = True
    middles = cubes + 0.5
    aside = middles - np.outer(middles @ up, up)
    joined[at] = CUBE * np.linalg.norm(aside, axis=1) < NEAR
    before = -1
    while before < (before := int(joined.sum())):
        for axis in range(3):
            joined |= np.roll(joined, 1, axis) | np.roll(joined, -1, axis)
        joined &= found
    near: Bool = joined[at]
    return near


def _means(points: F64, of: Intp, groups: int) -> F64:
    """(G, 3) float64: mean of the points, (N, 3), of each group, (N,)."""
    sums = np.stack([np.bincount(of, column, groups) for column in points.T], axis=1)
    means: F64 = sums / np.bincount(of, minlength=groups)[:, None]
    return means


def _moved(a: F64, b: F64) -> bool:
    T = geometry.inverse(a) @ b
    turned = np.degrees(np.arccos(np.clip((np.trace(T[:3, :3]) - 1) / 2, -1, 1)))
    return bool(np.linalg.norm(T[:3, 3]) > STEP or turned > TURN)
