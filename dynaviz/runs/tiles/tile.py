"""The run of one tile: an ordinary run on the frames that see it, whose answers for the tile's own
points are kept.
"""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from dynaviz.arrays import F32, F64, I64, U8, Intp
from dynaviz.contracts import registry
from dynaviz.contracts.attributes import Attributes, Unposed
from dynaviz.contracts.extent import CELL, GrowingExtent
from dynaviz.contracts.method import Halo
from dynaviz.contracts.metric import Figure, Labelled, Metric
from dynaviz.contracts.options import RecordMode
from dynaviz.contracts.scan import Scan, stream
from dynaviz.engine.loop import Listener, RunSpec, execute
from dynaviz.errors import DataError
from dynaviz.io.atomic import write_atomic
from dynaviz.io.npy import open_npy
from dynaviz.progress import Progress
from dynaviz.runs.tiles.grid import Tile, TileGrid
from dynaviz.runs.tiles.index import SequenceIndex
from dynaviz.scores.result import Result
from dynaviz.scores.sections import Runtime
from dynaviz.sources.derived import Derived
from dynaviz.sources.drive import Drive
from dynaviz.sources.summary import ScanDigest, SequenceSummary
from dynaviz.spatial.trajectory import Moved, PosesOverTime

NEAR = 2500.0  # metres: with a reach of 300 m around the tile, within 32768 voxels of 0.1 m
# Frames: gaps shrink by multiples of this, so that methods that use every second or fourth frame
# stay in step.
CYCLE = 60
DYNAMIC = 128  # added to the reason code of dynamic points
_HINT = "Delete it and run the same command again"


@dataclass(frozen=True, eq=False)
class TileFrames(Derived):
    """The frames of a drive that see a tile, with empty scans in place of some of the others.

    Attributes:
        whole: the drive.
        rows: positions in the sequence, in order; -1 - position for an empty scan.
        numbers, places: of these frames: ``Scan.index`` and position of the sensor, (K, 3) float64,
            metres.
        offset: (3,) float64, metres: subtracted from all coordinates of the sequence.
        truth: whether scans have their ground truth, which only a recording needs.
    """

    whole: Drive
    rows: I64
    numbers: I64
    places: F64
    offset: F64
    truth: bool = False

    @classmethod
    def of(
        cls, sequence: Drive, index: SequenceIndex, frames: I64, offset: F64, truth: bool = False
    ) -> TileFrames:
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
        return cls(sequence, chosen, index.numbers[at], index.positions[at], offset, truth)

    @property
    def has_labels(self) -> bool:
        """Whether scans have ground truth."""
        return self.truth and self.whole.has_labels

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def origin(self) -> F64:
        """(3,) float64, metres: what to add to coordinates to get those of the source."""
        return self.whole.origin + self.offset

    def attributes(self, position: int) -> Attributes:
        """Those of the sequence's frame."""
        row = int(self.rows[position])
        return {} if row < 0 else self.whole.attributes(row)

    def coordinates(self, position: int) -> F32 | F64 | None:
        """Those of the sequence's frame."""
        row = int(self.rows[position])
        return None if row < 0 else self.whole.coordinates(row)

    def unposed(self) -> Iterator[Unposed]:
        """None: those of the sequence belong to no tile."""
        yield from ()

    @property
    def trajectories(self) -> Mapping[int, PosesOverTime]:
        """Those of the sequence."""
        found = self.whole.trajectories
        return {lidar: Moved(poses, -self.offset) for lidar, poses in found.items()}

    def __getitem__(self, position: int) -> Scan:
        row = int(self.rows[position])
        if row < 0:
            pose = np.eye(4)
            pose[:3, 3] = self.places[position]
            scan = Scan(int(self.numbers[position]), np.empty((0, 3), np.float32), pose)
        else:
            scan = self.whole[row] if self.truth else self.whole[row].without_truth()
        return scan.moved(-self.offset) if self.offset.any() else scan


