"""The run of one tile: an ordinary run on the frames that see it, whose answers for the tile's own points are kept."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from dynaviz import registry
from dynaviz.arrays import F64, I64, U8
from dynaviz.engine.loop import Listener, RunSpec, execute
from dynaviz.engine.summary import summarize
from dynaviz.errors import DataError
from dynaviz.io.atomic import write_atomic
from dynaviz.io.npy import open_npy
from dynaviz.method import Halo
from dynaviz.metric import Figure, Labelled
from dynaviz.progress import Progress
from dynaviz.results.result import Result
from dynaviz.results.sections import Runtime
from dynaviz.scan import Scan, Sequence, SequenceView
from dynaviz.spatial.extent import CELL
from dynaviz.tiling.grid import Tile, TileGrid, packed
from dynaviz.tiling.index import SequenceIndex

NEAR = 2500.0  # metres: with a reach of 300 m around the tile, within 32768 voxels of 0.1 m
CYCLE = (
    60  # frames: gaps shrink by multiples of this, so that methods that use every second or fourth frame stay in step
)
DYNAMIC = 128  # added to the reason code of dynamic points
_HINT = "Delete it and run the same command again"


@dataclass(frozen=True, eq=False)
class TileFrames(SequenceView):
    """The frames of a sequence that see a tile, with empty scans in place of some of the others.

    Attributes:
        whole: the sequence.
        rows: positions in the sequence, in order; -1 - position for an empty scan.
        numbers, places: of these frames: ``Scan.index`` and position of the sensor, (K, 3) float64, metres.
        origin: (3,) float64, metres: subtracted from all coordinates.
    """

    whole: Sequence
    rows: I64
    numbers: I64
    places: F64
    origin: F64

    @classmethod
    def of(cls, sequence: Sequence, index: SequenceIndex, frames: I64, origin: F64) -> TileFrames:
        """The frames at these positions, and short gaps of empty scans between them."""
        rows: list[int] = []
        expected = 0
        for frame in frames.tolist():
            gap = frame - expected
            skipped = gap if gap < 2 * CYCLE else CYCLE + gap % CYCLE
            rows += [-1 - k for k in range(frame - skipped, frame)]
            rows.append(frame)
            expected = frame + 1
        chosen = np.array(rows, np.int64)
        at = np.where(chosen < 0, -1 - chosen, chosen)
        return cls(sequence, chosen, index.numbers[at], index.positions[at], origin)

    @property
    def has_labels(self) -> bool:
        """False: a tile is not scored on its own."""
        return False

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, position: int) -> Scan:
        row = int(self.rows[position])
        if row < 0:
            pose = np.eye(4)
            pose[:3, 3] = self.places[position]
            scan = Scan(int(self.numbers[position]), np.empty((0, 3), np.float32), pose)
        else:
            scan = self.whole[row].without_truth()
        return scan.moved(-self.origin) if self.origin.any() else scan


@dataclass(frozen=True)
class TileTask:
    """The run of one tile, as a ``dynaviz.tasks.task.Task``.

    Attributes:
        sequence: the whole sequence.
        index: where its frames are.
        tile: which tile.
        method, params, seed, online: as in ``RunSpec``.
        halo: what decides the labels in a tile.
        key: digest of all that decides the answers.
    """

    sequence: Sequence
    index: SequenceIndex
    tile: Tile
    method: str
    params: Any
    seed: int
    online: bool
    halo: Halo
    key: str
    kind = "tile"
    smaller = "Use smaller tiles."
    files = ("answers.npz",)

    @property
    def path(self) -> Path:
        """Its folder, relative to that of the run."""
        return Path("tiles", "{}_{}".format(*self.tile))

    @property
    def facts(self) -> Mapping[str, str]:
        """What identifies the tile."""
        return {"method": self.method, "sequence": self.sequence.name, "tile": self.path.name}

    def run(self, folder: Path, threads: int | None, progress: Progress) -> None:
        """Label the points of the tile in this process.

        Raises:
            DynavizError: as ``dynaviz.run``.
        """
        grid, margin = TileGrid(self.index.size), self.halo.metres + 2 * CELL
        bounds, origin = grid.bounds(self.tile), grid.local_origin(self.tile, NEAR)
        frames = TileFrames.of(self.sequence, self.index, self.index.frames_reaching(self.tile, margin), origin)
        summary = summarize(frames, lambda done: progress("survey", done, len(frames)))
        if not self.halo.along_rays:
            low, high = bounds[0] - margin - origin[:2], bounds[1] + margin - origin[:2]
            summary = dataclasses.replace(summary, extent=summary.extent.cropped(low, high))
        kind = registry.load("methods", self.method)
        spec = RunSpec(
            kind(self.params), frames, self.params, (), self.online, self.seed, threads=threads, summary=summary
        )
        answers = TileAnswers(folder / self.files[0], self.key, packed(self.tile), grid, frames)
        execute(spec, [answers], progress=progress)

    def finished(self, folder: Path) -> bool:
        """Whether its answers are complete and belong to this run."""
        try:
            return AnswersHead.load(folder / self.files[0]).key == self.key
        except DataError:
            return False


class TileAnswers(Listener):
    """Writes ``answers.npz``: for each frame, the answers for the tile's points in the order of the frame.

    ``numbers``: (K,) int64 numbers of the frames; ``counts``: (K,) int64 points of each; ``codes``: uint8 codes of the
    reasons, plus ``DYNAMIC`` for points that are removed; ``runtime``: cost of the method, JSON.
    """

    def __init__(self, path: Path, key: str, tile: int, grid: TileGrid, frames: TileFrames):
        self._path, self._key, self._tile, self._grid, self._frames = path, key, tile, grid, frames
        self._numbers: list[int] = []
        self._codes: list[U8] = []

    def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
        """Keep the answers for the tile's points."""
        if self._frames.rows[labelled.frame] < 0:
            return
        origin = self._frames.origin
        scan = labelled.scan.moved(origin) if origin.any() else labelled.scan
        own = self._grid.owners(scan) == self._tile
        if own.any():
            self._numbers.append(scan.index)
            self._codes.append(labelled.reasons[own] + labelled.dynamic[own] * np.uint8(DYNAMIC))

    def finish(self, result: Result, figures: Mapping[str, Figure]) -> None:
        """Write the file."""
        counts = np.array([len(codes) for codes in self._codes], np.int64)
        buffer = io.BytesIO()
        np.savez_compressed(
            buffer,
            key=self._key,
            numbers=np.array(self._numbers, np.int64),
            counts=counts,
            codes=np.concatenate([np.empty(0, np.uint8), *self._codes]),
            runtime=msgspec.json.encode(result.runtime).decode(),
        )
        write_atomic(self._path, buffer.getvalue())


