"""dynaviz bench."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dynaviz.cli.console import show
from dynaviz.cli.run import RecordModeOption

if TYPE_CHECKING:
    from dynaviz.benchmarking.leaderboard import Leaderboard
    from dynaviz.benchmarking.runner import BenchCallbacks


class SearchKind(StrEnum):
    """How a search chooses its trials."""

    random = "random"
    bayes = "bayes"


def add_to(app: typer.Typer) -> None:
    """Register the verb."""
    app.command("bench")(bench)


def bench(
    file: Annotated[
        Path | None, typer.Argument(metavar="BENCH.toml", help="What to run; examples/bench.toml explains every key.")
    ] = None,
    methods: Annotated[
        list[str] | None, typer.Option("-m", "--method", metavar="M", help="A method. [default: all]")
    ] = None,
    sequences: Annotated[
        list[str] | None,
        typer.Option("-s", "--sequence", metavar="SEQ", help="A folder, or simulate:SCENE[:FRAMES[:SEED]]."),
    ] = None,
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder of the bench.")] = ...,  # type: ignore[assignment]
    workers: Annotated[
        int | None, typer.Option(min=1, help="Cells at a time; they share the cores. [default: 1]")
    ] = None,
    timing: Annotated[
        bool, typer.Option("--timing", help="For comparable runtimes: one at a time, all cores, unrecorded.")
    ] = False,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Run the cells on a Dask cluster, as tcp://HOST:8786.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume/--fresh", help="Keep the cells that are done, or run all again.")
    ] = True,
    record: Annotated[
        RecordModeOption | None, typer.Option(help="How much each run.rrd holds. [default: errors]")
    ] = None,
    grid: Annotated[
        list[str] | None, typer.Option(metavar="METHOD.PARAM=V1,V2", help="Run every value; several: the product.")
    ] = None,
    search: Annotated[SearchKind | None, typer.Option(help="Search parameters for the best AA.")] = None,
    trials: Annotated[int | None, typer.Option(min=1, help="How many sets a search tries, of each method.")] = None,
    ranges: Annotated[
        list[str] | None, typer.Option("--range", metavar="METHOD.PARAM=LOW:HIGH", help="Searched; log:LOW:HIGH too.")
    ] = None,
    holdout: Annotated[
        list[str] | None, typer.Option(metavar="SEQ", help="A sequence that a search sees only at the end.")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="For the choice of trials. [default: 0]")] = None,
) -> None:
    """Run methods on sequences with sets of parameters: one folder a cell, a leaderboard, and no cell run twice.

    A bench that was interrupted goes on where it was left. Flags take the place of the file's keys.

    \b
    dynaviz bench -s path/to/sequence -s simulate:demo:20 -o bench
    dynaviz bench bench.toml -o bench --workers 4
    dynaviz bench -m octomap -s SEQ --grid octomap.resolution=0.05,0.1,0.2 -o bench
    dynaviz bench -m octomap -s A -s B --holdout B --search bayes --trials 30 \\
            --range octomap.resolution=log:0.05:0.4 -o bench
    """
    from rich.markup import escape

    from dynaviz.benchmarking.bench import bench as run
    from dynaviz.benchmarking.plan_file import read

    table = read(file) if file else {}
    apart = ("workers", "record") if timing else ("workers",) if scheduler else ()
    table = {key: value for key, value in table.items() if key not in apart}
    table |= _given(
        methods=methods,
        sequences=sequences,
        workers=workers,
        timing=timing,
        record=record and record.value,
        holdout=holdout,
    )
    table |= _assigned(table, grid, search, trials, ranges, seed)
    with _watched() as watcher:
        board = run(table, out, scheduler=scheduler, fresh=not resume, watcher=watcher)
    show(board, *map(escape, _words(board, out)))
    if board.failed:
        raise typer.Exit(1)


def _given(**flags: Any) -> dict[str, Any]:
    """The flags that were typed, be it a 0."""
    return {key: value for key, value in flags.items() if value or (value == 0 and value is not False)}


def _assigned(
    table: dict[str, Any],
    grid: list[str] | None,
    search: SearchKind | None,
    trials: int | None,
    ranges: list[str] | None,
    seed: int | None,
) -> dict[str, Any]:
    """Grid and search, as the tables of the file."""
    from dynaviz.benchmarking.plan_file import assignment, values_of

    given: dict[str, Any] = {}
    for text in grid or []:
        method, name, values = assignment(text, "--grid")
        given.setdefault("grid", {}).setdefault(method, {})[name] = values_of(values)
    wish = _given(kind=search and search.value, trials=trials, seed=seed)
    for text in ranges or []:
        method, name, values = assignment(text, "--range")
        wish.setdefault("ranges", {}).setdefault(method, {})[name] = values.strip()
    if wish:
        given["search"] = {**table.get("search", {}), **wish}
    return given


def _words(board: Leaderboard, out: Path) -> Iterator[str]:
    """What was found, and where everything is."""
    for found in board.found:
        default = "n/a" if found.default_aa is None else f"{found.default_aa:.2f}"
        trials = f"{found.trials} trials" + (f" ({found.failed} failed)" if found.failed else "")
        if found.best.variant:
            yield f"{found.best.method}: AA {found.aa:.2f} is the best of {trials}; {default} by default."
        else:
            yield f"{found.best.method}: none of {trials} is better than the defaults, AA {default}."
        yield f"Use it with: dynaviz run {found.best.method} SEQ --config {found.preset}"
    every = [*board.rows, *board.trials]
    kept, failed = sum(row.kept for row in every), len(board.failed)
    done = f"{len(every) - failed} cells done" + (f", {kept} of them before" if kept else "")
    yield f"{done}, {failed} failed. Each has its folder: {out}/SEQUENCE/METHOD."
    if board.failed:
        log = board.failed[0].folder / "error.log"
        told = log if log.is_file() else log.with_name("error.json")  # a cell that never ran has no log
        yield f"What went wrong: {told}. The same command runs only what is not done."


@contextlib.contextmanager
def _watched() -> Iterator[BenchCallbacks]:
    """A live table on a terminal, lines in a log."""
    from dynaviz.cli.bench_progress import ProgressBars, ProgressLines

    if not sys.stderr.isatty():
        yield ProgressLines(time.monotonic())
        return
    with ProgressBars() as live:
        yield live
