"""How a bench is watched: a live table on a terminal, a line a cell in a log."""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynaviz.benchmarking.leaderboard import BenchRow
from dynaviz.benchmarking.plan import BenchCell
from dynaviz.benchmarking.runner import BenchCallbacks

if TYPE_CHECKING:
    from rich.console import RenderableType

LAST = 12  # cells that ended, shown at a time
QUIET = 5.0  # seconds between two lines of a preparation


def scored(row: BenchRow) -> str:
    """What a cell came to, in a few words."""
    if row.result is None:
        return f"failed: {row.error}"
    aa = row.result.metrics.get("AA")
    return ("done before, " if row.kept else "") + ("no AA" if aa is None else f"AA {aa:.2f}")


class ProgressLines(BenchCallbacks):
    """Writes a line a cell to standard error."""

    def __init__(self, now: float):
        self._planned = self._ended = 0
        self._said = now

    def preparing(self, what: str, done: int, total: int) -> None:
        """Say it at the end, and now and then before."""
        if done == total or time.monotonic() - self._said > QUIET:
            self._said = time.monotonic()
            print(f"{what} {done}/{total}", file=sys.stderr, flush=True)

    def planned(self, number: int) -> None:
        """Add to the number of all cells."""
        self._planned += number

    def ended(self, row: BenchRow) -> None:
        """Say what it came to."""
        self._ended += 1
        count = f"[{self._ended}/{self._planned}]"
        print(f"{count} {row.cell.source.name} {row.cell.path.name}: {scored(row)}", file=sys.stderr, flush=True)


class ProgressBars(BenchCallbacks):
    """A table of the cells that run and of those that ended last, on standard error."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.live import Live as Screen

        self._lock = threading.Lock()
        self._preparing = ""
        self._planned = self._kept = self._failed = self._done = 0
        self._running: dict[Path, str] = {}
        self._last: list[BenchRow] = []
        self._screen = Screen(console=Console(stderr=True), get_renderable=self._table, transient=True)

    def __enter__(self) -> ProgressBars:
        self._screen.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._screen.__exit__(*error)

    def preparing(self, what: str, done: int, total: int) -> None:
        """Show it above the table."""
        self._preparing = f"{what} {done}/{total}" if done < total else ""

    def planned(self, number: int) -> None:
        """Add to the number of all cells."""
        self._planned += number

    def running(self, cell: BenchCell, phase: str, done: int, total: int) -> None:
        """Show how far it is."""
        with self._lock:
            self._running[cell.path] = f"{phase} {done}/{total}"

    def ended(self, row: BenchRow) -> None:
        """Move it to those that ended."""
        with self._lock:
            self._running.pop(row.cell.path, None)
            self._last = [*self._last, row][-LAST:]
            self._kept += row.kept
            self._failed += row.error is not None
            self._done += row.result is not None

    def _table(self) -> RenderableType:
        from rich.markup import escape
        from rich.table import Table

        title = escape(self._title())
        table = Table("sequence", "method", "state", box=None, pad_edge=False, title=title, title_justify="left")
        with self._lock:
            for row in self._last:
                style = "red" if row.error else "dim" if row.kept else ""
                table.add_row(*map(escape, (row.cell.source.name, row.cell.path.name, scored(row))), style=style)
            for path, state in self._running.items():
                table.add_row(*map(escape, (path.parent.name, path.name, state)), style="bold")
        return table

    def _title(self) -> str:
        counts = f"{self._done} of {self._planned} cells done"
        kept, failed = f"{self._kept} of them before", f"{self._failed} failed"
        told = [counts, *([kept] if self._kept else []), *([failed] if self._failed else []), self._preparing]
        return ", ".join(text for text in told if text)
