"""Results as a table for a terminal or a notebook."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from dynaviz.results.result import Result, label

if TYPE_CHECKING:
    from rich.table import Table


def result_table(results: Sequence[Result], title: str | None = None) -> Table:
    """One row a result, in 80 columns; the best AA of each sequence and scoring is bold.

    Percentages have two decimals as in the papers, ``n/a`` where they are undefined. Scores of different scorings
    (``mask``, ``nn``) do not compare, so where there are several the scoring has its own column.
    """
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    scorings = sorted({result.scoring for result in results})
    table = Table(title=title, caption=_caption(results, scorings), caption_justify="left")
    table.box, table.padding, table.pad_edge = box.SIMPLE_HEAD, (0, 1, 0, 0), False
    table.add_column("sequence", overflow="fold")
    table.add_column("method", no_wrap=not any(result.variant for result in results), overflow="fold")
    for name in ("SA ↑", "DA ↑", "AA ↑", "HA ↑", "FP", "FN", "s/frame"):
        table.add_column(name, justify="right", no_wrap=True)
    if len(scorings) > 1:
        table.add_column("scoring")
    best: dict[tuple[object, str], float] = {}
    for result in results:
        best[_group(result)] = max(best.get(_group(result), -math.inf), _aa(result))
    for result, following in itertools.zip_longest(results, results[1:]):
        aa = _percent(result, "AA")
        champion = len(results) > 1 and _aa(result) == best[_group(result)] >= 0
        table.add_row(
            escape(str(result.sequence.get("name", ""))),
            escape(label(result.method, result.variant, result.online)),
            _percent(result, "SA"),
            _percent(result, "DA"),
            f"[bold]{aa}[/bold]" if champion else aa,
            _percent(result, "HA"),
            _count(result, "static_removed"),
            _count(result, "dynamic_kept"),
            _runtime(result),
            *([result.scoring] if len(scorings) > 1 else []),
            end_section=following is not None and following.sequence.get("name") != result.sequence.get("name"),
        )
    return table


def _caption(results: Sequence[Result], scorings: Sequence[str]) -> str:
    lines = [
        "SA, DA: static points kept, dynamic points removed, in %; AA = √(SA · DA),",
        "HA = 2 · SA · DA / (SA + DA)",
        "FP: static points removed, FN: dynamic points kept",
        *([f"scoring: {scorings[0]}"] if len(scorings) == 1 else []),
        *(["* while its states were recorded"] if any(result.instrumented for result in results) else []),
    ]
    return "\n".join(lines)


def _group(result: Result) -> tuple[object, str]:
    """Only these results compare: the same points, scored the same way."""
    return result.sequence.get("digest"), result.scoring


def _aa(result: Result) -> float:
    """AA for finding the best; below all others where undefined."""
    value = result.metrics.get("AA")
    return -math.inf if value is None else value


def _percent(result: Result, name: str) -> str:
    value = result.metrics.get(name)
    return "n/a" if value is None else f"{value:.2f}"


def _count(result: Result, part: str) -> str:
    return f"{result.counts[part]:,}" if part in result.counts else "n/a"


def _runtime(result: Result) -> str:
    """Seconds a frame, and a mark where recording the method's states slowed it down."""
    mean, std = result.runtime.get("mean_s"), result.runtime.get("std_s")
    if mean is None:
        return "n/a"
    return f"{mean:.3f}" + ("" if std is None else f" ±{std:.3f}") + ("*" if result.instrumented else "")
