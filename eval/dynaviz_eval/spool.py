"""Points stored on disk during a run, so that memory does not grow with its length."""

from __future__ import annotations

import tempfile
import weakref
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dynaviz.arrays import F32, F64, I64
from dynaviz.errors import DynavizError


@dataclass(frozen=True, slots=True, eq=False)
class _Span:
    """The points of one frame: their position in the file, and their bounds in the world."""

    frame: int
    start: int
    count: int
    low: tuple[float, ...]
    high: tuple[float, ...]


class PointSpool:
    """(N, 3) float32 points, metres, world frame, stored frame by frame in a temporary file.

    The file has no name if the system allows that. It is deleted with this object.

    Raises:
        DynavizError: if the disk is full.
    """

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115  # closed with this object
        self.close = weakref.finalize(self, self._file.close)
        self._extents: list[_Span] = []
        self._end = 0
        self.points = 0

    def append(self, frame: int, points: F32) -> None:
        """Add the finite points of a frame."""
        if not np.isfinite(points).all():
            points = points[np.isfinite(points).all(1)]
        if len(points) == 0:
            return
        low, high = (tuple(float(f(points[:, axis])) for axis in range(3)) for f in (np.min, np.max))
        rest = memoryview(np.ascontiguousarray(points, np.float32).view(np.uint8).ravel())  # type: ignore[arg-type]
        self._extents.append(_Span(frame, self._end, len(points), low, high))
        self._end += len(rest)
        self.points += len(points)
        try:
            while len(rest):
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            where, size = tempfile.gettempdir(), self._end / 1e6
            raise DynavizError(
                f"{where}: cannot write {size:.0f} MB of temporary points ({error.strerror}). "
                "Free some space, or set TMPDIR to a folder on a larger disk."
            ) from None

    def bounds(self) -> tuple[F64, F64]:
        """Low and high corner, (3,) float64 each. Needs at least one point."""
        return np.min([e.low for e in self._extents], axis=0), np.max([e.high for e in self._extents], axis=0)

    def sample(self, axis: int, step: int) -> F32:
        """One coordinate of every ``step``-th point of each frame, at least one per frame."""
        # Copy: a view would keep all points of its frame in memory.
        return np.concatenate([self._read(extent)[::step, axis].copy() for extent in self._extents])

    def blocks(self, axis: int, low: float, high: float, size: int) -> Iterator[tuple[F32, I64]]:
        """Points with low <= p[axis] < high and their frames, about ``size`` at a time.

        A block is valid until the next one, because they share a buffer.
        """
        crossing = [e for e in self._extents if e.high[axis] >= low and e.low[axis] < high]
        capacity = min(size + max((e.count for e in crossing), default=0), sum(e.count for e in crossing))
        points, frames, filled = np.empty((capacity, 3), np.float32), np.empty(capacity, np.int64), 0
        for extent in crossing:
            if filled >= size:
                yield points[:filled], frames[:filled]
                filled = 0
            chosen = self._read(extent)
            along = chosen[:, axis]
            chosen = np.compress((along >= low) & (along < high), chosen, 0)
            points[filled : filled + len(chosen)] = chosen
            frames[filled : filled + len(chosen)] = extent.frame
            filled += len(chosen)
        if filled:
            yield points[:filled], frames[:filled]

    def _read(self, extent: _Span) -> F32:
        self._file.seek(extent.start)
        return np.fromfile(self._file, np.float32, 3 * extent.count).reshape(-1, 3)
