"""Benchmarks: methods x sequences x parameter sets, one folder per cell, resumed after an
interruption.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from dynaviz.benchmarking import search
from dynaviz.benchmarking.cells import CellTask
from dynaviz.benchmarking.leaderboard import Leaderboard
from dynaviz.benchmarking.plan import BenchPlan
from dynaviz.benchmarking.plan_file import plan_of, read
from dynaviz.benchmarking.runner import BenchCallbacks, CellRunner, Executor
from dynaviz.benchmarking.source import open_spec
from dynaviz.errors import UsageError
from dynaviz.io.lock import locked
from dynaviz.reviews.decisions import Decisions
from dynaviz.tasks.local import LocalExecutor
from dynaviz.tasks.memory import forget_peak


def bench(
    plan: str | os.PathLike[str] | Mapping[str, Any],
    out: str | os.PathLike[str],
    *,
    scheduler: str | None = None,
    fresh: bool = False,
    callbacks: BenchCallbacks | None = None,
) -> Leaderboard:
    """Run methods on sequences, with one or more parameter sets, and optionally search for better
    parameters.

    A cell is one method with one parameter set on one sequence. Finished cells are kept if they are
    complete and have the same data, parameters and versions; all others run. A cell that fails
    becomes a row with its error, and the others continue.

    Args:
        plan: a TOML file, or a mapping with its content (``examples/bench.toml`` explains every
            key).
        out: folder of the bench; the files of a cell are in ``out/SEQUENCE/METHOD[-VARIANT]``.
        scheduler: address of a Dask scheduler whose workers run the cells.
        fresh: run every cell again.
        callbacks: receives the progress.

    Returns:
        The rows; printing them with rich shows a leaderboard.

    Raises:
        UsageError, DataError: for an invalid plan, a sequence that cannot be opened, or a folder
            that another process writes into.
    """
    if isinstance(plan, Mapping):
        table = plan
        place = "bench"
    else:
        table = read(Path(plan))
        place = os.fspath(plan)
    checked = plan_of(table, place)
    if scheduler and checked.timing:
        raise UsageError("timing measures this machine only. Leave out --scheduler")
    if scheduler and "workers" in table:
        raise UsageError(
            "the cluster sets the number of workers. Leave out workers, or --scheduler"
        )
    if checked.review:
        Decisions.existing(checked.review)
    folder = Path(out)
    callbacks = callbacks or BenchCallbacks()
    if checked.search:
        search.check(checked)
    for source in checked.sources:
        if not source.scene and source.name not in checked.holdout:
            open_spec(source)  # fail on a missing sequence before any work starts
    with locked(folder), _executor(folder, scheduler, checked, callbacks) as executor:
        runner = CellRunner(folder, checked, executor, fresh, callbacks)
        learning = [source for source in checked.sources if source.name not in checked.holdout]
        rows = runner.rows(checked.sets, learning)
        if not checked.search:
            return Leaderboard(rows, seeds=checked.seeds)
        tried, searches = search.search(runner, checked.search, learning, folder)
        best = [
            found.best
            for found in searches
            if found.best.variant and found.best not in checked.sets
        ]
        rows += runner.rows(best, learning)
        shown = {row.folder for row in rows}
        trials = {row.folder: row for row in tried if row.folder not in shown}
        # Held-out sequences are not read before this point.
        held = [source for source in checked.sources if source.name in checked.holdout]
        rows += runner.rows([*checked.sets, *best], held)
        return Leaderboard(rows, checked.holdout, searches, [*trials.values()])


@contextlib.contextmanager
def _executor(
    out: Path, scheduler: str | None, plan: BenchPlan, callbacks: BenchCallbacks
) -> Iterator[Executor]:
    def report(task: CellTask, phase: str, done: int, total: int) -> None:
        callbacks.running(task.cell, phase, done, total)

    if not scheduler:
        # A process runs several cells where each can be told its own peak memory.
        yield LocalExecutor(out, plan.workers, report, reuse=forget_peak())
        return
    from dynaviz.tasks.cluster import DaskExecutor

    with contextlib.closing(DaskExecutor(out, scheduler, report)) as cluster:
        yield cluster
