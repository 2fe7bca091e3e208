"""dynaviz report."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import progress, show
from dynaviz.cli.options import refuse


def report(
    results: Annotated[
        list[Path],
        typer.Argument(metavar="DIR...", help="Result files, or folders to search for them."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            help="Output file, or folder of a board. [default: standard output; DIR/board]",
        ),
    ] = None,
    format: Annotated[
        str | None,
        typer.Option(
            help="html, md, latex, csv, an installed plug-in, or board for a leaderboard as a "
            "static site. "
            "[default: by the suffix of -o, otherwise md]"
        ),
    ] = None,
    columns: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,...",
            help="For md and latex: columns to keep in addition to the first, such as SA,DA,AA.",
        ),
    ] = None,
    sequences: Annotated[
        list[str] | None,
        typer.Option(
            "--sequence",
            metavar="SEQ",
            help="For a board: sequence of some of the runs, if it has moved. Repeatable.",
        ),
    ] = None,
) -> None:
    """Write tables and figures of results, or a leaderboard.

    \b
    dynaviz report recordings/demo -o report.html
    dynaviz report bench/ -o table.tex --columns SA,DA,AA
    dynaviz report bench/ elsewhere/result.json --format csv > runs.csv
    dynaviz report recordings/demo --format board

    A board compares methods by sequence and protocol, shows failure cases, and lists the digest of
    every entry. It works offline. Scores are computed from the stored labels, so the sequences are
    needed.
    """
    if format == "board":
        _board(results, out, sequences or [])
        return
    refuse(
        {"sequence": sequences}, f"--format {format}" if format else "a report. Add --format board"
    )
    from dynaviz.reports.reporting import report as write_report

    with progress("report", unit="steps") as show_progress:
        names = [name.strip() for name in (columns or "").split(",") if name.strip()]
        text = write_report(*results, out=out, format=format, columns=names, progress=show_progress)
    if out is None:
        sys.stdout.write(text)
    else:
        print(f"Written to {out}.")


def _board(results: list[Path], out: Path | None, sequences: list[str]) -> None:
    """Write the board of the results in a folder; scores are computed from the stored labels."""
    from dynaviz.errors import UsageError
    from dynaviz.reports.board.write import write_board

    if len(results) > 1:
        raise UsageError("--format board: is for the results in one folder. Give one DIR")
    with progress("board", unit={"score": "runs"}) as report:
        written = write_board(results[0], out or results[0] / "board", sequences, report)
    entries = written.board.entries
    for entry in entries:
        if entry.remark:
            show(f"{entry.path}: not scored: {entry.remark}.")
    known = sum(bool(entry.protocols) for entry in entries) - written.rescored
    taken_over = f", {known} taken over from the earlier board" if known else ""
    runs = "run" if written.rescored == 1 else "runs"
    show(f"{written.rescored} {runs} scored{taken_over}.", f"Written to {written.page}.")
