"""Runs the cells of a benchmark that are not finished yet, and keeps those that are."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from dynaviz.benchmarking import cells
from dynaviz.benchmarking.leaderboard import BenchRow
from dynaviz.benchmarking.plan import BenchCell, BenchPlan, ParameterSet, SequenceSpec
from dynaviz.benchmarking.source import open_source, placed, simulated
from dynaviz.errors import DynavizError


class BenchCallbacks:
    """Hears how a bench goes on, on several threads; subclasses say what they care for."""

    def preparing(self, what: str, done: int, total: int) -> None:
        """A sequence is simulated or surveyed, and so many of its frames are done."""

    def planned(self, number: int) -> None:
        """So many further cells are to end."""

    def running(self, cell: BenchCell, phase: str, done: int, total: int) -> None:
        """A cell runs, and so many frames of a phase are done."""

    def ended(self, row: BenchRow) -> None:
        """A cell has ended, or was done already."""


class Executor(Protocol):
    """What runs cells, here or elsewhere."""

    def run(self, todo: list[BenchCell]) -> Iterator[BenchCell]:
        """Run cells and give each as soon as it has ended."""
        ...


@dataclass
class CellRunner:
    """Where cells are handed in: those that are done are kept, all others run."""

    out: Path
    plan: BenchPlan
    runner: Executor
    fresh: bool
    watcher: BenchCallbacks
    _digests: dict[SequenceSpec, str | DynavizError] = field(default_factory=dict)
    _ended: dict[Path, BenchRow] = field(default_factory=dict)

    def rows(self, sets: Iterable[ParameterSet], sources: Iterable[SequenceSpec]) -> list[BenchRow]:
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
                self._end(cell, BenchRow(cell, folder, result, kept=True))
            else:
                todo.append(cell)
        with contextlib.closing(self.runner.run(todo)) as ended:  # type: ignore[type-var]
            for cell in ended:
                self._end(cell)
        return [self._ended[cell.path] for cell in wanted]

    def _end(self, cell: BenchCell, row: BenchRow | None = None) -> None:
        folder = self.out / cell.path
        if row is None:
            result = cells.finished(cell, folder)
            error = None if result else cells.error_of(folder) or "its files vanished. Run the bench again."
            row = BenchRow(cell, folder, result, error)
        self._ended[cell.path] = row
        self.watcher.ended(row)

    def _cell(self, source: SequenceSpec, what: ParameterSet) -> BenchCell:
        source = placed(source, self.out)
        if source not in self._digests:
            self._digests[source] = self._digest(source)
        digest = self._digests[source]
        known = "" if isinstance(digest, DynavizError) else digest
        return BenchCell(source, what, known, self.plan.record, self.plan.timing)

    def _digest(self, source: SequenceSpec) -> str | DynavizError:
        """Read a sequence, once a bench; what keeps it from being read is an answer too."""
        from dynaviz.engine.summary import summarize

        def tell(what: str) -> Callable[[int, int], None]:
            return lambda done, total: self.watcher.preparing(f"{what} {source.name}", done, total)

        try:
            if source.scene:
                simulated(source, tell("simulating"))
            sequence = open_source(source)
            reading, total = tell("reading"), len(sequence)
            return summarize(sequence, lambda done: reading(done, total)).digest
        except DynavizError as error:
            return error
