"""Points at the sensor: rays without return, what is nearer than its minimum range, and the vehicle
that carries it.

They are no part of the map, and block every ray that starts there. No method sees them: all are
kept, unjudged.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from dynaviz.arrays import F64, I64, Bool, Intp
from dynaviz.contracts.method import AT_SENSOR, Labels, MethodInfo
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.spatial import geometry

HOUSING = 0.05  # metres from the sensor: nothing is nearer, and ranges are no more exact than this
CUBE = 0.2  # metres; edge of the cubes of ``Sensor.carrier``
ZEROS = 12  # points of a scan at exactly (0, 0, 0), from which they are rays without return


class AtSensor:
    """Finds the points of scans that are at the sensor.

    Args:
        sensor: its minimum range and its carrier.
    """

    def __init__(self, sensor: Sensor) -> None:
        self._nearest = max(HOUSING, sensor.min_range - HOUSING)
        cubes = np.array(sensor.carrier, np.int64).reshape(-1, 3)
        self._cubes = np.sort(_keys(cubes))
        self._reach = CUBE * float(np.linalg.norm(np.abs(cubes) + 1, axis=1).max(initial=0.0))

    def found(self, scan: Scan) -> Bool:
        """(N,) bool: points at the sensor; False for non-finite ones."""
        with np.errstate(invalid="ignore"):
            squared = scan.squared_ranges()
            found: Bool = squared < self._nearest**2
        if len(self._cubes):
            near = np.flatnonzero((squared < self._reach**2) & ~found)
            found[near] = np.isin(_keys(cubes_of(scan, near)), self._cubes)
        x, y, z = (scan.points[:, axis] == 0 for axis in range(3))
        zero = x & y & z
        return found | zero if np.count_nonzero(zero) > ZEROS else found

    def hidden(self, scan: Scan) -> tuple[Scan, Bool]:
        """The scan as methods receive it.

        Without ground truth, and with NaN for the points at the sensor.

        Returns:
            The scan, and (N,) bool: points at the sensor.
        """
        found = self.found(scan)
        if not found.any():
            return scan.without_truth(), found
        points = scan.points.copy()
        points[found] = np.nan
        return dataclasses.replace(scan.without_truth(), points=points), found


def unjudged(labels: Labels, found: Bool, info: MethodInfo) -> Labels:
    """The labels, with the points at the sensor, (N,) bool, kept for the reason ``AT_SENSOR``."""
    if not found.any():
        return labels
    code = np.uint8(info.reasons.index(AT_SENSOR))
    return dataclasses.replace(
        labels, dynamic=labels.dynamic & ~found, reasons=np.where(found, code, labels.reasons)
    )


def cubes_of(scan: Scan, rows: Intp) -> I64:
    """(K, 3) int64: the cubes of edge ``CUBE`` in the sensor frame that contain some points of a
    scan, (K,) rows.
    """
    return np.floor(in_sensor_frame(scan, rows) / CUBE).astype(np.int64)


def in_sensor_frame(scan: Scan, rows: Intp) -> F64:
    """(K, 3) float64, metres: some points of a scan, (K,) rows, in the sensor frame."""
    return geometry.apply(
        geometry.inverse(scan.T_world_sensor), scan.points[rows].astype(np.float64)
    )


def _keys(cubes: I64) -> I64:
    """(K,) int64: one number per cube, for (K, 3) indices of less than a million."""
    number: I64 = (cubes + (1 << 20)) @ np.array([1 << 42, 1 << 21, 1])
    return number
