"""dynaviz report."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli import boards
from dynaviz.cli.console import progress
from dynaviz.cli.options import refuse


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("report")(report)


def report(
    results: Annotated[
        list[Path],
        typer.Argument(metavar="DIR...", help="Result files, or folders to search for them."),
    ],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="Output file, or folder of a board. [default: standard output; DIR/board]"),
    ] = None,
    format: Annotated[
        str | None,
        typer.Option(
            help="html, md, latex, csv, an installed plug-in, or board for a leaderboard as a static site. "
            "[default: by the suffix of -o, otherwise md]"
        ),
    ] = None,
    sequences: Annotated[
        list[str] | None,
        typer.Option(
            "--sequence",
            metavar="SEQ",
            help="For a board: sequence of some of the runs, if it is not found by their commands or names. "
            "Repeatable.",
        ),
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Write no board; recompute every entry and compare digests and scores.")
    ] = False,
    rerun: Annotated[
        bool, typer.Option("--rerun", help="With --check: also run each method again and compare its labels.")
    ] = False,
) -> None:
    """Write tables and figures of one or more results, or a leaderboard.

    \b
    dynaviz report recordings/demo -o report.html
    dynaviz report bench/ -o tables.tex
    dynaviz report bench/ elsewhere/result.json --format csv > runs.csv
    dynaviz report recordings/demo --format board
    dynaviz report recordings/demo --format board --check --rerun

    A board compares methods by sequence and protocol, shows failure cases, and lists the digest of every entry. It
    works offline. Scores are computed from the stored labels, so the sequences are needed. With --check the exit code
    is 1 if an entry differs or cannot be recomputed.
    """
    if format == "board":
        _board(results, out, sequences or [], check, rerun)
        return
    refuse(
        {"sequence": sequences, "check": check, "rerun": rerun},
        f"--format {format}" if format else "a report. Add --format board",
    )
    from dynaviz.reports.reporting import report as write_report

    with progress("report", unit="steps") as show_progress:
        text = write_report(*results, out=out, format=format, progress=show_progress)
    if out is None:
        sys.stdout.write(text)
    else:
        print(f"Written to {out}.")


def _board(results: list[Path], out: Path | None, sequences: list[str], check: bool, rerun: bool) -> None:
    from dynaviz.errors import UsageError
    from dynaviz.runs.sequences import SequenceFinder

    if rerun and not check:
        raise UsageError("--rerun: only with --check")
    if len(results) > 1:
        raise UsageError("--format board: is for the results in one folder. Give one DIR")
    site, finder = out or results[0] / "board", SequenceFinder(sequences)
    if check:
        boards.check(results[0], site, finder, rerun)
    else:
        boards.write(results[0], site, finder)
