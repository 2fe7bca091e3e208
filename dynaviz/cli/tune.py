"""dynaviz tune."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dynaviz.cli.console import program, progress, show
from dynaviz.cli.options import SEQUENCE, takes

if TYPE_CHECKING:
    from dynaviz.benchmarking.runner import BenchCallbacks
    from dynaviz.progress import Progress


@takes(SEQUENCE)
def tune(
    sequence: Annotated[
        str,
        typer.Argument(
            metavar="SEQ", help="Sequence folder or bag, or implant:SEQ?cars=6&persons=10."
        ),
    ],
    method: Annotated[
        str, typer.Option("-m", "--method", metavar="M", help="Method to tune.")
    ] = ...,  # type: ignore[assignment]
    out: Annotated[
        Path, typer.Option("-o", "--out", help="Output folder. An earlier search in it resumes.")
    ] = ...,  # type: ignore[assignment]
    trials: Annotated[int, typer.Option(min=1, metavar="N", help="Parameter sets to try.")] = 30,
    seeds: Annotated[
        int, typer.Option(min=1, metavar="N", help="Sequences with implants for the search.")
    ] = 3,
    holdout: Annotated[
        int,
        typer.Option(
            min=1, metavar="N", help="Sequences with other implants, for the final scores."
        ),
    ] = 2,
    ranges: Annotated[
        list[str] | None,
        typer.Option(
            "--range",
            metavar="PARAM=LOW:HIGH",
            help="Search range; log:LOW:HIGH for a logarithmic scale. Repeatable. "
            "[default: half to twice the default of each parameter]",
        ),
    ] = None,
    workers: Annotated[int, typer.Option(min=1, metavar="N", help="Number of parallel runs.")] = 1,
    *,
    options: dict[str, Any],
) -> None:
    """Find parameters for your sensor and place, without labels.

    Puts movers with exact ground truth into the sequence, searches for the parameters with the best
    AA on them, and scores these on other movers. Labels of the sequence are used only to score the
    result.

    \b
    dynaviz tune path/to/sequence --method dufomap -o tuned
    dynaviz tune SEQ -m octomap -o tuned --range resolution=0.1:0.4 --trials 20
    dynaviz run dufomap path/to/sequence --config tuned/best-dufomap.toml
    """
    from rich.markup import escape

    from dynaviz.benchmarking.tune import tune as run

    chosen = dict(_assignment(text) for text in ranges or [])
    runs = (trials + 1) * seeds + 2 * holdout
    with progress(f"tune {method}", {"search": "runs"}) as report:
        tuned = run(
            sequence,
            method,
            out,
            trials=trials,
            seeds=seeds,
            holdout=holdout,
            ranges=chosen,
            workers=workers,
            callbacks=_callbacks(report, runs),
            progress=report,
            **options,
        )
    show(tuned)
    if not tuned.improved:
        show(
            f"None of {trials} parameter sets is better than the default on the implants of the "
            "search."
        )
    if tuned.gain:
        show(f"Gain of the parameters found: {tuned.gain}.")
    if tuned.improved and not tuned.proven:
        doubts = "; ".join(tuned.gain.doubts) if tuned.gain else "a run on other implants failed"
        show(
            f"Not proven: {doubts}. Keep the default parameters, or search with more --seeds and "
            "--holdout."
        )
        show(escape(f"The parameters found are in {tuned.preset}."))
    else:
        show(
            escape(
                f"Use these parameters with: {program()} run {method} SEQ --config {tuned.preset}"
            )
        )
    if tuned.board.failed:
        show(
            escape(
                f"{len(tuned.board.failed)} runs failed. For the first error see "
                f"{tuned.board.failed[0].folder}."
            )
        )
        raise typer.Exit(1)


def _assignment(text: str) -> tuple[str, str]:
    from dynaviz.errors import UsageError

    name, equals, values = text.partition("=")
    if not equals:
        raise UsageError(
            f"--range {text}: write PARAM=LOW:HIGH, such as --range resolution=0.1:0.4"
        )
    return name.strip(), values.strip()


def _callbacks(report: Progress, runs: int) -> BenchCallbacks:
    """Reports how many runs have ended."""
    from dynaviz.benchmarking.leaderboard import BenchRow
    from dynaviz.benchmarking.runner import BenchCallbacks

    class Ended(BenchCallbacks):
        """Counts the runs; those kept from an earlier search count, too."""

        done = 0

        def ended(self, row: BenchRow) -> None:
            """Report the number of runs."""
            self.done += 1
            report("search", self.done, max(runs, self.done))

    return Ended()
