"""The results of a bench.

One row per cell, totals over sequences by adding counts, and the results of a search.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynaviz.benchmarking.plan import BenchCell, ParameterSet, without_seed
from dynaviz.rendered import html_of, text_of
from dynaviz.scores.collect import combined
from dynaviz.scores.data_frames import data_frame
from dynaviz.scores.result import Result

if TYPE_CHECKING:
    import pandas
    from rich.console import RenderableType

_WIDTH = 160  # of a printed leaderboard, in characters
SHOWN = ("SA", "DA", "AA")
"""The scores of which the spread over seeds is stated."""


@dataclass(frozen=True)
class BenchRow:
    """A cell that has ended.

    Attributes:
        cell, folder: the cell, and the folder of its files.
        result: None if it failed.
        error: why it failed, a sentence; else None.
        kept: whether the result is from an earlier run of the bench.
        outdated: why an earlier result was not kept, a clause; empty if there was none.
    """

    cell: BenchCell
    folder: Path
    result: Result | None = None
    error: str | None = None
    kept: bool = False
    outdated: str = ""

    def plain(self) -> dict[str, Any]:
        """The row of a data frame."""
        used = self.cell.parameter_set
        named = {
            "sequence": self.cell.source.name,
            "method": used.method,
            "variant": used.variant,
        }
        if self.result is None:
            return {**named, "error": self.error}
        return {
            **named,
            **self.result.metrics,
            **self.result.counts,
            "mean_s": self.result.runtime.mean_s,
            "error": None,
        }


@dataclass(frozen=True)
class SearchResult:
    """The result of a search for one method.

    Attributes:
        best: the best parameters; the defaults if no trial was better.
        preset: the file with these parameters.
        aa, default_aa: associated accuracy of the best and the default parameters, in percent, over
            the added counts of all sequences that were not held out; ``default_aa`` is None if
            undefined.
        trials, failed: number of sets that were tried, and of those without an AA.
    """

    best: ParameterSet
    preset: Path
    aa: float
    default_aa: float | None
    trials: int
    failed: int


@dataclass(frozen=True)
class SeedSpread:
    """What a method scores over several seeds of itself and of the scene.

    Attributes:
        sequence, method, variant: without the seed.
        seeds: how many runs there are.
        mean, deviation: of SA, DA and AA in percent; the deviation is that of a sample (N - 1).
            Undefined scores are left out, and None without any, or without two for a deviation.
    """

    sequence: str
    method: str
    variant: str
    seeds: int
    mean: Mapping[str, float | None]
    deviation: Mapping[str, float | None]

    @classmethod
    def of(cls, sequence: str, method: str, variant: str, results: Sequence[Result]) -> SeedSpread:
        """From the results of each seed."""
        known = {
            name: [value for each in results if (value := each.metrics.get(name)) is not None]
            for name in SHOWN
        }
        mean = {name: statistics.fmean(of) if of else None for name, of in known.items()}
        deviation = {
            name: statistics.stdev(of) if len(of) > 1 else None for name, of in known.items()
        }
        return cls(sequence, method, variant, len(results), mean, deviation)

    def text(self, name: str) -> str:
        """A score in words."""
        mean = self.mean[name]
        spread = self.deviation[name]
        if mean is None:
            return "n/a"
        return f"{mean:.2f}" if spread is None else f"{mean:.2f} ± {spread:.2f}"


@dataclass(frozen=True)
class Leaderboard:
    """All rows of a bench; printing it with rich shows a leaderboard.

    Attributes:
        rows: one per cell.
        holdout: names of the held-out sequences.
        searches: one for each method whose parameters were searched.
        trials: the rows of all trials except the best.
        seeds: of methods and scenes; with several, ``spreads`` says how much they matter.
    """

    rows: list[BenchRow]
    holdout: frozenset[str] = frozenset()
    searches: list[SearchResult] = field(default_factory=list)
    trials: list[BenchRow] = field(default_factory=list)
    seeds: tuple[int, ...] = ()

    @property
    def spreads(self) -> list[SeedSpread]:
        """Mean and deviation over the seeds of each method on each sequence, in their order.

        Empty for fewer than two seeds. Cells that failed are left out.
        """
        groups: dict[tuple[str, str, str], list[Result]] = {}
        for row in self.rows if len(self.seeds) > 1 else ():
            used = row.cell.parameter_set
            key = (
                without_seed(row.cell.source.name)
                if row.cell.source.scene
                else row.cell.source.name,
                used.method,
                without_seed(used.variant),
            )
            if row.result:
                groups.setdefault(key, []).append(row.result)
        return [SeedSpread.of(*key, results) for key, results in groups.items()]

    @property
    def results(self) -> list[Result]:
        """The results of all finished cells."""
        return [row.result for row in self.rows if row.result]

    @property
    def failed(self) -> list[BenchRow]:
        """The cells that failed, including trials."""
        return [row for row in [*self.rows, *self.trials] if row.error]

    def totals(self, held_out: bool = False) -> list[Result]:
        """One combined result per method and variant if there are several sequences and none of its
        cells failed.
        """
        groups: dict[tuple[str, str], list[BenchRow]] = {}
        for row in self.rows:
            if (row.cell.source.name in self.holdout) == held_out:
                groups.setdefault(
                    (row.cell.parameter_set.method, row.cell.parameter_set.variant), []
                ).append(row)
        most = max(map(len, groups.values()), default=0)
        finished = [[row.result for row in rows if row.result] for rows in groups.values()]
        return [combined(results) for results in finished if len(results) == most > 1]

    def to_pandas(self) -> pandas.DataFrame:
        """One row per cell: what ran on what, its scores, points by outcome, seconds per frame, and
        the error of a cell that failed. Pandas must be installed.

        Raises:
            UsageError: without pandas.
        """
        return data_frame(row.plain() for row in self.rows)

    def __str__(self) -> str:
        return text_of(self, _WIDTH)

    def __repr__(self) -> str:
        failed = f", {len(self.failed)} failed" if self.failed else ""
        return f"<Leaderboard of {len(self.rows)} runs{failed}>"

    def _repr_html_(self) -> str:
        return html_of(self, _WIDTH)

    def __rich__(self) -> RenderableType:
        from rich.console import Group
        from rich.markup import escape
        from rich.table import Table

        from dynaviz.scores.result import result_table

        parts: list[RenderableType] = []
        training = [
            row.result
            for row in self.rows
            if row.result and row.cell.source.name not in self.holdout
        ]
        held = [
            row.result for row in self.rows if row.result and row.cell.source.name in self.holdout
        ]
        for results, totals, title in (
            (training, self.totals(), None),
            (held, self.totals(held_out=True), "Held out from the search"),
        ):
            if results:
                parts.append(result_table(_ranked(results) + _ranked(totals), title=title))
        if spreads := self.spreads:
            of = ", ".join(map(str, self.seeds))
            title = f"Mean ± standard deviation over the seeds {of}"
            table = Table(
                "sequence",
                "method",
                "runs",
                *SHOWN,
                box=None,
                pad_edge=False,
                title=title,
                title_justify="left",
            )
            for each in spreads:
                name = "-".join(filter(None, (each.method, each.variant)))
                cells = (each.sequence, name, str(each.seeds), *map(each.text, SHOWN))
                table.add_row(*map(escape, cells))
            parts.append(table)
        if self.failed:
            table = Table(
                "sequence",
                "method",
                "error",
                box=None,
                pad_edge=False,
                title="Failed",
                title_justify="left",
            )
            for row in self.failed:
                table.add_row(
                    *map(escape, (row.cell.source.name, row.cell.path.name, row.error or ""))
                )
            parts.append(table)
        return Group(*parts)


def _ranked(results: Sequence[Result]) -> list[Result]:
    """Sequences in their order; within each the best AA first, undefined ones last."""
    order = list(dict.fromkeys(result.sequence.name for result in results))

    def rank(result: Result) -> tuple[int, float]:
        aa = result.metrics.get("AA")
        return order.index(result.sequence.name), -math.inf if aa is None else aa

    return sorted(results, key=lambda result: (rank(result)[0], -rank(result)[1]))
