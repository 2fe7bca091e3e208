"""dynaviz report."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import progress


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("report")(report)


def report(
    results: Annotated[
        list[Path],
        typer.Argument(metavar="DIR...", help="Result files, or folders to search for them."),
    ],
    out: Annotated[Path | None, typer.Option("-o", "--out", help="Output file. [default: standard output]")] = None,
    format: Annotated[
        str | None,
        typer.Option(help="html, md, latex, csv or an installed plug-in. [default: by the suffix of -o, else md]"),
    ] = None,
) -> None:
    """Write tables and figures of one or more results.

    \b
    dynaviz report recordings/demo -o report.html
    dynaviz report bench/ -o tables.tex
    dynaviz report bench/ elsewhere/result.json --format csv > runs.csv
    """
    from dynaviz.reports.reporting import report as write_report

    with progress("report", unit="steps") as show_progress:
        text = write_report(*results, out=out, format=format, progress=show_progress)
    if out is None:
        sys.stdout.write(text)
    else:
        print(f"Written to {out}.")
