"""dynaviz board."""

from __future__ import annotations

import shlex
from collections.abc import Sequence as Several
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynaviz.cli.console import program, progress, show

if TYPE_CHECKING:
    from rich.table import Table

    from dynaviz.reports.board.check import CheckedEntry
    from dynaviz.runs.sequences import SequenceFinder


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("board")(board)


def board(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder with the results of runs.")],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="SITE", help="Folder of the board. [default: FOLDER/board]")
    ] = None,
    sequences: Annotated[
        list[str] | None,
        typer.Option(
            "--sequence",
            metavar="SEQ",
            help="Sequence of some of the runs, if it is not found by their commands or names. Repeatable.",
        ),
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Write nothing; recompute every entry and compare digests and scores.")
    ] = False,
    rerun: Annotated[
        bool, typer.Option("--rerun", help="With --check: also run each method again and compare its labels.")
    ] = False,
) -> None:
    """Write a leaderboard as a static site, or recompute its entries.

    The page compares methods by sequence and protocol, shows failure cases, and lists the digest of every entry. It
    works offline. Scores are computed from the stored labels, so the sequences are needed.

    With --check the exit code is 1 if an entry differs or cannot be recomputed.

    \b
    dynaviz board recordings/demo
    dynaviz board recordings/demo --check
    dynaviz board recordings/demo/octomap -o recordings/demo/board --check --rerun
    dynaviz board results -o site --sequence semantickitti:kitti/sequences/08
    """
    from dynaviz.errors import UsageError
    from dynaviz.runs.sequences import SequenceFinder

    if rerun and not check:
        raise UsageError("--rerun: only with --check")
    site = out or folder / "board"
    finder = SequenceFinder(sequences or ())
    if check:
        _check(folder, site, finder, rerun)
    else:
        _write(folder, site, finder)


def _write(folder: Path, site: Path, finder: SequenceFinder) -> None:
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
    show(f"Recompute the entries with: {program()} board {shlex.quote(str(folder))} --check")


def _check(folder: Path, site: Path, finder: SequenceFinder, rerun: bool) -> None:
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