@dataclass(frozen=True)
class TileTask:
    """The run of one tile, as a ``dynaviz.tasks.task.Task``.

    Attributes:
        frames: those that see the tile.
        size: edge of a tile, metres.
        tile: which tile.
        method, params, seed, online: as in ``RunSpec``.
        halo: what decides the labels in a tile.
        key: digest of all that decides the answers.
        record: mode of the tile's recording; None writes none.
        budget: of the recording, bytes; None for any size.
    """

    frames: TileFrames
    size: float
    tile: Tile
    method: str
    params: Any
    seed: int
    online: bool
    halo: Halo
    key: str
    record: RecordMode | None = None
    budget: int | None = None
    kind = "tile"
    smaller = "Use smaller tiles."
    files = ("run.rrd", "answers.npz")

    @property
    def path(self) -> Path:
        """Its folder, relative to that of the run."""
        return Path("tiles", "{}_{}".format(*self.tile))

    @property
    def facts(self) -> Mapping[str, str]:
        """What identifies the tile."""
        return {"method": self.method, "sequence": self.frames.name, "tile": self.path.name}

    def run(self, folder: Path, threads: int | None, progress: Progress) -> None:
        """Label the points of the tile in this process.

        Raises:
            DynavizError: as ``dynaviz.run``.
        """
        grid = TileGrid(self.size)
        frames = self.frames
        summary = self._summary(progress)
        kind = registry.load("methods", self.method)
        spec = RunSpec(
            kind(self.params),
            frames,
            self.params,
            (),
            self.online,
            self.seed,
            threads=threads,
            summary=summary,
        )
        own = OwnPoints(grid, self.tile, frames)
        answers = TileAnswers(folder / self.files[-1], self.key, self._recorded, own)
        if self.record is None:
            execute(spec, [answers], progress=progress)
            return
        from dynaviz.views.record.recorder import Recorder

        metrics = tuple(
            OwnMetric(each(kind.info), own) for each in registry.loadable("metrics").values()
        )
        with Recorder(
            folder / self.files[0], self.record, budget=self.budget, rows=own.rows
        ) as recorder:
            spec = dataclasses.replace(spec, metrics=metrics)
            execute(spec, [OwnListener(recorder, own), answers], recorder, progress)

    def _summary(self, progress: Progress) -> SequenceSummary:
        """The summary of its frames, with cells in the tile and around it only.

        A digest only for a recording.
        """
        growing = GrowingExtent()
        digest = ScanDigest()
        points = 0
        total = len(self.frames)
        margin = self.halo.metres + 2 * CELL
        low, high = (
            TileGrid(self.size).bounds(self.tile)
            - self.frames.offset[:2]
            + np.array([[-margin], [margin]])
        )
        around = None if self.halo.along_rays else np.array([low - CELL, high + CELL])
        for done, scan in enumerate(stream(self.frames), 1):
            growing.add(scan, around)
            points += len(scan)
            if self.record is not None:
                digest.add(scan)
            progress("survey", done, total)
        extent = growing.extent()
        if not self.halo.along_rays:
            extent = extent.cropped(low, high)
        return SequenceSummary(extent, total, points, digest.hexdigest())

    def finished(self, folder: Path) -> bool:
        """Whether its answers are complete and belong to this run, with a recording if one is
        requested.
        """
        try:
            head = AnswersHead.load(folder / self.files[-1])
        except DataError:
            return False
        recorded = self.record is None or (
            head.recorded == self._recorded and (folder / self.files[0]).is_file()
        )
        return head.key == self.key and recorded

    @property
    def _recorded(self) -> str:
        return "" if self.record is None else f"{self.record} {self.budget}"


class OwnPoints:
    """Reduces labelled scans of a tile's run to the tile's own points."""

    def __init__(self, grid: TileGrid, tile: Tile, frames: TileFrames) -> None:
        self.frames = frames
        self._grid = grid
        self._tile = tile
        self._last: tuple[Labelled, Labelled] | None = None

    def rows(self, scan: Scan) -> Intp:
        """(K,) the points of a scan of the run that belong to the tile."""
        return self._grid.rows(scan, self._tile, self.frames.offset)

    def of(self, labelled: Labelled) -> Labelled:
        """A scan with its labels, reduced; computed once for the last scan."""
        if self._last is None or self._last[0] is not labelled:
            rows = self.rows(labelled.scan)
            dynamic = labelled.dynamic[rows]
            reasons = labelled.reasons[rows]
            self._last = (
                labelled,
                Labelled.of(labelled.frame, labelled.scan.chosen(rows), dynamic, reasons),
            )
        return self._last[1]


