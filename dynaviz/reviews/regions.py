"""Parts of the world, over a span of time, that a decision is about.

Coordinates are metres in the world of the source: of UTM data with the offset that dynaviz takes
off when it opens them. Times are stamps in nanoseconds where the data has any, otherwise numbers of
frames in the data set; never positions in a run, which selects frames.
"""

from __future__ import annotations

import base64
import binascii
import itertools
import zlib
from bisect import bisect_left
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from dynaviz.arrays import F64, Bool
from dynaviz.contracts.scan import Scan

Clock = Literal["stamp", "frame"]
Finite = Annotated[float, Meta(ge=-1e9, le=1e9)]
Corner = tuple[Finite, Finite, Finite]
PlanCorner = tuple[Finite, Finite]

EDGE = 0.1  # metres: cells of an object, the resolution of public benchmarks
SAME = {"stamp": 1_000_000, "frame": 0}  # of two times that are the same: rounded stamps differ
GAP = {"stamp": 1_500_000_000, "frame": 10}  # between two places of an object, at most
ROUNDED = 0.001  # metres around a box: stored coordinates are rounded


def time_of(scan: Scan, clock: Clock) -> int | None:
    """When a scan was taken, on a clock; None if it does not have that clock."""
    return scan.stamp_ns if clock == "stamp" else scan.index


def clock_of(scan: Scan) -> Clock:
    """The clock of a scan: stamps where there are any."""
    return "frame" if scan.stamp_ns is None else "stamp"


class Span(Struct, frozen=True):
    """A span of time.

    Attributes:
        clock: of its ends.
        first, last: stamps, nanoseconds, or numbers of frames; both inclusive, None for no end.
    """

    clock: Clock
    first: int | None = None
    last: int | None = None

    def contains(self, scan: Scan) -> bool:
        """Whether a scan lies in it; never, if the scan does not have the clock."""
        time = time_of(scan, self.clock)
        if time is None:
            return False
        slack = SAME[self.clock]
        late = self.first is None or time >= self.first - slack
        return late and (self.last is None or time <= self.last + slack)


class BoxRegion(Struct, frozen=True, tag="box"):
    """A box with edges along the axes of the world.

    Attributes:
        low, high: metres.
    """

    low: Corner
    high: Corner

    def bounds(self, scan: Scan) -> tuple[F64, F64] | None:
        """(3,) lowest and highest corner at the time of a scan."""
        return np.array(self.low) - ROUNDED, np.array(self.high) + ROUNDED

    def contains(self, scan: Scan, xyz: F64) -> Bool:
        """(N,) bool: which of (N, 3) points within the bounds are inside."""
        return np.ones(len(xyz), np.bool_)


class PolygonRegion(Struct, frozen=True, tag="polygon"):
    """A polygon in the plane, between two heights.

    Attributes:
        corners: metres, at least three.
        low, high: metres, heights; None for no limit.
    """

    corners: Annotated[tuple[PlanCorner, ...], Meta(min_length=3)]
    low: Finite | None = None
    high: Finite | None = None

    def bounds(self, scan: Scan) -> tuple[F64, F64] | None:
        """(3,) lowest and highest corner at the time of a scan."""
        corners = np.array(self.corners)
        low = -np.inf if self.low is None else self.low - ROUNDED
        high = np.inf if self.high is None else self.high + ROUNDED
        return np.append(corners.min(0), low), np.append(corners.max(0), high)

    def contains(self, scan: Scan, xyz: F64) -> Bool:
        """(N,) bool: which of (N, 3) points within the bounds are inside."""
        from dynaviz.engine.region import in_polygon

        return in_polygon(xyz[:, 0], xyz[:, 1], np.array(self.corners))


class Piece(Struct, frozen=True):
    """An object in one frame.

    Attributes:
        time: of the frame, on the clock of the object.
        low, high: metres: corners of the box around its points.
        cells: its cells, counted from ``low``, as ``packed_cells`` writes them; empty for all of
            the box.
    """

    time: int
    low: Corner
    high: Corner
    cells: str = ""


