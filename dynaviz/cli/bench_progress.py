"""Progress of a bench: a live table on a terminal, one line per run in a log."""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynaviz.benchmarking.leaderboard import BenchRow
from dynaviz.benchmarking.plan import BenchCell
from dynaviz.benchmarking.runner import BenchCallbacks
from dynaviz.cli.console import LOG_INTERVAL, PhaseTimer, duration

if TYPE_CHECKING:
    from rich.console import RenderableType

RECENT = 12  # ended cells that the table shows


def outcome(row: BenchRow) -> str:
    """How a cell ended, in a few words."""
    if row.result is None:
        return f"failed: {row.error}"
    aa = row.result.metrics.get("AA")
    score = "no AA" if aa is None else f"AA {aa:.2f}"
    return f"kept, {score}" if row.kept else score


def row_style(row: BenchRow) -> str:
    """Style of an ended cell in the table."""
    if row.error:
        return "red"
    return "dim" if row.kept else ""


class CellCounter:
    """Counts the cells of a bench, and estimates the time left from those that ran."""

    def __init__(self) -> None:
        self.planned = self.ended = self._ran = 0
        self._since = time.monotonic()

    def end(self, row: BenchRow) -> None:
        """Count an ended cell; one that is kept from before took no time."""
        if row.kept and not self._ran:
            self._since = time.monotonic()
        self.ended += 1
        self._ran += not row.kept

    def left(self) -> str:
        """Time left, such as ``, 5 min left``; empty if unknown or if no cell is left."""
        seconds, more = time.monotonic() - self._since, self.planned - self.ended
        return f", {duration(seconds / self._ran * more)} left" if self._ran and more > 0 else ""


class Preparation:
    """Texts on the preparation of sequences, with the speed and the time left."""

    def __init__(self) -> None:
        self._timers: dict[str, PhaseTimer] = {}

    def line(self, task: str, done: int, total: int) -> str:
        """Such as ``survey street 40/100 frames, 12.3 frames/s, 5 s left``."""
        return self._timers.setdefault(task, PhaseTimer("frames", done)).line(task, done, total)


class ProgressLines(BenchCallbacks):
    """Writes one line per cell to standard error."""

    def __init__(self, now: float):
        self._cells, self._preparation = CellCounter(), Preparation()
        self._printed = now

    def preparing(self, task: str, done: int, total: int) -> None:
        """Print it at the end, and every few seconds before."""
        line = self._preparation.line(task, done, total)
        if done == total or time.monotonic() - self._printed > LOG_INTERVAL:
            self._printed = time.monotonic()
            print(line, file=sys.stderr, flush=True)

    def planned(self, number: int) -> None:
        """Add to the number of all cells."""
        self._cells.planned += number

    def ended(self, row: BenchRow) -> None:
        """Print how it ended, and the time left."""
        self._cells.end(row)
        count = f"[{self._cells.ended}/{self._cells.planned}{self._cells.left()}]"
        print(f"{count} {row.cell.path.name} on {row.cell.source.name}: {outcome(row)}", file=sys.stderr, flush=True)


class ProgressBars(BenchCallbacks):
    """A table of the running and the recently ended cells, on standard error."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.live import Live

        self._lock = threading.Lock()
        self._preparing, self._preparation, self._cells = "", Preparation(), CellCounter()
        self._kept = self._failed = self._done = 0
        self._timers: dict[tuple[Path, str], PhaseTimer] = {}
        self._running: dict[Path, str] = {}
        self._recent: list[BenchRow] = []
        self._live = Live(console=Console(stderr=True), get_renderable=self._table, transient=True)

    def __enter__(self) -> ProgressBars:
        self._live.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._live.__exit__(*error)

    def preparing(self, task: str, done: int, total: int) -> None:
        """Show it above the table."""
        line = self._preparation.line(task, done, total)
        self._preparing = line if done < total else ""

    def planned(self, number: int) -> None:
        """Add to the number of all cells."""
        self._cells.planned += number

    def running(self, cell: BenchCell, phase: str, done: int, total: int) -> None:
        """Show the progress of the cell, with its speed and the time left in this phase."""
        with self._lock:
            timer = self._timers.setdefault((cell.path, phase), PhaseTimer("frames", done))
            self._running[cell.path] = timer.line(phase, done, total)

    def ended(self, row: BenchRow) -> None:
        """Move the cell to the ended ones."""
        with self._lock:
            self._running.pop(row.cell.path, None)
            self._cells.end(row)
            self._recent = [*self._recent, row][-RECENT:]
            self._kept += row.kept
            self._failed += row.error is not None
            self._done += row.result is not None

    def _table(self) -> RenderableType:
        from rich.markup import escape
        from rich.table import Table

        title = escape(self._title())
        table = Table("sequence", "method", "state", box=None, pad_edge=False, title=title, title_justify="left")
        with self._lock:
            for row in self._recent:
                texts = row.cell.source.name, row.cell.path.name, outcome(row)
                table.add_row(*map(escape, texts), style=row_style(row))
            for path, state in self._running.items():
                table.add_row(*map(escape, (path.parent.name, path.name, state)), style="bold")
        return table

    def _title(self) -> str:
        """How many runs have ended, the time left, and what is being prepared."""
        parts = [f"{self._done} of {self._cells.planned} runs finished{self._cells.left()}"]
        if self._kept:
            parts.append(f"{self._kept} from before")
        if self._failed:
            parts.append(f"{self._failed} failed")
        if self._preparing:
            parts.append(self._preparing)
        return ", ".join(parts)
