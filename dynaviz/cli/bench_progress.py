"""Progress of a bench: bars of what is running on a terminal, and a line for each run that has
ended.
"""

from __future__ import annotations

import sys
import time

from dynaviz.benchmarking.leaderboard import BenchRow
from dynaviz.benchmarking.plan import BenchCell
from dynaviz.benchmarking.runner import BenchCallbacks
from dynaviz.cli.console import duration
from dynaviz.progress import Progress


class BenchProgress(BenchCallbacks):
    """Writes to standard error, and estimates the time left from the cells that ran.

    Args:
        report: shows the progress of a phase.
        cells: whether it also shows that of each cell, for which a log has no room.
    """

    def __init__(self, report: Progress, cells: bool):
        self._report = report
        self._cells = cells
        self._planned = self._ended = self._ran = 0
        self._since = time.monotonic()

    def preparing(self, task: str, done: int, total: int) -> None:
        """Show it as a phase."""
        self._report(task, done, total)

    def planned(self, number: int) -> None:
        """Add to the number of all cells."""
        self._planned += number

    def running(self, cell: BenchCell, phase: str, done: int, total: int) -> None:
        """Show it as a phase of its cell."""
        if self._cells:
            self._report(f"{cell.path.name} on {cell.source.name}, {phase}", done, total)

    def ended(self, row: BenchRow) -> None:
        """Print how it ended, and the time left. A cell that is kept from before took no time."""
        if row.kept and not self._ran:
            self._since = time.monotonic()
        self._ended += 1
        self._ran += not row.kept
        place = f"{row.cell.path.name} on {row.cell.source.name}"
        print(
            f"[{self._ended}/{self._planned}{self._left()}] {place}: {outcome(row)}",
            file=sys.stderr,
            flush=True,
        )

    def _left(self) -> str:
        """Time left, such as ``, 5 min left``; empty if unknown or if no cell is left."""
        seconds = time.monotonic() - self._since
        more = self._planned - self._ended
        return f", {duration(seconds / self._ran * more)} left" if self._ran and more > 0 else ""


def outcome(row: BenchRow) -> str:
    """How a cell ended, in a few words."""
    if row.result is None:
        return f"failed: {row.error}"
    aa = row.result.metrics.get("AA")
    score = "no AA" if aa is None else f"AA {aa:.2f}"
    return f"kept, {score}" if row.kept else score