class ObjectRegion(Struct, frozen=True, tag="object"):
    """An object over its frames: the cells that its points fill in each.

    In a frame between two of its frames, it is where both say that it is on its way.

    Attributes:
        clock: of its pieces.
        pieces: by time, at most one for each.
        edge: metres, of the cells.
        margin: metres around the boxes of pieces without cells.
    """

    clock: Clock
    pieces: Annotated[tuple[Piece, ...], Meta(min_length=1)]
    edge: Annotated[float, Meta(gt=0.0)] = EDGE
    margin: Annotated[float, Meta(ge=0.0)] = ROUNDED

    def __repr__(self) -> str:
        return f"<ObjectRegion in {len(self.pieces)} frames>"

    def bounds(self, scan: Scan) -> tuple[F64, F64] | None:
        """(3,) lowest and highest corner at the time of a scan; None if it is not there."""
        found = self._at(scan)
        if found is None:
            return None
        piece, low, exact = found
        margin = self.edge if not exact else self.margin
        size = np.array(piece.high) - np.array(piece.low)
        return low - margin, low + size + margin

    def contains(self, scan: Scan, xyz: F64) -> Bool:
        """(N,) bool: which of (N, 3) points within the bounds are inside."""
        found = self._at(scan)
        if found is None:
            return np.zeros(len(xyz), np.bool_)
        piece, low, exact = found
        if not piece.cells:
            return np.ones(len(xyz), np.bool_)
        filled = _grid(unpacked_cells(piece.cells), widened=not exact)
        at = np.floor((xyz - low) / self.edge).astype(np.int64) + 1
        inside: Bool = np.asarray(((at >= 0) & (at < filled.shape)).all(1))
        inside[inside] = filled[tuple(at[inside].T)]
        return inside

    def _at(self, scan: Scan) -> tuple[Piece, F64, bool] | None:
        """The piece for a scan, its low corner then, and whether it is of just that time."""
        time = time_of(scan, self.clock)
        if time is None:
            return None
        slack = SAME[self.clock]
        k = bisect_left(self.pieces, time - slack, key=lambda piece: piece.time)
        if k < len(self.pieces) and self.pieces[k].time <= time + slack:
            return self.pieces[k], np.array(self.pieces[k].low), True
        if not 0 < k < len(self.pieces):
            return None
        before = self.pieces[k - 1]
        after = self.pieces[k]
        if after.time - before.time > GAP[self.clock]:
            return None
        share = (time - before.time) / (after.time - before.time)
        low = (1 - share) * np.array(before.low) + share * np.array(after.low)
        return (before if share < 0.5 else after), low, False


Region = ObjectRegion | BoxRegion | PolygonRegion


def packed_cells(cells: NDArray[np.integer]) -> str:
    """Text for (K, 3) cells of 0 to 65535, which ``unpacked_cells`` reads."""
    x, y, z = cells.astype(np.int64).T
    keys = np.unique(x << 32 | y << 16 | z)
    plain = np.stack([keys >> 32, keys >> 16 & 0xFFFF, keys & 0xFFFF]).astype("<u2")
    return base64.b64encode(zlib.compress(plain.tobytes(), 6)).decode()


def unpacked_cells(text: str) -> NDArray[np.integer]:
    """(K, 3) cells.

    Raises:
        ValueError: for other text.
    """
    try:
        plain = zlib.decompress(base64.b64decode(text, validate=True))
    except (binascii.Error, zlib.error) as error:
        raise ValueError(f"cells cannot be unpacked: {error}") from None
    if len(plain) % 6 or not plain:
        raise ValueError(f"cells have {len(plain)} bytes, not a multiple of 6")
    return np.frombuffer(plain, "<u2").reshape(3, -1).T


def piece_of(time: int, xyz: F64, edge: float = EDGE) -> Piece:
    """The piece of an object with (N, 3) points, metres, of which there is at least one."""
    low = xyz.min(0)
    cells = np.floor((xyz - low) / edge).astype(np.int64)
    near = cells.max() < 1 << 16
    return Piece(
        time,
        tuple(low.tolist()),
        tuple(xyz.max(0).tolist()),
        packed_cells(cells) if near else "",
    )


def _grid(cells: NDArray[np.integer], widened: bool) -> Bool:
    """Filled cells from one before the first, with their neighbours if ``widened``."""
    grid = np.zeros(cells.max(0).astype(np.int64) + 3, np.bool_)
    grid[tuple(cells.T.astype(np.int64) + 1)] = True
    if widened:
        for axis in range(3):
            wide = grid.copy()
            to = [slice(None)] * 3
            of = [slice(None)] * 3
            to[axis] = slice(1, None)
            of[axis] = slice(None, -1)
            wide[tuple(to)] |= grid[tuple(of)]
            wide[tuple(of)] |= grid[tuple(to)]
            grid = wide
    return grid


def check_region(region: Region) -> None:
    """Raise ValueError for a region that no point can be in, or with damaged cells."""
    if isinstance(region, BoxRegion) and any(
        low > high for low, high in zip(region.low, region.high, strict=True)
    ):
        raise ValueError("the low corner of a box is above its high corner")
    if isinstance(region, PolygonRegion):
        low = -np.inf if region.low is None else region.low
        if low > (np.inf if region.high is None else region.high):
            raise ValueError("the low height of a polygon is above its high one")
    if isinstance(region, ObjectRegion):
        times = [piece.time for piece in region.pieces]
        if any(after <= before for before, after in itertools.pairwise(times)):
            raise ValueError("the pieces of an object are not in the order of time")
        for piece in region.pieces:
            if piece.cells:
                unpacked_cells(piece.cells)


def to_plain(region: Region) -> dict[str, object]:
    """A region in plain types."""
    plain: dict[str, object] = msgspec.to_builtins(region)
    return plain
