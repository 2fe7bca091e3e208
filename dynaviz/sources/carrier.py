"""Estimate what carries the sensor, a vehicle or a mount, from what moves with it."""

from __future__ import annotations

import numpy as np

from dynaviz.arrays import F64, I64
from dynaviz.contracts.at_sensor import CUBE, HOUSING, cubes_of
from dynaviz.contracts.scan import Scan, Sequence, base_of
from dynaviz.sources.sensing import ScanRays, height_of
from dynaviz.spatial import geometry

SCANS, FEWEST = 16, 6  # scans that are read, and between which the sensor must have moved
STEP, TURN = 1.0, 15.0  # metres or degrees between two of them: static objects do not stay in their cubes
REACH = 3.0  # metres; a carrier does not extend farther from the sensor
ALWAYS = 0.8  # share of the scans in which a cube must contain points
ABOVE_GROUND = 0.3  # metres; the ground stays below the sensor, too


def estimate_carrier(sequence: Sequence) -> tuple[tuple[int, int, int], ...]:
    """The cubes in the sensor frame that contain points wherever the sensor is (``Sensor.carrier``).

    Simulated sequences have no carrier and are not read. A sensor that does not move shows no carrier.

    Raises:
        DataError: for data that cannot be read.
    """
    if getattr(type(base_of(sequence)), "nested", False) or len(sequence) < FEWEST:
        return ()
    last: Scan | None = None
    seen = list[I64]()
    for position in np.unique(np.linspace(0, len(sequence) - 1, SCANS).astype(int)).tolist():
        scan = sequence[position]
        if last is not None and not _moved(last.T_world_sensor, scan.T_world_sensor):
            continue
        last = scan
        with np.errstate(invalid="ignore"):
            squared = scan.squared_ranges()
            near = np.flatnonzero((squared > HOUSING**2) & (squared < REACH**2))
        seen.append(np.unique(cubes_of(scan, near), axis=0))
    if last is None or len(seen) < FEWEST:
        return ()
    cubes, counts = np.unique(np.concatenate(seen), axis=0, return_counts=True)
    cubes = cubes[counts >= ALWAYS * len(seen)]
    if len(cubes) and (height := height_of(ScanRays.of(last))) is not None:
        cubes = cubes[CUBE * cubes[:, 2] > ABOVE_GROUND - height]
    return tuple((x, y, z) for x, y, z in cubes.tolist())


def _moved(a: F64, b: F64) -> bool:
    T = geometry.inverse(a) @ b
    turned = np.degrees(np.arccos(np.clip((np.trace(T[:3, :3]) - 1) / 2, -1, 1)))
    return bool(np.linalg.norm(T[:3, 3]) > STEP or turned > TURN)
