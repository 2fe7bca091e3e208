"""dynaviz bench."""

from __future__ import annotations

import contextlib
import itertools
import sys
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dynaviz.cli.console import is_quiet, program, progress, show
from dynaviz.cli.options import DEFAULTS, SEQUENCE, Quiet, Review, takes
from dynaviz.contracts.options import Record

if TYPE_CHECKING:
    from dynaviz.benchmarking.leaderboard import Leaderboard
    from dynaviz.benchmarking.runner import BenchCallbacks


class SearchKind(StrEnum):
    """Samplers of a search."""

    random = "random"
    bayes = "bayes"


@takes(SEQUENCE)
def bench(
    file: Annotated[
        Path | None,
        typer.Argument(metavar="BENCH.toml", help="Plan of the bench, a TOML file."),
    ] = None,
    methods: Annotated[
        list[str] | None,
        typer.Option(
            "-m", "--method", metavar="M", help="Method to run. Repeatable. [default: all]"
        ),
    ] = None,
    sequences: Annotated[
        list[str] | None,
        typer.Option(
            "-s",
            "--sequence",
            metavar="SEQ",
            help="[NAME=]sequence folder, bag or simulate:SCENE[:FRAMES[:SEED]]. Repeatable.",
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option("-o", "--out", help="Output folder; each run has its own subfolder.")
    ] = ...,  # type: ignore[assignment]
    workers: Annotated[
        int | None,
        typer.Option(
            min=1, metavar="N", help="Number of parallel runs, which share the cores. [default: 1]"
        ),
    ] = None,
    timing: Annotated[
        bool,
        typer.Option(
            "--timing",
            help="Measure comparable runtimes: one run at a time, all cores, no recording.",
        ),
    ] = False,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Run on a Dask cluster, such as tcp://HOST:8786."),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume/--fresh", help="Keep finished runs, or run all again.")
    ] = True,
    record: Annotated[
        Record | None,
        typer.Option(help="How much to record in each run.rrd. [default: errors]"),
    ] = None,
    grid: Annotated[
        list[str] | None,
        typer.Option(
            metavar="METHOD.PARAM=V1,V2", help="Run with each value. Repeat for all combinations."
        ),
    ] = None,
    search: Annotated[
        SearchKind | None, typer.Option(help="Search for the parameters with the best AA.")
    ] = None,
    trials: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Number of trials per method.")
    ] = None,
    ranges: Annotated[
        list[str] | None,
        typer.Option(
            "--range",
            metavar="METHOD.PARAM=LOW:HIGH",
            help="Search range; log:LOW:HIGH for a logarithmic scale. Repeatable.",
        ),
    ] = None,
    holdout: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SEQ",
            help="Sequence to exclude from the search and run at the end. Repeatable.",
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            min=0,
            metavar="N",
            help="Random seed of methods, of simulated scenes, and of the search. [default: 0]",
        ),
    ] = None,
    seeds: Annotated[
        str | None,
        typer.Option(
            metavar="N,N,...",
            help="Run methods and simulated scenes with each of these seeds; shows mean and "
            "deviation.",
        ),
    ] = None,
    review: Review = None,
    quiet: Quiet = False,
    *,
    options: dict[str, Any],
) -> None:
    """Run methods on sequences and show a leaderboard.

    An interrupted bench resumes: finished runs are kept. Options override the keys of BENCH.toml.

    \b
    dynaviz bench -s path/to/sequence -s simulate:demo:20 -o bench
    dynaviz bench bench.toml -o bench --workers 4
    dynaviz bench -s simulate:street_hdl64:40 --seeds 0,1,2 -o bench
    dynaviz bench -m octomap -s SEQ --grid octomap.resolution=0.05,0.1,0.2 -o bench
    dynaviz bench -m octomap -s A -s B --holdout B --search bayes --trials 30 \\
            --range octomap.resolution=log:0.05:0.4 -o bench
    """
    from rich.markup import escape

    from dynaviz.benchmarking.bench import bench as run
    from dynaviz.benchmarking.plan_file import read

    table = read(file) if file else {}
    table = {
        key: value for key, value in table.items() if key not in _overridden(timing, scheduler)
    }
    opening = {name: value for name, value in options.items() if value != DEFAULTS[name]}
    table |= _given(
        methods=methods,
        sequences=sequences,
        opening=opening,
        workers=workers,
        timing=timing,
        record=record,
        holdout=holdout,
        seeds=_seeds(seed, seeds),
        review=review and str(review),
    )
    table |= _grid_and_search(table, grid, search, trials, ranges, seed)
    try:
        with _callbacks() as callbacks:
            board = run(table, out, scheduler=scheduler, fresh=not resume, callbacks=callbacks)
    except KeyboardInterrupt as error:
        again = "without --fresh " if not resume else ""
        error.add_note(
            f"Finished runs are kept in {out}. The same command {again}continues with the others"
        )
        raise
    show(board, *map(escape, _summary(board, out)))
    if board.failed:
        raise typer.Exit(1)