class OwnMetric:
    """A metric that sees the points of a tile only."""

    def __init__(self, metric: Metric, own: OwnPoints) -> None:
        self._metric = metric
        self._own = own
        self.finish = metric.finish
        self.figures = metric.figures

    def update(self, labelled: Labelled) -> Mapping[str, float]:
        """Add the tile's points of a scan."""
        return self._metric.update(self._own.of(labelled))


class OwnListener(Listener):
    """Passes the points of a tile on to another listener."""

    def __init__(self, listener: Listener, own: OwnPoints) -> None:
        self._listener = listener
        self._own = own
        self.begin = listener.begin  # type: ignore[method-assign]
        self.finish = listener.finish  # type: ignore[method-assign]
        self.observing = listener.observing  # type: ignore[method-assign]
        self.observed = listener.observed  # type: ignore[method-assign]

    def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
        """Pass on the tile's points of a scan."""
        self._listener.labelled(self._own.of(labelled), curves)


class TileAnswers(Listener):
    """Writes ``answers.npz``.

    For each frame, the answers for the tile's points in the order of the frame.

    ``numbers``: (K,) int64 numbers of the frames; ``counts``: (K,) int64 points of each; ``codes``:
    uint8 codes of the reasons, plus ``DYNAMIC`` for points that are removed; ``runtime``: cost of
    the method, JSON; ``recorded``: mode and budget of the recording.
    """

    def __init__(self, path: Path, key: str, recorded: str, own: OwnPoints):
        self._path = path
        self._key = key
        self._recorded = recorded
        self._own = own
        self._numbers: list[int] = []
        self._codes: list[U8] = []

    def labelled(self, labelled: Labelled, curves: Mapping[str, float]) -> None:
        """Keep the answers for the tile's points."""
        if self._own.frames.rows[labelled.frame] < 0:
            return
        rows = self._own.rows(labelled.scan)
        if len(rows):
            self._numbers.append(labelled.scan.index)
            self._codes.append(labelled.reasons[rows] + labelled.dynamic[rows] * np.uint8(DYNAMIC))

    def finish(self, result: Result, figures: Mapping[str, Figure]) -> None:
        """Write the file."""
        counts = np.array([len(codes) for codes in self._codes], np.int64)
        buffer = io.BytesIO()
        np.savez_compressed(
            buffer,
            key=self._key,
            recorded=self._recorded,
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
        recorded: mode and budget of the recording; empty if there is none.
        runtime: cost of the method.
    """

    key: str
    recorded: str
    runtime: Runtime

    @classmethod
    def load(cls, path: Path) -> AnswersHead:
        """Read ``answers.npz``.

        Raises:
            DataError: if the file is missing or damaged.
        """
        with open_npy(path, "file of answers", _HINT) as z:
            return cls(
                str(z["key"]),
                str(z["recorded"]),
                msgspec.json.decode(str(z["runtime"]), type=Runtime),
            )


@dataclass(frozen=True, eq=False)
class TileCodes:
    """The answers for the points of a tile.

    Attributes:
        rows: first and last row in ``codes`` of each frame, by number.
        codes: (N,) uint8, as in ``TileAnswers``.
    """

    rows: Mapping[int, tuple[int, int]]
    codes: U8

    @classmethod
    def load(cls, path: Path) -> TileCodes:
        """Read ``answers.npz``.

        Raises:
            DataError: if the file is missing, damaged or inconsistent.
        """
        with open_npy(path, "file of answers", _HINT) as z:
            ends = np.cumsum(z["counts"])
            rows = zip(
                z["numbers"].tolist(), (ends - z["counts"]).tolist(), ends.tolist(), strict=True
            )
            answers = cls({number: (first, end) for number, first, end in rows}, z["codes"])
            if len(answers.codes) != (ends[-1] if len(ends) else 0):
                raise ValueError("its arrays have different lengths")
        return answers
