"""Keeps the directions and ranges of all returns of a run on disk, and looks at places in them."""

from __future__ import annotations

import math
import tempfile
import threading
import weakref
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynaviz import kernels
from dynaviz.arrays import F32, F64, I64, U8, U16
from dynaviz.contracts.looks import (
    AROUND,
    CLOSE,
    MARGIN,
    AskedPlaces,
    AsksLooks,
    CountedLooks,
    Look,
)
from dynaviz.contracts.metric import Labelled
from dynaviz.contracts.scan import Label, Scan
from dynaviz.io.temporary import store
from dynaviz.spatial.surface import GRAZING, surface_normals

APART = 0.1  # metres: origins of rays in a cube of this edge count as one
MOST_PARTS = 16  # of a scan, by origin; with more, the cubes grow
SAMPLED = 250  # directions whose spacing is measured
LEAST = 64  # returns of a scan whose spacing is measured
WIDEST = 1.5  # times the usual spacing: returns farther from a direction do not answer for it
SMALLEST = 5e-4  # radians: the least such angle
AT_ONCE = 64  # frames whose looks are in memory
TRAIL = 0.2  # metres: of the dynamic points of the drive in a cube of this edge, one is kept


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Returns of one scan with one origin, and where they lie in the file."""

    origin: F64
    start: int
    count: int


class LookTables:
    """The returns of all scans of a run, 8 bytes each, in a temporary file without a name."""

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115  # closed with this object
        weakref.finalize(self, self._file.close)
        self._reading = threading.Lock()
        self._end = 0
        self._parts: list[list[_Part]] = []
        self._movers: list[tuple[int, int]] = []
        self._trail: list[F32] = []

    def add(self, labelled: Labelled) -> None:
        """Keep a scan, and its dynamic points; scans come in the order of frames.

        Raises:
            DynavizError: if the disk is full.
        """
        scan = labelled.scan
        parts = []
        for origin, points in _by_origin(scan):
            ways, ranges = kernels.looks.table(points, origin)
            parts.append(_Part(origin, self._end, len(ranges)))
            self._store(ways)
            self._store(ranges)
        skipped = labelled.frame - len(self._parts)
        self._parts += [[] for _ in range(skipped)]
        self._movers += [(0, 0)] * skipped
        self._parts.append(parts)
        movers = np.empty((0, 3), np.float32)
        if scan.labels is not None:
            movers = scan.points[scan.labels == Label.DYNAMIC]
            movers = movers[np.isfinite(movers).all(1)]
        self._movers.append((self._end, len(movers)))
        if len(movers):
            self._store(movers)
            self._trail.append(_thinned(movers))
            if len(self._trail) >= AT_ONCE:
                self._trail = [_thinned(np.concatenate(self._trail))]

    def seen(self, asked: AskedPlaces) -> CountedLooks:
        """What every scan saw at places. Does not depend on the number of threads."""
        count = len(asked)
        frames = len(self._parts)
        groups = int(asked.groups.max(initial=-1)) + 1
        counts = np.zeros((count, len(Look)), np.int32)
        by_frame = np.zeros((groups, frames, len(Look)), np.int32)
        hits = np.full((2, count), -1, np.int32)
        before = np.zeros(count, np.int32)
        after = np.zeros(count, np.int32)
        close = np.zeros(count, np.int32)
        normals = self._normals(asked)
        cap = self._cap()
        grouped = np.flatnonzero(asked.groups >= 0)
        rows = np.arange(count)

        def look(frame: int) -> tuple[U8, F32]:
            return self._look(frame, asked.points, normals, cap)

        for begin in range(0, frames if count else 0, AT_ONCE):
            some = range(begin, min(begin + AT_ONCE, frames))
            for frame, (kinds, beyond) in zip(some, kernels.each(look, some), strict=True):
                other = asked.frames != frame
                counts[rows, kinds] += other
                flat = asked.groups[grouped] * len(Look) + kinds[grouped]
                size = groups * len(Look)
                by_frame[:, frame] = np.bincount(flat, minlength=size).reshape(groups, len(Look))
                hit = (kinds == Look.HIT) | ~other
                through = ((kinds == Look.THROUGH) | (kinds == Look.GRAZING)) & other
                before += through & ~hit & (hits[0] < 0)
                after = np.where(hit, 0, after + through)
                close += through & (beyond < CLOSE)
                hits[0, hit & (hits[0] < 0)] = frame
                hits[1, hit] = frame
        mover, ever = self._to_movers(asked)
        known = np.isfinite(normals[:, 0])
        return CountedLooks(
            counts, hits[0], hits[1], before, after, close, mover, ever, by_frame, known
        )

    def _look(self, frame: int, points: F32, normals: F32, cap: float) -> tuple[U8, F32]:
        kinds = np.full(len(points), Look.OUTSIDE, np.uint8)
        beyond = np.full(len(points), np.inf, np.float32)
        steep = math.sin(math.radians(GRAZING))
        for part in self._parts[frame]:
            ways, ranges = self._read(part)
            kernels.looks.look(
                ways, ranges, part.origin, points, normals, cap, math.radians(AROUND), MARGIN,
                steep, kinds, beyond,
            )  # fmt: skip
        return kinds, beyond

    def _normals(self, asked: AskedPlaces) -> F32:
        """(K, 3) float32: of the surfaces that the places' own scans show; NaN where unknown."""
        found = np.full((len(asked), 3), np.nan, np.float32)
        order = np.argsort(asked.frames, kind="stable")
        numbers, starts = np.unique(asked.frames[order], return_index=True)
        ends = np.append(starts, len(order))[1:].tolist()

        def measure(at: tuple[int, int, int]) -> None:
            frame, start, end = at
            rows = order[start:end]
            parts = self._parts[frame]
            points = [kernels.looks.points_of(*self._read(part), part.origin) for part in parts]
            if parts:
                every = np.concatenate(points)
                found[rows] = surface_normals(every, asked.points[rows], parts[0].origin[None])

        kernels.each(measure, zip(numbers.tolist(), starts.tolist(), ends, strict=True))
        return found

    def _to_movers(self, asked: AskedPlaces) -> tuple[F32, F32]:
        """Distances to the nearest dynamic points of the own scan, and of any; (K,) metres each."""
        own = np.full(len(asked), np.inf, np.float32)
        ever = own.copy()
        if not self._trail or not len(asked):
            return own, ever
        from scipy.spatial import cKDTree

        for frame in np.unique(asked.frames).tolist():
            movers = self._movers_of(frame)
            if len(movers):
                rows = np.flatnonzero(asked.frames == frame)
                own[rows] = cKDTree(movers).query(asked.points[rows])[0]
        ever[:] = cKDTree(np.concatenate(self._trail)).query(asked.points)[0]
        return own, np.minimum(own, ever)

    def _cap(self) -> float:
        """The largest angle from a direction to a return that answers for it, radians."""
        for parts in self._parts:
            for part in parts:
                if part.count >= LEAST:
                    ways, _ = self._read(part)
                    gaps = kernels.looks.spacings(ways, max(part.count // SAMPLED, 1))
                    return float(np.clip(WIDEST * np.median(gaps), SMALLEST, math.radians(AROUND)))
        return math.radians(AROUND)

    def _read(self, part: _Part) -> tuple[U16, F32]:
        with self._reading:
            self._file.seek(part.start)
            ways = np.fromfile(self._file, np.uint16, 2 * part.count).reshape(-1, 2)
            return ways, np.fromfile(self._file, np.float32, part.count)

    def _movers_of(self, frame: int) -> F32:
        start, count = self._movers[frame]
        with self._reading:
            self._file.seek(start)
            return np.fromfile(self._file, np.float32, 3 * count).reshape(-1, 3)

    def _store(self, values: U16 | F32) -> None:
        rest = memoryview(np.ascontiguousarray(values).view(np.uint8).ravel())  # type: ignore[arg-type]
        self._file.seek(0, 2)
        self._end += len(rest)
        store(self._file, rest, self._end, "directions")


def answer(asking: Sequence[AsksLooks], tables: LookTables) -> None:
    """Give metrics the looks at their places."""
    places = [metric.places() for metric in asking]
    seen = tables.seen(AskedPlaces.of(places))
    first = 0
    group = 0
    for metric, part in zip(asking, places, strict=True):
        groups = int(part.groups.max(initial=-1)) + 1
        own = slice(first, first + len(part)), slice(group, group + groups)
        metric.looked(seen.part(*own))
        first += len(part)
        group += groups


def _by_origin(scan: Scan) -> list[tuple[F64, F32]]:
    """The points of a scan by the origin of their rays, (3,) metres, with a few origins."""
    if len(scan.origins) == 1:
        return [(scan.origins[0].copy(), scan.points)]
    size = APART
    while True:
        cells = np.floor((scan.origins - scan.origins[0]) / size).astype(np.int64)
        keys = ((cells[:, 0] << 42) ^ (cells[:, 1] << 21)) ^ cells[:, 2]
        _, of = np.unique(keys, return_inverse=True)
        parts = int(of.max(initial=-1)) + 1
        if parts <= MOST_PARTS:
            break
        size *= 2
    found = []
    for number in range(parts):
        rows: I64 = np.flatnonzero(of == number)
        points = kernels.as_readonly(scan.points[rows], np.float32)
        found.append((scan.origins[rows].mean(0), points))
    return found


def _thinned(points: F32) -> F32:
    """One point of each cube of the edge ``TRAIL``."""
    _, first = np.unique(np.floor(points / TRAIL), axis=0, return_index=True)
    chosen: F32 = points[np.sort(first)]
    return chosen