def _seeds(seed: int | None, seeds: str | None) -> list[int] | None:
    """The seeds of methods and scenes.

    Raises:
        UsageError: if both are given, or the seeds are not numbers.
    """
    from dynaviz.errors import UsageError

    if seeds is None:
        return None if seed is None else [seed]
    if seed is not None:
        raise UsageError("--seed and --seeds exclude each other. Give one of them")
    try:
        return [int(each) for each in seeds.split(",")]
    except ValueError:
        problem = f"--seeds {seeds}: are not whole numbers"
        raise UsageError(f"{problem}. Give them with commas, such as --seeds 0,1,2") from None


def _overridden(timing: bool, scheduler: str | None) -> tuple[str, ...]:
    """Keys of the file that contradict an option."""
    if timing:
        return "workers", "record"
    return ("workers",) if scheduler else ()


def _given(**flags: Any) -> dict[str, Any]:
    """The options that were given, including a 0."""
    return {
        key: value for key, value in flags.items() if value or (value == 0 and value is not False)
    }


def _grid_and_search(
    table: dict[str, Any],
    grid: list[str] | None,
    search: SearchKind | None,
    trials: int | None,
    ranges: list[str] | None,
    seed: int | None,
) -> dict[str, Any]:
    """The tables ``grid`` and ``search``, from the options and the file."""
    from dynaviz.benchmarking.plan_file import assignment, values_of

    given: dict[str, Any] = {}
    for text in grid or []:
        method, name, values = assignment(text, "--grid")
        given.setdefault("grid", {}).setdefault(method, {})[name] = values_of(values)
    options = _given(kind=search and search.value, trials=trials)
    if seed is not None and (options or ranges or table.get("search")):
        options["seed"] = seed
    for text in ranges or []:
        method, name, values = assignment(text, "--range")
        options.setdefault("ranges", {}).setdefault(method, {})[name] = values.strip()
    if options:
        given["search"] = {**table.get("search", {}), **options}
    return given


def _summary(board: Leaderboard, out: Path) -> Iterator[str]:
    """The best parameters that were found, the number of runs, and where their files are."""
    for found in board.searches:
        default = "n/a" if found.default_aa is None else f"{found.default_aa:.2f}"
        trials = f"{found.trials} trials" + (f" ({found.failed} failed)" if found.failed else "")
        if found.best.variant:
            yield (
                f"{found.best.method}: best AA {found.aa:.2f} of {trials}; the default parameters "
                f"have AA {default}."
            )
        else:
            yield (
                f"{found.best.method}: none of {trials} is better than the default parameters, AA "
                f"{default}."
            )
        yield (
            f"Use these parameters with: dynaviz run {found.best.method} SEQ --config "
            f"{found.preset}"
        )
    every = [*board.rows, *board.trials]
    kept = sum(row.kept for row in every)
    failed = len(board.failed)
    finished = len(every) - failed
    done = f"{finished} run{'s' * (finished != 1)} finished" + (
        f" ({kept} from before)" if kept else ""
    )
    for reason, rows in itertools.groupby(sorted(row.outdated for row in every if row.outdated)):
        number = len(list(rows))
        yield f"{number} run{'s' * (number != 1)} repeated: {reason}."
    yield f"{done}, {failed} failed. The files of each run are in {out}/SEQUENCE/METHOD."
    yield f"Click the failures of a run, and see why: {program()} explore {out}/SEQUENCE/METHOD"
    if board.failed:
        log = board.failed[0].folder / "error.log"
        # a cell that never ran has no log
        file = log if log.is_file() else log.with_name("error.json")
        yield f"For the first error see {file}. The same command repeats only the unfinished runs."


@contextlib.contextmanager
def _callbacks() -> Iterator[BenchCallbacks]:
    """Progress on standard error; none with ``--quiet``."""
    from dynaviz.benchmarking.runner import BenchCallbacks
    from dynaviz.cli.bench_progress import BenchProgress

    with progress("bench", keep=False) as report:
        yield BenchCallbacks() if is_quiet() else BenchProgress(report, cells=sys.stderr.isatty())