@dataclass(frozen=True)
class AnswersHead:
    """What ``answers.npz`` says about a tile, read without its answers.

    Attributes:
        key: digest of all that decides them.
        runtime: cost of the method.
    """

    key: str
    runtime: Runtime

    @classmethod
    def load(cls, path: Path) -> AnswersHead:
        """Read ``answers.npz``.

        Raises:
            DataError: if the file is missing or damaged.
        """
        with open_npy(path, "file of answers", _HINT) as z:
            return cls(str(z["key"]), msgspec.json.decode(str(z["runtime"]), type=Runtime))


@dataclass(frozen=True, eq=False)
class Answers:
    """The answers for the points of a tile.

    Attributes:
        rows: first and last row in ``codes`` of each frame, by number.
        codes: (N,) uint8, as in ``TileAnswers``.
    """

    rows: Mapping[int, tuple[int, int]]
    codes: U8

    @classmethod
    def load(cls, path: Path) -> Answers:
        """Read ``answers.npz``.

        Raises:
            DataError: if the file is missing, damaged or inconsistent.
        """
        with open_npy(path, "file of answers", _HINT) as z:
            ends = np.cumsum(z["counts"])
            rows = zip(z["numbers"].tolist(), (ends - z["counts"]).tolist(), ends.tolist(), strict=True)
            answers = cls({number: (first, end) for number, first, end in rows}, z["codes"])
            if len(answers.codes) != (ends[-1] if len(ends) else 0):
                raise ValueError("its arrays have different lengths")
        return answers
