"""Benchmarks: methods x sequences x parameter sets, one folder per cell, resumed after an interruption."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from dynaviz.benchmarking import search
from dynaviz.benchmarking.leaderboard import Leaderboard
from dynaviz.benchmarking.local import LocalExecutor
from dynaviz.benchmarking.plan import BenchPlan
from dynaviz.benchmarking.plan_file import plan_of, read
from dynaviz.benchmarking.runner import BenchCallbacks, CellRunner, Executor
from dynaviz.benchmarking.source import open_source
from dynaviz.errors import DataError, UsageError


def bench(
    plan: str | os.PathLike[str] | Mapping[str, Any],
    out: str | os.PathLike[str],
    *,
    scheduler: str | None = None,
    fresh: bool = False,
    watcher: BenchCallbacks | None = None,
) -> Leaderboard:
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
    folder, watcher = Path(out), watcher or BenchCallbacks()
    if checked.search:
        search.check(checked)
    with _runner(folder, scheduler, checked, watcher) as runner:
        desk = CellRunner(folder, checked, runner, fresh, watcher)
        learning = [source for source in checked.sources if source.name not in checked.holdout]
        for source in learning:
            if not source.scene:
                open_source(source)  # what is not there is told before any work
        _make(folder)
        rows = desk.rows(checked.sets, learning)
        if not checked.search:
            return Leaderboard(rows)
        tried, found = search.search(desk, checked.search, learning, folder)
        best = [one.best for one in found if one.best.variant and one.best not in checked.sets]
        rows += desk.rows(best, learning)
        shown = {row.folder for row in rows}
        trials = {row.folder: row for row in tried if row.folder not in shown}
        # Only now is anything looked at that was held out.
        held = [source for source in checked.sources if source.name in checked.holdout]
        rows += desk.rows([*checked.sets, *best], held)
        return Leaderboard(rows, checked.holdout, found, [*trials.values()])


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        problem = f"cannot be made ({error.strerror})"
        raise DataError(folder, problem, hint="Choose another folder with -o") from None


@contextlib.contextmanager
def _runner(out: Path, scheduler: str | None, plan: BenchPlan, watcher: BenchCallbacks) -> Iterator[Executor]:
    if not scheduler:
        yield LocalExecutor(out, plan.workers, watcher.running)
        return
    from dynaviz.benchmarking.cluster import DaskExecutor

    with contextlib.closing(DaskExecutor(out, scheduler, watcher.running)) as cluster:
        yield cluster
