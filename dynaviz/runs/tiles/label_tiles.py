"""A run on tiles: index the sequence, run every tile, and read the answers of all as those of one
labeller.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from dynaviz.arrays import U8
from dynaviz.contracts import registry
from dynaviz.contracts.extent import CELL
from dynaviz.contracts.method import Context, Halo, Labels, Tileable
from dynaviz.contracts.options import RecordMode
from dynaviz.contracts.scan import Scan
from dynaviz.errors import DataError, UsageError
from dynaviz.progress import Progress, silent
from dynaviz.runs.tiles.grid import Tile, TileGrid, unpacked
from dynaviz.runs.tiles.index import SequenceIndex, indexed
from dynaviz.runs.tiles.tile import DYNAMIC, NEAR, AnswersHead, TileCodes, TileFrames, TileTask
from dynaviz.scores.result import environment
from dynaviz.scores.sections import Runtime, Tiling
from dynaviz.sources.drive import Drive
from dynaviz.tasks.local import InThisProcess, LocalExecutor
from dynaviz.tasks.task import Task, error_of

SPARE = 2  # tiles whose answers are in memory, in addition to those of a frame
DECIDING = ("dynaviz", "numba", "numpy", "scipy")  # packages whose versions may change labels


@dataclass(frozen=True)
class TileOptions:
    """How to divide a run.

    Attributes:
        size: edge of a tile, metres.
        workers: number of tiles that run at a time on this machine.
        scheduler: address of a Dask scheduler whose workers run the tiles instead.
        budget: bytes of the recordings of all tiles together; None for any size.
    """

    size: float
    workers: int = 1
    scheduler: str | None = None
    budget: int | None = None

    def __post_init__(self) -> None:
        if not 10 <= self.size <= 1000:
            raise UsageError(
                f"--tiles {self.size:g}: give the edge of a tile in metres, from 10 to 1000"
            )
        if self.workers < 1:
            raise UsageError(f"--workers {self.workers}: give 1 or more")


class TiledLabels:
    """The answers of all tiles, as a labeller.

    Args:
        folder: of the run.
        method: the class of the method.
        params: its parameters.
        index: of the sequence.
        halo: what decides the labels in a tile.

    Attributes:
        info: that of the method.
        runtime: cost of the method, over all tiles.
        tiling: for the result.
        summary: of the sequence.
    """

    scoring = "mask"

    def __init__(
        self, folder: Path, method: Any, params: Any, index: SequenceIndex, halo: Halo
    ) -> None:
        self.info = method.info
        self.Params = method.Params
        self.params = params
        self._folder = folder
        self._grid = TileGrid(index.size)
        self.summary = index.summary
        self._answers = lru_cache(maxsize=index.most_tiles + SPARE)(self._load)
        runtimes = [
            AnswersHead.load(self._path(packed)).runtime
            for packed in np.unique(index.tile_of).tolist()
        ]
        self.runtime = _total(runtimes, len(index.numbers))
        self.tiling = Tiling(
            index.size, halo.metres, len(runtimes), sum(each.frames or 0 for each in runtimes)
        )

    def begin(self, context: Context) -> None:
        """Nothing to prepare."""

    def label(self, scan: Scan) -> Labels:
        """The answers of the tiles for their points of this scan."""
        codes = np.zeros(len(scan), np.uint8)
        (tiles, of, counts) = self._grid.counted(scan)
        for place, (packed, count) in enumerate(zip(tiles.tolist(), counts.tolist(), strict=True)):
            codes[of == place] = self._of(packed, scan, count)
        return Labels(codes >= DYNAMIC, codes % np.uint8(DYNAMIC))

    def _of(self, packed: int, scan: Scan, points: int) -> U8:
        answers = self._answers(packed)
        first, end = answers.rows.get(scan.index, (0, 0))
        if end - first != points:
            problem = (
                f"frame {scan.index} has {points:,} points in this tile, but {end - first:,} "
                "answers"
            )
            raise DataError(
                self._path(packed), problem, hint="The data changed during the run: run it again"
            )
        return answers.codes[first:end]

    def _load(self, packed: int) -> TileCodes:
        return TileCodes.load(self._path(packed))

    def _path(self, packed: int) -> Path:
        return self._folder / "tiles" / "{}_{}".format(*unpacked(packed)) / TileTask.files[-1]


def label_tiles(
    folder: Path,
    method: Any,
    params: Any,
    sequence: Drive,
    options: TileOptions,
    *,
    online: bool = False,
    seed: int = 0,
    record: RecordMode | None = None,
    progress: Progress = silent,
) -> TiledLabels:
    """Label a sequence tile by tile; tiles that an interrupted run finished are kept.

    Args:
        folder: of the run; receives ``index.npz`` and ``tiles/``.
        method: the class of the method.
        params: its parameters.
        sequence: of any length.
        options: size of the tiles, and who runs them.
        online, seed: as in ``RunSpec``.
        record: mode of the recording of each tile, ``tiles/X_Y/run.rrd``; None writes none.
        progress: called with ``index`` and frames, then with ``tiles`` and tiles.

    Returns:
        A labeller with the answers, and the summary of the sequence. It does not keep the index.

    Raises:
        UsageError: for a method whose labels depend on the whole map.
        DataError: if a tile fails; the others are finished first.
    """
    labeller = method(params)
    halo = labeller.halo() if isinstance(labeller, Tileable) else Halo(math.inf)
    if halo.metres == math.inf:
        raise UsageError(
            f"{method.info.name} cannot run on tiles: with these parameters, labels depend on the "
            "whole map. "
            f"Methods that can: {', '.join(tileable())}"
        )
    total = len(sequence)
    index = indexed(
        folder / "index.npz", sequence, options.size, lambda done: progress("index", done, total)
    )
    key = _key(index, method.info.name, params, online, seed)
    shares = index.points_by_tile
    tasks = [
        TileTask(
            tile_frames(sequence, index, tile, halo, record is not None),
            *(options.size, tile, method.info.name, params, seed, online, halo, key, record),
            options.budget and int(options.budget * shares[tile]),
        )
        for tile in index.tiles
    ]
    todo = [task for task in tasks if not task.finished(folder / task.path)]
    progress("tiles", len(tasks) - len(todo), len(tasks))
    with _executor(folder, options) as executor, contextlib.closing(executor.run(todo)) as ended:
        for done, _ in enumerate(ended, len(tasks) - len(todo) + 1):
            progress("tiles", done, len(tasks))
    failed = [task for task in todo if not task.finished(folder / task.path)]
    if failed:
        error = error_of(folder / failed[0].path) or "it left no answers."
        names = ", ".join(task.path.name for task in failed[:5]) + (
            ", ..." if len(failed) > 5 else ""
        )
        problem = f"{len(failed)} of {len(tasks)} tiles failed ({names}): {error}"
        raise DataError(
            folder / failed[0].path, problem, hint="The same command continues with these"
        )
    return TiledLabels(folder, method, params, index, halo)


def tile_frames(
    sequence: Drive, index: SequenceIndex, tile: Tile, halo: Halo, truth: bool
) -> TileFrames:
    """The frames of a sequence that see a tile or its halo."""
    frames = index.frames_reaching(tile, halo.metres + 2 * CELL)
    return TileFrames.of(
        sequence, index, frames, TileGrid(index.size).local_origin(tile, NEAR), truth
    )


def tileable() -> list[str]:
    """Names of the methods that can run on tiles."""
    kinds = registry.loadable("methods")
    return [name for name, kind in kinds.items() if isinstance(kind(kind.Params()), Tileable)]


@contextlib.contextmanager
def _executor(folder: Path, options: TileOptions) -> Iterator[Any]:
    def report(task: Task, phase: str, done: int, total: int) -> None:
        pass

    if not options.scheduler:
        several = options.workers > 1
        yield (
            LocalExecutor(folder, options.workers, report, reuse=True)
            if several
            else InThisProcess(folder, report)
        )
        return
    from dynaviz.tasks.cluster import DaskExecutor

    with contextlib.closing(DaskExecutor(folder, options.scheduler, report)) as cluster:
        yield cluster


def _key(index: SequenceIndex, method: str, params: Any, online: bool, seed: int) -> str:
    versions = environment().versions
    deciding = [versions.get(name) for name in DECIDING]
    facts = [index.digest, index.size, method, dataclasses.asdict(params), online, seed, deciding]
    return hashlib.sha256(msgspec.json.encode(facts, order="deterministic")).hexdigest()


def _total(runtimes: list[Runtime], frames: int) -> Runtime:
    """Seconds of all tiles per frame of the sequence; the largest memory of any."""
    seconds = sum((each.mean_s or 0.0) * (each.frames or 0) for each in runtimes)
    prepared = sum(each.prepare_s or 0.0 for each in runtimes)
    peak = max((each.peak_rss_mb or 0.0 for each in runtimes), default=0.0)
    threads = runtimes[0].threads if runtimes else None
    return Runtime(seconds / max(frames, 1), None, frames, prepared, threads, peak or None)
