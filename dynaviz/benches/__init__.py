"""Benches: methods x sequences x parameter sets, one folder a cell, resumed where they were left."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from dynaviz.benches import cell as cells
from dynaviz.benches.board import Board, Found, Row
from dynaviz.benches.file import plan_of, read
from dynaviz.benches.local import Local
from dynaviz.benches.plan import Cell, ParameterSet, Plan, Source
from dynaviz.benches.source import open_source, placed, simulated
from dynaviz.errors import DataError, DynavizError, UsageError

__all__ = ["Board", "Cell", "Found", "Plan", "Row", "Watcher", "bench", "read"]


class Watcher:
    """Hears how a bench goes on, on several threads; subclasses say what they care for."""

    def preparing(self, what: str, done: int, total: int) -> None:
        """A sequence is simulated or surveyed, and so many of its frames are done."""

    def planned(self, number: int) -> None:
        """So many further cells are to end."""

    def running(self, cell: Cell, phase: str, done: int, total: int) -> None:
        """A cell runs, and so many frames of a phase are done."""

    def ended(self, row: Row) -> None:
        """A cell has ended, or was done already."""


class Runner(Protocol):
    """What runs cells, here or elsewhere."""

    def run(self, todo: list[Cell]) -> Iterator[Cell]:
        """Run cells and give each as soon as it has ended."""
        ...


def bench(
    plan: str | os.PathLike[str] | Mapping[str, Any],
    out: str | os.PathLike[str],
    *,
    scheduler: str | None = None,
    fresh: bool = False,
    watcher: Watcher | None = None,
) -> Board:
    """Run methods on sequences, with several sets of parameters if asked for, and search for better ones.

    Cells that are done are kept: whole, of the same data, parameters and versions. All others run. A cell that fails is
    a row with its error, and the others go on.

    Args:
        plan: a TOML file, or a mapping with its content (``examples/bench.toml`` explains every key).
        out: the bench's folder; a cell's files are in ``out/SEQUENCE/METHOD[-VARIANT]``.
        scheduler: address of a Dask scheduler whose workers run the cells.
        fresh: run every cell again.
        watcher: hears how it goes on.

    Returns:
        The rows; printing them with rich shows a leaderboard.

    Raises:
        UsageError, DataError: for a plan with a mistake in it, and for a sequence that cannot be opened.
    """
    given = read(Path(plan)) if isinstance(plan, (str, os.PathLike)) else plan
    checked = plan_of(given, "bench" if given is plan else os.fspath(plan))  # type: ignore[arg-type]
    if scheduler and checked.timing:
        raise UsageError("timing needs this machine alone: leave out --scheduler")
    if scheduler and "workers" in given:
        raise UsageError("a cluster has its own workers: leave out workers, or --scheduler")
    folder, watcher = Path(out), watcher or Watcher()
    if checked.search:
        from dynaviz.benches import study

        study.check(checked)
    with _runner(folder, scheduler, checked, watcher) as runner:
        desk = Desk(folder, checked, runner, fresh, watcher)
        learning = [source for source in checked.sources if source.name not in checked.holdout]
        for source in learning:
            if not source.scene:
                open_source(source)  # what is not there is told before any work
        _make(folder)
        rows = desk.rows(checked.sets, learning)
        if not checked.search:
            return Board(rows)
        tried, found = study.search(desk, checked.search, learning, folder)
        best = [one.best for one in found if one.best.variant and one.best not in checked.sets]
        rows += desk.rows(best, learning)
        shown = {row.folder for row in rows}
        trials = {row.folder: row for row in tried if row.folder not in shown}
        # Only now is anything looked at that was held out.
        held = [source for source in checked.sources if source.name in checked.holdout]
        rows += desk.rows([*checked.sets, *best], held)
        return Board(rows, checked.holdout, found, [*trials.values()])


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        problem = f"cannot be made ({error.strerror})"
        raise DataError(folder, problem, hint="Choose another folder with -o") from None


@contextlib.contextmanager
def _runner(out: Path, scheduler: str | None, plan: Plan, watcher: Watcher) -> Iterator[Runner]:
    if not scheduler:
        yield Local(out, plan.workers, watcher.running)
        return
    from dynaviz.benches.cluster import Cluster

    with contextlib.closing(Cluster(out, scheduler, watcher.running)) as cluster:
        yield cluster


@dataclass
class Desk:
    """Where cells are handed in: those that are done are kept, all others run."""

    out: Path
    plan: Plan
    runner: Runner
    fresh: bool
    watcher: Watcher
    _digests: dict[Source, str | DynavizError] = field(default_factory=dict)
    _ended: dict[Path, Row] = field(default_factory=dict)

    def rows(self, sets: Iterable[ParameterSet], sources: Iterable[Source]) -> list[Row]:
        """Have every set run on every sequence; give the rows sequence by sequence, in this order."""
        sets = list(sets)
        wanted = [self._cell(source, what) for source in sources for what in sets]
        new = {cell.path: cell for cell in wanted if cell.path not in self._ended}
        self.watcher.planned(len(new))
        todo = []
        for cell in new.values():
            folder, problem = self.out / cell.path, self._digests[cell.source]
            if isinstance(problem, DynavizError):
                cells.clear(folder)
                cells.fail(cell, folder, str(problem))
                self._end(cell)
            elif result := None if self.fresh else cells.finished(cell, folder):
                self._end(cell, Row(cell, folder, result, kept=True))
            else:
                todo.append(cell)
        with contextlib.closing(self.runner.run(todo)) as ended:  # type: ignore[type-var]
            for cell in ended:
                self._end(cell)
        return [self._ended[cell.path] for cell in wanted]

    def _end(self, cell: Cell, row: Row | None = None) -> None:
        folder = self.out / cell.path
        if row is None:
            result = cells.finished(cell, folder)
            error = None if result else cells.error_of(folder) or "its files vanished. Run the bench again."
            row = Row(cell, folder, result, error)
        self._ended[cell.path] = row
        self.watcher.ended(row)

    def _cell(self, source: Source, what: ParameterSet) -> Cell:
        source = placed(source, self.out)
        if source not in self._digests:
            self._digests[source] = self._digest(source)
        digest = self._digests[source]
        known = "" if isinstance(digest, DynavizError) else digest
        return Cell(source, what, known, self.plan.record, self.plan.timing)

    def _digest(self, source: Source) -> str | DynavizError:
        """Read a sequence, once a bench; what keeps it from being read is an answer too."""
        from dynaviz.survey import survey

        def tell(what: str) -> Callable[[int, int], None]:
            return lambda done, total: self.watcher.preparing(f"{what} {source.name}", done, total)

        try:
            if source.scene:
                simulated(source, tell("simulating"))
            sequence = open_source(source)
            reading, total = tell("reading"), len(sequence)
            return survey(sequence, lambda done: reading(done, total)).digest
        except DynavizError as error:
            return error
