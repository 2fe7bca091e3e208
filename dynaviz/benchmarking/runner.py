"""Runs the unfinished cells of a bench and keeps the finished ones."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from dynaviz.benchmarking.cells import CellTask, earlier_result, result_of
from dynaviz.benchmarking.leaderboard import BenchRow
from dynaviz.benchmarking.plan import BenchCell, BenchPlan, ParameterSet, SequenceSpec
from dynaviz.benchmarking.source import open_spec, placed, simulated
from dynaviz.errors import DynavizError
from dynaviz.tasks.task import clear, error_of, fail


class BenchCallbacks:
    """Callbacks for the progress of a bench, called from several threads.

    Override those you need.
    """

    def preparing(self, task: str, done: int, total: int) -> None:
        """A sequence is being simulated or read; counts are in frames."""

    def planned(self, number: int) -> None:
        """A number of further cells was added to the bench."""

    def running(self, cell: BenchCell, phase: str, done: int, total: int) -> None:
        """A cell is running; counts are in frames of a phase."""

    def ended(self, row: BenchRow) -> None:
        """A cell has ended, or its earlier result is kept."""


class Executor(Protocol):
    """Runs cells, on this machine or elsewhere."""

    def run(self, todo: list[CellTask]) -> Iterator[CellTask]:
        """Run cells and yield each when it has ended."""
        ...


@dataclass
class CellRunner:
    """Runs the cells of a plan; finished cells are kept."""

    out: Path
    plan: BenchPlan
    executor: Executor
    fresh: bool
    callbacks: BenchCallbacks
    _digests: dict[SequenceSpec, str | DynavizError] = field(default_factory=dict)
    _ended: dict[Path, BenchRow] = field(default_factory=dict)
    _outdated: dict[Path, str] = field(default_factory=dict)

    def rows(self, sets: Iterable[ParameterSet], sources: Iterable[SequenceSpec]) -> list[BenchRow]:
        """Run every set on every sequence.

        Return the rows sequence by sequence, in the given order.
        """
        sets = list(sets)
        wanted = [
            self._cell(source, parameter_set)
            for source in sources
            for parameter_set in sets
            if self.plan.pairs(source, parameter_set)
        ]
        new = {cell.path: cell for cell in wanted if cell.path not in self._ended}
        self.callbacks.planned(len(new))
        todo = []
        for cell in new.values():
            folder = self.out / cell.path
            problem = self._digests[cell.source]
            if isinstance(problem, DynavizError):
                clear(CellTask(cell), folder)
                fail(CellTask(cell), folder, str(problem))
                self._end(cell)
                continue
            result, outdated = (None, "") if self.fresh else earlier_result(cell, folder)
            if result is not None and not outdated:
                self._end(cell, BenchRow(cell, folder, result, kept=True))
            else:
                self._outdated[cell.path] = outdated
                todo.append(CellTask(cell))
        with contextlib.closing(self.executor.run(todo)) as ended:  # type: ignore[type-var]
            for task in ended:
                self._end(task.cell)
        return [self._ended[cell.path] for cell in wanted]

    def _end(self, cell: BenchCell, row: BenchRow | None = None) -> None:
        folder = self.out / cell.path
        if row is None:
            result = result_of(cell, folder)
            error = (
                None
                if result
                else error_of(folder) or "its files disappeared. Run the bench again."
            )
            row = BenchRow(cell, folder, result, error, outdated=self._outdated.get(cell.path, ""))
        self._ended[cell.path] = row
        self.callbacks.ended(row)

    def _cell(self, source: SequenceSpec, parameter_set: ParameterSet) -> BenchCell:
        source = placed(source, self.out)
        if source not in self._digests:
            self._digests[source] = self._digest(source)
        digest = self._digests[source]
        known = "" if isinstance(digest, DynavizError) else digest
        plan = self.plan
        return BenchCell(source, parameter_set, known, plan.record, plan.timing, plan.review)

    def _digest(self, source: SequenceSpec) -> str | DynavizError:
        """The digest of a sequence, or the error if it cannot be read. Called once per sequence."""
        from dynaviz.sources.summary import summarize

        def report(task: str) -> Callable[[int, int], None]:
            return lambda done, total: self.callbacks.preparing(
                f"{task} {source.name}", done, total
            )

        try:
            if source.scene:
                simulated(source, report("simulate"))
            sequence = open_spec(source)
            report_read = report("read")
            total = len(sequence)
            return summarize(sequence, lambda done: report_read(done, total)).digest
        except DynavizError as error:
            return error
