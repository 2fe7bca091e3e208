"""Points stored on disk during a run, so that memory does not grow with its length."""

from __future__ import annotations

import tempfile
import threading
import weakref
from array import array
from collections.abc import Iterator

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I32, Bool
from dynaviz.io.temporary import store

EVERYWHERE = np.ones((1, 1), np.bool_)
# columns of a span
FRAME = 0
START = 1
COUNT = 2
LOW = slice(3, 6)
HIGH = slice(6, 9)


class PointSpool:
    """(N, 3) float32 points, metres, world frame, stored frame by frame in a temporary file.

    The file has no name if the system allows that. It is deleted with this object.

    Raises:
        DynavizError: if the disk is full.
    """

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115  # closed with this object
        self.close = weakref.finalize(self, self._file.close)
        # of each frame: number, start in the file, count, low and high corner
        self._spans = array("d")
        self._reading = threading.Lock()  # several threads may read
        self._end = 0
        self.points = 0

    def append(self, frame: int, points: F32) -> None:
        """Add the finite points of a frame."""
        if not np.isfinite(points).all():
            points = points[np.isfinite(points).all(1)]
        if len(points) == 0:
            return
        low, high = ([float(f(points[:, axis])) for axis in range(3)] for f in (np.min, np.max))
        # a box selects points by columns, which is much faster
        columns = np.ascontiguousarray(points.T, np.float32)
        rest = memoryview(columns.view(np.uint8).ravel())  # type: ignore[arg-type]
        self._spans.extend([frame, self._end, len(points), *low, *high])
        self._end += len(rest)
        self.points += len(points)
        store(self._file, rest, self._end, "points")

    def bounds(self) -> tuple[F64, F64]:
        """Low and high corner, (3,) float64 each. Needs at least one point."""
        spans = self._table()
        return spans[:, LOW].min(0), spans[:, HIGH].max(0)

    def sample(self, axis: int, step: int) -> F32:
        """One coordinate of every ``step``-th point of each frame, at least one per frame."""
        # Copy: a view would keep all points of its frame in memory.
        return np.concatenate([self._read(span)[axis, ::step].copy() for span in self._table()])

    def blocks(
        self, low: F64, high: F64, size: int, near: Bool = EVERYWHERE
    ) -> Iterator[tuple[F32, I32]]:
        """Points in a box and their frames, about ``size`` at a time.

        A block is valid until the next one, because they share a buffer.

        Args:
            low, high: (3,) float64, metres: low <= p < high on each axis.
            size: points, plus at most those of a frame.
            near: columns of the world that count (``kernels.touching.reached``).
        """
        spans = self._table()
        crossing = spans[(spans[:, HIGH] >= low).all(1) & (spans[:, LOW] < high).all(1)]
        counts = crossing[:, COUNT].astype(np.int64)
        capacity = min(size + int(counts.max(initial=0)), int(counts.sum()))
        points = np.empty((capacity, 3), np.float32)
        frames = np.empty(capacity, np.int32)
        filled = 0
        for span in crossing:
            if filled >= size:
                yield points[:filled], frames[:filled]
                filled = 0
            columns = self._read(span)
            rows = kernels.touching.inside(columns, low, high, near)
            for axis, column in enumerate(columns):
                points[filled : filled + len(rows), axis] = column[rows]
            frames[filled : filled + len(rows)] = int(span[FRAME])
            filled += len(rows)
        if filled:
            yield points[:filled], frames[:filled]

    def _table(self) -> F64:
        """(frames, 9) float64; numbers up to 2^53 are exact."""
        return np.array(self._spans).reshape(-1, 9)

    def _read(self, span: F64) -> F32:
        """(3, N) coordinates of a frame."""
        with self._reading:
            self._file.seek(int(span[START]))
            return np.fromfile(self._file, np.float32, 3 * int(span[COUNT])).reshape(3, -1)
