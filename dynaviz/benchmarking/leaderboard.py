"""What a bench answers: a row a cell, sequences combined by adding counts, and what a search found."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from dynaviz.benchmarking.plan import BenchCell, ParameterSet
from dynaviz.results.collect import combined
from dynaviz.results.result import Result

if TYPE_CHECKING:
    from rich.console import RenderableType


@dataclass(frozen=True)
class BenchRow:
    """A cell that has ended.

    Attributes:
        cell, folder: what it is, and where its files are.
        result: None where it failed.
        error: why it failed, a sentence; else None.
        kept: whether it was done already, by an earlier bench.
    """

    cell: BenchCell
    folder: Path
    result: Result | None = None
    error: str | None = None
    kept: bool = False


@dataclass(frozen=True)
class SearchResult:
    """What a search found for one method.

    Attributes:
        best: the parameters; the defaults where no trial was better.
        preset: the file that holds them.
        aa, default_aa: associated accuracy on the sequences that were not held out, percent, counts added; of the
            defaults None where undefined.
        trials, failed: how many sets were tried, and how many of them gave no AA.
    """

    best: ParameterSet
    preset: Path
    aa: float
    default_aa: float | None
    trials: int
    failed: int


@dataclass(frozen=True)
class Leaderboard:
    """All rows of a bench; shows itself as a leaderboard.

    Attributes:
        rows: one a cell.
        holdout: names of the sequences that were held out.
        found: one for each method that was searched.
        trials: the rows of all sets that were tried and are not the best.
    """

    rows: list[BenchRow]
    holdout: frozenset[str] = frozenset()
    found: list[SearchResult] = field(default_factory=list)
    trials: list[BenchRow] = field(default_factory=list)

    @property
    def results(self) -> list[Result]:
        """Of the cells that are done."""
        return [row.result for row in self.rows if row.result]

    @property
    def failed(self) -> list[BenchRow]:
        """The cells that are not, trials too."""
        return [row for row in [*self.rows, *self.trials] if row.error]

    def totals(self, held_out: bool = False) -> list[Result]:
        """One result for each method and variant all whose cells are done, where there are several sequences."""
        groups: dict[tuple[str, str], list[BenchRow]] = {}
        for row in self.rows:
            if (row.cell.source.name in self.holdout) == held_out:
                groups.setdefault((row.cell.what.method, row.cell.what.variant), []).append(row)
        most = max(map(len, groups.values()), default=0)
        whole = [[row.result for row in rows if row.result] for rows in groups.values()]
        return [combined(results) for results in whole if len(results) == most > 1]

    def __rich__(self) -> RenderableType:
        from rich.console import Group
        from rich.markup import escape
        from rich.table import Table

        from dynaviz.results.result import result_table

        parts: list[RenderableType] = []
        learnt = [row.result for row in self.rows if row.result and row.cell.source.name not in self.holdout]
        held = [row.result for row in self.rows if row.result and row.cell.source.name in self.holdout]
        for results, totals, title in (
            (learnt, self.totals(), None),
            (held, self.totals(held_out=True), "held out from the search"),
        ):
            if results:
                parts.append(result_table(_ranked(results) + _ranked(totals), title=title))
        if self.failed:
            table = Table(
                "sequence", "method", "failed", box=None, pad_edge=False, title="failed", title_justify="left"
            )
            for row in self.failed:
                table.add_row(*map(escape, (row.cell.source.name, row.cell.path.name, row.error or "")))
            parts.append(table)
        return Group(*parts)


def _ranked(results: Sequence[Result]) -> list[Result]:
    """Sequence by sequence as they come, the best AA first, undefined ones last."""
    order = list(dict.fromkeys(result.sequence.name for result in results))

    def rank(result: Result) -> tuple[int, float]:
        aa = result.metrics.get("AA")
        return order.index(result.sequence.name), -math.inf if aa is None else aa

    return sorted(results, key=lambda result: (rank(result)[0], -rank(result)[1]))
