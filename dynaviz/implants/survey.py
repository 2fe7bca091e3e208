"""One pass over a sequence: where it was, when, and the voxels that its points occupy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dynaviz.arrays import F32, F64, I64
from dynaviz.errors import UsageError
from dynaviz.scan import Label, Scan, Sequence
from dynaviz.spatial.grid import pack, unpack

CELL = 0.2  # metres; edge of a column
LAYER = 0.1  # metres; height of a voxel
REACH = 60.0  # metres from the sensor; points beyond are not used
PENDING = 4_000_000  # voxels collected before they are merged
TILT = 20.0  # degrees between the sensor's mean z axis and the world's


@dataclass(frozen=True, eq=False)
class Survey:
    """A sequence, accumulated.

    Attributes:
        positions: (F, 3) float64, metres, world frame: the sensor in each frame.
        times: (F,) float64, seconds.
        start_ns: stamp at time 0, or None if the times come from the rate.
        rate: sweeps per second.
        columns: (V, 2) int64: x and y index of each occupied voxel, in cells of ``CELL``, without dynamic points.
        height: (V,) float64, metres: mean height of its points.
        count: (V,) int64, its points.
        dynamic: for each frame (D, 3) float32, metres: points with the label dynamic, one per cell.
        instances: the highest instance number.
    """

    positions: F64
    times: F64
    start_ns: int | None
    rate: float
    columns: I64
    height: F64
    count: I64
    dynamic: tuple[F32, ...]
    instances: int

    @classmethod
    def of(cls, sequence: Sequence, progress: Callable[[int, int], None] = lambda done, total: None) -> Survey:
        """Read a sequence once.

        Raises:
            UsageError: if the world's z axis does not point up.
        """
        voxels, dynamic = _Voxels(), []
        positions, up, indices, stamps = [], [], [], []
        instances = 0
        for position in range(len(sequence)):
            scan = sequence[position]
            points, moving = _split(scan)
            voxels.add(points)
            _, first = np.unique(pack(moving, CELL), return_index=True)
            dynamic.append(moving[first])
            if scan.instances is not None and len(scan):
                instances = max(instances, int(scan.instances.max()))
            positions.append(scan.position)
            up.append(scan.T_world_sensor[2, 2])
            indices.append(scan.index)
            stamps.append(scan.stamp_ns)
            progress(position + 1, len(sequence))
        if not np.mean(up) > np.cos(np.radians(TILT)):
            raise UsageError(
                f"{sequence.name}: the sensor's z axis is not the world's, so up is unknown. "
                "Give poses in a world frame with z up, and the sensor's x axis forward"
            )
        rate = sequence.sensor.rate or 10.0
        start, times = None, np.array(indices, np.float64) / rate
        known = [stamp for stamp in stamps if stamp is not None]
        if len(known) == len(stamps) and all(a < b for a, b in pairwise(known)):
            start = known[0]
            times = np.array([(stamp - start) / 1e9 for stamp in known])
        keys, count, total = voxels.merged()
        columns = unpack(keys).astype(np.int64)[:, :2]
        return cls(np.array(positions), times, start, rate, columns, total / count, count, tuple(dynamic), instances)


class _Voxels:
    """Voxels with the number and the sum of heights of their points; merged from time to time."""

    def __init__(self) -> None:
        self._parts: list[tuple[I64, I64, F64]] = []
        self._pending = 0

    def add(self, points: F32) -> None:
        """Add (N, 3) float32 points, metres."""
        keys, inverse, count = np.unique(
            pack(points * np.array([1, 1, CELL / LAYER], np.float32), CELL), return_inverse=True, return_counts=True
        )
        total = np.bincount(inverse, points[:, 2].astype(np.float64), len(keys)).astype(np.float64)
        self._parts.append((keys, count.astype(np.int64), total))
        self._pending += len(keys)
        if self._pending > PENDING:
            self._parts = [self.merged()]
            self._pending = 0

    def merged(self) -> tuple[I64, I64, F64]:
        """Keys, sorted; counts; sums of heights."""
        if not self._parts:
            return np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0)
        keys, inverse = np.unique(np.concatenate([keys for keys, _, _ in self._parts]), return_inverse=True)
        count = np.bincount(inverse, np.concatenate([count for _, count, _ in self._parts]), len(keys))
        total = np.bincount(inverse, np.concatenate([total for _, _, total in self._parts]), len(keys))
        return keys, count.astype(np.int64), total.astype(np.float64)


def _split(scan: Scan) -> tuple[F32, F32]:
    """Points near the sensor: those that are not dynamic, and the dynamic ones."""
    offset = scan.points - scan.position.astype(np.float32)
    with np.errstate(invalid="ignore", over="ignore"):
        near = (offset * offset).sum(1) < REACH**2
    moving = near & (scan.labels == Label.DYNAMIC) if scan.labels is not None else np.zeros(len(scan), np.bool_)
    return scan.points[near & ~moving], scan.points[moving]
