"""One pass over a sequence: where it was, when, and the voxels that its points occupy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dynaviz.arrays import F32, F64, I64, U64, Bool
from dynaviz.contracts.at_sensor import AtSensor
from dynaviz.contracts.scan import Label, Scan, Sequence
from dynaviz.errors import UsageError
from dynaviz.spatial.grid import pack, pack_indices, unpack
from dynaviz.spatial.scan_ground import ScanGround

CELL = 0.2  # metres; edge of a column
LAYER = 0.1  # metres; height of a voxel
REACH = 60.0  # metres from the sensor; points beyond are not used
PENDING = 4_000_000  # voxels collected before they are merged
PARTS = (
    64  # parts of a recording, or its frames if they are fewer: in each, a voxel is occupied or not
)
ALWAYS = np.uint64(2**64 - 1)
TILT = 20.0  # degrees between the sensor's mean z axis and the world's


@dataclass(frozen=True, eq=False)
class Survey:
    """A sequence, accumulated.

    Attributes:
        positions: (F, 3) float64, metres, world frame: the sensor in each frame.
        times: (F,) float64, seconds.
        start_ns: stamp at time 0, or None if the times come from the rate.
        rate: sweeps per second.
        columns: (V, 2) int64: x and y index of each occupied voxel, in cells of ``CELL``, without
            dynamic points.
        height: (V,) float64, metres: mean height of its points above the ground of their scans,
            whatever their poses.
        count: (V,) int64, its points.
        parts: (V,) uint64, a bit for each part of the recording in which it has points; all if one
            has a label.
        cells: (G, 2) int64: x and y index of each cell of ``scan_ground.EDGE`` in which a scan
            shows the ground.
        ground: (G,) float64, metres, world frame: its mean height there.
        dynamic: for each frame (D, 3) float32, metres: points known to be dynamic, one per cell.
        farthest: (F, 360) float32, metres in the plane: the farthest return in each degree of
            azimuth from -180, world frame; 0 without a return.
        instances: the highest instance number.
    """

    positions: F64
    times: F64
    start_ns: int | None
    rate: float
    columns: I64
    height: F64
    count: I64
    parts: U64
    cells: I64
    ground: F64
    dynamic: tuple[F32, ...]
    farthest: F32
    instances: int

    @classmethod
    def of(
        cls,
        sequence: Sequence,
        progress: Callable[[int, int], None] = lambda done, total: None,
        moving: Callable[[int], Bool] | None = None,
    ) -> Survey:
        """Read a sequence once.

        Args:
            sequence: any sequence.
            progress: called with the number of frames read and their total.
            moving: gives for a position (N,) bool: points known to be dynamic, in addition to those
                labelled so.

        Raises:
            UsageError: if the world's z axis does not point up.
        """
        voxels = _Means()
        ground = _Means()
        dynamic = []
        farthest = []
        positions = []
        up = []
        indices = []
        stamps = []
        instances = 0
        near = AtSensor(sequence.sensor)
        for position in range(len(sequence)):
            scan = sequence[position]
            still, moves = _split(
                scan, near.found(scan), None if moving is None else moving(position)
            )
            surface = ScanGround.of(scan.points[still], scan.position)
            when = part(position, len(sequence))
            heights = surface.heights(scan.points)
            labelled = (
                np.zeros(len(scan), np.bool_)
                if scan.labels is None
                else scan.labels != Label.UNLABELLED
            )
            still &= np.isfinite(heights)
            for rows, present in ((still & labelled, ALWAYS), (still & ~labelled, when)):
                above = heights[rows]
                voxels.add(
                    pack(np.column_stack([scan.points[rows, :2], above * (CELL / LAYER)]), CELL),
                    above,
                    present,
                )
            cells = np.argwhere(surface.number)
            z = surface.z + surface.height[tuple(cells.T)] / 1000
            ground.add(
                pack_indices(
                    np.column_stack([cells + surface.first, np.zeros(len(cells), np.int64)])
                ),
                z,
                when,
            )
            others = scan.points[moves]
            _, first = np.unique(pack(others, CELL), return_index=True)
            dynamic.append(others[first])
            farthest.append(_farthest(scan))
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
        start = None
        times = np.array(indices, np.float64) / rate
        known = [stamp for stamp in stamps if stamp is not None]
        if len(known) == len(stamps) and all(a < b for a, b in pairwise(known)):
            start = known[0]
            times = np.array([(stamp - start) / 1e9 for stamp in known])
        keys, count, total, parts = voxels.merged()
        columns = unpack(keys).astype(np.int64)[:, :2]
        shown, scans, summed, _ = ground.merged()
        return cls(
            positions=np.array(positions),
            times=times,
            start_ns=start,
            rate=rate,
            columns=columns,
            height=total / count,
            count=count,
            parts=parts,
            cells=unpack(shown).astype(np.int64)[:, :2],
            ground=summed / scans,
            dynamic=tuple(dynamic),
            farthest=np.array(farthest),
            instances=instances,
        )

    def in_sight(self, frame: int, xy: F64, radius: float) -> Bool:
        """(N,) bool: whether the sensor sees as far as (N, 2) places, metres, or would if they did
        not hide the rest.

        A place beyond the farthest return of its direction, within a few degrees, is hidden.
        """
        offset = xy - self.positions[frame, :2]
        away = np.hypot(offset[:, 0], offset[:, 1])
        half = np.degrees(np.arctan2(radius, np.maximum(away, radius))) + 1
        middle = np.degrees(np.arctan2(offset[:, 1], offset[:, 0])) + 180
        reach = [
            self.farthest[frame].take(np.arange(int(a - h), int(a + h) + 1), mode="wrap").max()
            for a, h in zip(middle, half, strict=True)
        ]
        seen: Bool = away - radius < np.array(reach)
        return seen


def part(position: int, frames: int) -> np.uint64:
    """The bit of ``Survey.parts`` for a frame."""
    return np.uint64(1) << np.uint64(position * PARTS // max(frames, PARTS))


class _Means:
    """By key, the number and the sum of some heights, and when there were any."""

    def __init__(self) -> None:
        self._chunks: list[tuple[I64, I64, F64, U64]] = []
        self._pending = 0

    def add(self, at: I64, heights: F32 | F64, when: np.uint64) -> None:
        """Add (N,) heights, metres, at (N,) keys, of one part of the recording."""
        keys, inverse, count = np.unique(at, return_inverse=True, return_counts=True)
        total = np.bincount(inverse, heights.astype(np.float64), len(keys)).astype(np.float64)
        self._chunks.append((keys, count.astype(np.int64), total, np.full(len(keys), when)))
        self._pending += len(keys)
        if self._pending > PENDING:
            self._chunks = [self.merged()]
            self._pending = 0

    def merged(self) -> tuple[I64, I64, F64, U64]:
        """Keys, sorted; counts; sums of heights; parts of the recording."""
        if not self._chunks:
            return np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0), np.empty(0, np.uint64)
        every, counts, totals, parts = (
            np.concatenate(column) for column in zip(*self._chunks, strict=True)
        )
        keys, inverse = np.unique(every, return_inverse=True)
        count = np.bincount(inverse, counts, len(keys))
        total = np.bincount(inverse, totals, len(keys))
        when = np.zeros(len(keys), np.uint64)
        np.bitwise_or.at(when, inverse, parts)
        return keys, count.astype(np.int64), total.astype(np.float64), when


def _farthest(scan: Scan) -> F32:
    """(360,) float32: see ``Survey.farthest``."""
    x, y = (scan.points[:, :2] - scan.position[:2].astype(np.float32)).T
    away = np.hypot(x, y)
    reach = np.zeros(360, np.float32)
    finite = np.isfinite(away)
    degree = (np.degrees(np.arctan2(y[finite], x[finite])) + 180).astype(np.int64) % 360
    np.maximum.at(reach, degree, away[finite])
    return reach


def _split(scan: Scan, carrier: Bool, agreed: Bool | None) -> tuple[Bool, Bool]:
    """(N,) bool: points within ``REACH`` that are no part of the carrier.

    Those that stay, and dynamic ones.
    """
    offset = scan.points - scan.position.astype(np.float32)
    with np.errstate(invalid="ignore", over="ignore"):
        near = ((offset * offset).sum(1) < REACH**2) & ~carrier
    moving = np.zeros(len(scan), np.bool_) if agreed is None else agreed.copy()
    if scan.labels is not None:
        moving = (scan.labels == Label.DYNAMIC) | (moving & (scan.labels == Label.UNLABELLED))
    return near & ~moving, near & moving
