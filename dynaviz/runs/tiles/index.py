"""The index of a sequence: which frames see which tiles. One pass makes it.

It is kept in the folder of the run.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from dynaviz.arrays import F32, F64, I64
from dynaviz.contracts.extent import CELL, Extent
from dynaviz.contracts.scan import Scan, Sequence, stream
from dynaviz.errors import DataError
from dynaviz.io.atomic import write_atomic
from dynaviz.io.npy import open_npy
from dynaviz.runs.tiles.grid import Tile, TileGrid, unpacked
from dynaviz.sources.origin import PoseNoise
from dynaviz.sources.pose_noise import PoseNoiseMeter
from dynaviz.sources.summary import ScanDigest, SequenceSummary

SECTORS = 64  # of azimuth around the sensor, each with the range of its farthest point
_ARRAYS = (
    "numbers",
    "points",
    "positions",
    "farthest",
    "frame_of",
    "tile_of",
    "count_of",
    "low",
    "high",
)


@dataclass(frozen=True, eq=False)
class SequenceIndex:
    """Where the frames of a sequence are, and what they see.

    Attributes:
        size: edge of a tile, metres.
        fingerprint: of the sequence, from a few of its frames.
        digest: of the whole content, as in ``SequenceSummary``.
        numbers, points: (F,) int64: number (``Scan.index``) and points of each frame.
        positions: (F, 3) float64, metres, world frame: of the sensor.
        farthest: (F, SECTORS) float32, metres: horizontal range of the farthest point in each
            sector of azimuth, and the largest distance of a ray's origin from the sensor's
            position.
        frame_of, tile_of, count_of: (K,) int64: frame (position in the sequence), packed tile, and
            number of the frame's points in it; by frame.
        low, high: (3,) float64, metres, world frame: bounds of all finite points and ray origins.
        pose_noise: as in ``SequenceSummary``.
    """

    size: float
    fingerprint: str
    digest: str
    numbers: I64
    points: I64
    positions: F64
    farthest: F32
    frame_of: I64
    tile_of: I64
    count_of: I64
    low: F64
    high: F64
    pose_noise: PoseNoise | None = None

    @classmethod
    def of(
        cls, sequence: Sequence, size: float, progress: Callable[[int], None] = lambda done: None
    ) -> SequenceIndex:
        """Read a sequence once, frame by frame.

        Args:
            sequence: never held in memory as a whole.
            size: edge of a tile, metres.
            progress: called with the number of frames done.
        """
        grid = TileGrid(size)
        digest = ScanDigest()
        rows = _Rows()
        meter = PoseNoiseMeter(len(sequence))
        for done, scan in enumerate(stream(sequence), 1):
            digest.add(scan)
            meter.add(done - 1, scan)
            tiles, _, counts = grid.counted(scan)
            rows.add(scan, tiles, counts)
            progress(done)
        return cls(size, fingerprint(sequence), digest.hexdigest(), *rows.arrays(), meter.result())

    @property
    def tiles(self) -> list[Tile]:
        """The tiles that contain points, in order."""
        return [unpacked(int(tile)) for tile in np.unique(self.tile_of)]

    @property
    def summary(self) -> SequenceSummary:
        """The summary of the sequence.

        Its cells are those of the sensor's path only, to bound their number.
        """
        cells = np.unique(np.floor(self.positions / CELL).astype(np.int32), axis=0)
        extent = Extent(self.low, self.high, cells)
        points = int(self.points.sum())
        return SequenceSummary(extent, len(self.points), points, self.digest, self.pose_noise)

    @property
    def points_by_tile(self) -> dict[Tile, float]:
        """Share of the points that lie in each tile."""
        tiles, of = np.unique(self.tile_of, return_inverse=True)
        shares = np.bincount(of, self.count_of) / max(int(self.count_of.sum()), 1)
        return dict(zip(map(unpacked, tiles.tolist()), shares.tolist(), strict=True))

    @property
    def most_tiles(self) -> int:
        """Number of tiles in which a frame has points, at most."""
        return int(np.bincount(self.frame_of).max(initial=0))

    def frames_reaching(self, tile: Tile, margin: float) -> I64:
        """(K,) int64: the frames whose rays may cross a tile or end within ``margin``
        metres of it.
        """
        low, high = TileGrid(self.size).bounds(tile) + np.array([[-margin], [margin]])
        offset = np.maximum(
            np.maximum(low - self.positions[:, :2], self.positions[:, :2] - high), 0
        )
        distance = np.hypot(*offset.T)
        near = np.flatnonzero(distance <= self.farthest.max(1))
        corners = np.array([[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])])
        return near[
            [
                distance[f] <= self._towards(f, corners, bool(distance[f] == 0))
                for f in near.tolist()
            ]
        ]

    def _towards(self, frame: int, corners: F64, inside: bool) -> float:
        """Horizontal range of the farthest point of a frame in the direction of corners (4, 2).

        Infinite if inside.
        """
        if inside:
            return np.inf
        seen = corners - self.positions[frame, :2]
        centre = np.arctan2(*seen.mean(0)[::-1])
        around = (np.arctan2(seen[:, 1], seen[:, 0]) - centre + np.pi) % (2 * np.pi) - np.pi
        first, last = np.floor(
            (centre + np.array([around.min(), around.max()])) * SECTORS / (2 * np.pi)
        ).astype(int)
        sectors = np.arange(first - 1, last + 2) % SECTORS
        return float(self.farthest[frame, sectors].max())

    def save(self, path: Path) -> None:
        """Write the index, whole or not at all."""
        buffer = io.BytesIO()
        noise = msgspec.json.encode(self.pose_noise).decode()
        facts = {
            "size": self.size,
            "fingerprint": self.fingerprint,
            "digest": self.digest,
            "pose_noise": noise,
        }
        np.savez_compressed(buffer, **facts, **{name: getattr(self, name) for name in _ARRAYS})  # type: ignore[arg-type]
        write_atomic(path, buffer.getvalue())

    @classmethod
    def load(cls, path: Path) -> SequenceIndex:
        """Read an index.

        Raises:
            DataError: if the file is not an index, or is damaged.
        """
        with open_npy(path, "index of a run with tiles", "Delete it; the run writes it again") as z:
            facts = float(z["size"]), str(z["fingerprint"]), str(z["digest"])
            noise = msgspec.json.decode(str(z["pose_noise"]), type=PoseNoise | None)
            return cls(*facts, **{name: z[name] for name in _ARRAYS}, pose_noise=noise)


def indexed(
    path: Path, sequence: Sequence, size: float, progress: Callable[[int], None]
) -> SequenceIndex:
    """The index in a file if it is that of the sequence, else a new one, which is then stored
    there.
    """
    try:
        index = SequenceIndex.load(path)
        if index.size == size and index.fingerprint == fingerprint(sequence):
            return index
    except DataError:
        pass
    index = SequenceIndex.of(sequence, size, progress)
    index.save(path)
    return index


def fingerprint(sequence: Sequence) -> str:
    """A digest of the number of frames and of five of them.

    Tells sequences apart without reading them.
    """
    digest = ScanDigest()
    n = len(sequence)
    for position in sorted({0, n // 4, n // 2, 3 * n // 4, n - 1}):
        digest.add(sequence[position])
    return f"{n}-{digest.hexdigest()}"


class _Rows:
    """The arrays of an index, frame by frame."""

    def __init__(self) -> None:
        self._numbers: list[int] = []
        self._points: list[int] = []
        self._positions: list[F64] = []
        self._farthest: list[F32] = []
        self._tiles: list[I64] = []
        self._counts: list[I64] = []
        self._low = np.full(3, np.inf)
        self._high = np.full(3, -np.inf)

    def add(self, scan: Scan, tiles: I64, counts: I64) -> None:
        """Add a frame with the tiles of its points."""
        self._numbers.append(scan.index)
        self._points.append(len(scan))
        self._positions.append(scan.position.copy())
        self._tiles.append(tiles)
        self._counts.append(counts)
        finite = (
            scan.points
            if np.isfinite(scan.points).all()
            else scan.points[np.isfinite(scan.points).all(1)]
        )
        for xyz in (finite, scan.origins):
            if len(xyz):
                self._low = np.minimum(self._low, [column.min() for column in xyz.T])
                self._high = np.maximum(self._high, [column.max() for column in xyz.T])
        x = finite[:, 0] - scan.position[0]
        y = finite[:, 1] - scan.position[1]
        sector = np.floor(np.arctan2(y, x) * (SECTORS / (2 * np.pi))).astype(np.int64) % SECTORS
        farthest = np.zeros(SECTORS, np.float32)
        np.maximum.at(farthest, sector, np.hypot(x, y).astype(np.float32))
        aside = np.linalg.norm(scan.origins - scan.position, axis=1).max()
        self._farthest.append(farthest * np.float32(1.000001) + np.float32(aside))

    def arrays(self) -> tuple[I64, I64, F64, F32, I64, I64, I64, F64, F64]:
        """The arrays in the order of ``SequenceIndex``."""
        lengths = [len(tiles) for tiles in self._tiles]
        return (
            np.array(self._numbers, np.int64),
            np.array(self._points, np.int64),
            np.array(self._positions),
            np.array(self._farthest),
            np.repeat(np.arange(len(lengths)), lengths),
            np.concatenate(self._tiles),
            np.concatenate(self._counts).astype(np.int64),
            self._low,
            self._high,
        )
