"""The first walk through a sequence: where its points lie, how many there are, and a digest of its content."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynaviz.errors import DynavizError
from dynaviz.grid import KeySet, pack, unpack
from dynaviz.scan import F64, Scan, Sequence, stream

CELL = 0.8  # metres: 8 voxels of 0.1 m, the block that most grids are built of
FAR = 100_000.0  # metres; voxels of 0.1 m have keys up to there


@dataclass(frozen=True, eq=False)
class Extent:
    """Where the points of a sequence lie.

    Attributes:
        low, high: (3,) float64, metres, world frame: bounds of all finite points and ray origins.
        cells: (C, 3) int32: the cubes of ``CELL`` metres that hold at least one point; cube k spans [k, k + 1) * CELL.
    """

    low: F64
    high: F64
    cells: NDArray[np.int32]

    @classmethod
    def of(cls, *scans: Scan) -> Extent:
        """The extent of scans that are in memory."""
        walker = _Walker()
        for scan in scans:
            walker.visit(scan)
        return walker.extent()


@dataclass(frozen=True)
class Survey:
    """What one walk through a sequence tells: extent, numbers of points and frames, and a digest of the content.

    The digest covers points, poses, ray origins and labels of all frames in order, so that two runs can be compared
    point by point exactly where their digests agree.
    """

    extent: Extent
    frames: int
    points: int
    digest: str


class _Walker:
    def __init__(self) -> None:
        self.low, self.high = np.full(3, np.inf), np.full(3, -np.inf)
        self.cells = KeySet()

    def visit(self, scan: Scan) -> None:
        finite = scan.points if np.isfinite(scan.points).all() else scan.points[np.isfinite(scan.points).all(1)]
        for xyz in (finite, scan.origins):
            if len(xyz):
                columns = [xyz[:, axis] for axis in range(3)]  # far quicker than along the rows
                self.low = np.minimum(self.low, [column.min() for column in columns])
                self.high = np.maximum(self.high, [column.max() for column in columns])
        farthest = max(-self.low.min(), self.high.max())
        if farthest > FAR:
            raise DynavizError(
                f"frame {scan.index}: something lies {farthest / 1000:.3g} km from the world's origin, where float32 "
                "is too coarse. Move the world's origin to where the sensor starts, or remove such points."
            )
        self.cells.add(pack(finite, CELL))

    def extent(self) -> Extent:
        return Extent(self.low, self.high, unpack(self.cells.keys()))


def survey(sequence: Sequence, progress: Callable[[int], None] = lambda done: None) -> Survey:
    """Walk once through a sequence.

    Args:
        sequence: read frame by frame, never all in memory.
        progress: called with the number of frames done.

    Raises:
        DynavizError: for points or ray origins farther than ``FAR`` from the world's origin.
    """
    walker, digest, points = _Walker(), hashlib.sha256(), 0
    for done, scan in enumerate(stream(sequence), 1):
        walker.visit(scan)
        for array in (scan.points, scan.T_world_sensor, scan.origins, scan.labels):
            digest.update(b"-" if array is None else array.tobytes())
        points += len(scan)
        progress(done)
    return Survey(walker.extent(), len(sequence), points, digest.hexdigest())
