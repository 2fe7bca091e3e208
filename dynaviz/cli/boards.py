"""A leaderboard as a static site: written, or checked by recomputing its entries."""

from __future__ import annotations

import shlex
from collections.abc import Sequence as Several
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from dynaviz.cli.console import program, progress, show

if TYPE_CHECKING:
    from rich.table import Table

    from dynaviz.reports.board.check import CheckedEntry
    from dynaviz.runs.sequences import SequenceFinder


def write(folder: Path, site: Path, finder: SequenceFinder) -> None:
    """Write the board of the results in a folder; scores are computed from the stored labels."""
    from dynaviz.reports.board.write import write_board

    with progress("board", unit={"score": "runs"}) as report:
        written = write_board(folder, site, finder, report)
    entries = written.board.entries
    for entry in entries:
        if entry.remark:
            show(f"{entry.path}: not scored: {entry.remark}.")
    known = sum(bool(entry.protocols) for entry in entries) - written.rescored
    taken_over = f", {known} taken over from the earlier board" if known else ""
    show(f"{_counted(written.rescored, 'run', 'runs')} scored{taken_over}.", f"Written to {written.page}.")
    show(f"Recompute the entries with: {program()} report {shlex.quote(str(folder))} --format board --check")


def check(folder: Path, site: Path, finder: SequenceFinder, rerun: bool) -> None:
    """Recompute all entries of a board. Ends with exit code 1 if one differs or cannot be recomputed."""
    from dynaviz.reports.board.check import check_board

    with progress("check", unit="runs") as report:
        checked = check_board(folder, site, finder, rerun, report)
    failed = [entry for entry in checked if not entry.passed]
    show(_table(checked), *(f"{entry.run.folder}: {entry.problem}." for entry in failed))
    if failed:
        show(f"{len(failed)} of {_counted(len(checked), 'entry', 'entries')}: different, or not recomputed.")
        raise typer.Exit(1)
    show(f"{_counted(len(checked), 'entry', 'entries')} recomputed: all digests and scores are the same.")


def _counted(number: int, one: str, several: str) -> str:
    return f"{number} {one if number == 1 else several}"


def _table(checked: Several[CheckedEntry]) -> Table:
    """One row per entry, one column per part."""
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    from dynaviz.reports.board.check import DIFFERENT, PARTS

    table = Table("run", "sequence", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    for part in PARTS:
        table.add_column("points" if part == "sequence" else part)
    for entry in checked:
        verdicts = (entry.verdicts[part] for part in PARTS)
        marked = (f"[bold red]{verdict}[/]" if verdict == DIFFERENT else verdict for verdict in verdicts)
        table.add_row(escape(entry.run.label), escape(entry.run.sequence), *marked)
    return table
