"""Which points of a frame are drawn, and which go to the map of the whole run."""

from __future__ import annotations

import itertools

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, I64, U8
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Outcome
from dynaviz.kernels.keys import REACH
from dynaviz.spatial.grid import KeySet, voxel_downsample

VOXEL = (
    0.2  # metres: edge of the voxels used to downsample the map and the false positives of a frame
)
FINE = 0.1  # metres: the same for dynamic points, which are few
# points of an outcome in a frame, about; more are downsampled, with larger voxels if need be
MOST = 10_000
MARGIN = 1.1  # factor on these, because surfaces are rough
STRIDE = 4  # a map with more points than half of its cap gets only every fourth point of a frame
CROWDED = 8  # times its cap: with more points, a map is downsampled during the run
GROWTH = 1.25  # factor on the voxel's edge while a map has more points than its cap

DYNAMIC = (Outcome.DYNAMIC_REMOVED, Outcome.FALSE_NEGATIVE)
# outcomes drawn by frame in ``errors`` mode, and the voxel's edge in metres if they are downsampled
DRAWN = {
    Outcome.DYNAMIC_REMOVED: FINE,
    Outcome.FALSE_NEGATIVE: FINE,
    Outcome.FALSE_POSITIVE: VOXEL,
    Outcome.UNLABELLED_REMOVED: VOXEL,
}


class DownsampledMap:
    """Points of a whole run, one per voxel; memory is bounded.

    Args:
        size: the voxel's edge, metres; larger at the end if the map has many points.
        cap: number of points at the end, at most.
        middle: (3,) float32, metres: voxels are counted from here.
    """

    def __init__(self, size: float, cap: int, middle: F32) -> None:
        self.size = size
        self.cap = cap
        self._middle = middle
        self._seen = KeySet()
        self._turn = 0
        self._points: list[F32] = [np.empty((0, 3), np.float32)]
        self._reasons: list[U8] = [np.empty(0, np.uint8)]

    def add(self, points: F32, reasons: U8, rows: I64) -> None:
        """Add some rows of (N, 3) points, which are finite, and (N,) reason codes.

        The first of a voxel is kept.

        A map that is half full skips some of them: other scans see the same places, or it will be
        downsampled anyway.
        """
        if 2 * len(self._seen) > self.cap:
            self._turn = (self._turn + 1) % STRIDE
            rows = rows[self._turn :: STRIDE]
        first = self._seen.first_in(points, rows, self._middle, self.size)
        self._points.append(points[first])
        self._reasons.append(reasons[first])
        if len(self._seen) > CROWDED * self.cap:
            self._coarsen()

    def _coarsen(self) -> None:
        """Continue with larger voxels, so that memory is bounded on long drives."""
        points = np.concatenate(self._points)
        reasons = np.concatenate(self._reasons)
        while len(points) > CROWDED * self.cap // 2:
            self.size *= GROWTH
            self._seen.clear()
            first = self._seen.first_in(points, np.arange(len(points)), self._middle, self.size)
            points = points[first]
            reasons = reasons[first]
        self._points = [points]
        self._reasons = [reasons]

    def thinned(self) -> tuple[F32, U8]:
        """(M, 3) float32 points and their (M,) reason codes, downsampled further if they exceed the
        cap.

        They are ordered by reason: equal codes next to each other compress to almost nothing.
        """
        points = np.concatenate(self._points)
        reasons = np.concatenate(self._reasons)
        size = self.size
        while len(points) > self.cap:
            size *= GROWTH
            first = voxel_downsample(points - self._middle, size)[0]
            points = points[first]
            reasons = reasons[first]
        order = np.argsort(reasons, kind="stable")
        return points[order], reasons[order]


def by_outcome(labelled: Labelled, middle: F32) -> list[I64]:
    """The rows of each ``Outcome``, ascending, without those that are not finite or too far from
    the middle.
    """
    limit = np.float32(REACH * FINE)
    points = kernels.as_readonly(labelled.scan.points, np.float32)
    outcome = kernels.as_readonly(labelled.outcome, np.uint8)
    rows, bounds = kernels.drawing.by_class(outcome, points, middle, limit, len(Outcome))
    return [rows[first:end] for first, end in itertools.pairwise(bounds.tolist())]


def to_draw(labelled: Labelled, middle: F32, rows: list[I64]) -> tuple[I64, I64]:
    """Rows of points to draw, and how many each stands for.

    Dynamic and removed points, one per voxel if many.

    Args:
        labelled: the frame.
        middle: (3,) float32, metres: voxels are counted from here.
        rows: as from ``by_outcome``.
    """
    parts = []
    for outcome, size in DRAWN.items():
        # Few dynamic points are all drawn, including those that are not finite.
        every = np.flatnonzero(labelled.outcome == outcome) if outcome in DYNAMIC else None
        if every is not None and len(every) <= MOST:
            parts.append((every, np.ones(len(every), np.int64)))
        else:
            parts.append(_thinned(labelled.scan.points, rows[outcome], middle, size))
    return np.concatenate([some for some, _ in parts]), np.concatenate(
        [counts for _, counts in parts]
    )


def _thinned(points: F32, rows: I64, middle: F32, size: float) -> tuple[I64, I64]:
    """One of these rows per voxel of this edge, or of a larger one if these are more
    than ``MOST``.
    """
    points = kernels.as_readonly(points, np.float32)
    rows = kernels.as_readonly(rows, np.int64)
    first, counts = kernels.drawing.downsampled(points, rows, middle, size)
    if len(first) > MOST:  # the number of voxels of surfaces falls with the square of their edge
        size *= MARGIN * float(np.sqrt(len(first) / MOST))
        first, counts = kernels.drawing.downsampled(points, rows, middle, size)
    return first, counts
