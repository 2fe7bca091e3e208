"""The document on a point in the terminal, in 80 columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from dynaviz.explain.deciding import DecidingScans, deciding_scans
from dynaviz.explain.point_ledger import PointLedger
from dynaviz.explain.words import rule_words

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

ROWS = 20  # listed at most


def ledger_table(ledger: PointLedger, head: Sequence[str]) -> RenderableType:
    """The heading, the scans that decided, in order, and the rules.

    Args:
        ledger: of one point.
        head: lines above the table.
    """
    from rich.console import Group
    from rich.text import Text

    parts: list[RenderableType] = [Text(line) for line in head]
    if ledger.entries:
        parts.append(_entries(ledger))
    if ledger.rules:
        parts += [Text("Removed if any of these rules holds:"), _rules(ledger)]
    return Group(*parts)


def _entries(ledger: PointLedger) -> Table:
    from rich import box
    from rich.table import Table

    rows = deciding_scans(ledger)
    shown = _most(ledger, rows)
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, caption_justify="left")
    table.caption = _rest(ledger, rows, shown)
    for name in ("frames", "m", "angle", "hit", "crossed"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("what it showed", overflow="fold")
    table.add_column("so far")
    for row in shown:
        own = row.frames[0] == ledger.frame
        table.add_row(
            f"{row.span}{'*' if own else ''}",
            _span(row.range_m, 1),
            "" if row.angle_deg is None else f"{_span(row.angle_deg, 0)}°",
            f"{row.hits or ''}",
            f"{row.crossed or ''}",
            row.text,
            "" if row.removed is None else "removed" if row.removed else "kept",
            style="bold" if own else None,
        )
    return table


def _most(ledger: PointLedger, rows: Sequence[DecidingScans]) -> list[DecidingScans]:
    """At most ``ROWS`` rows by frame: the point's own, those that turned the verdict, and then
    those of most scans.
    """

    def weight(row: DecidingScans) -> tuple[bool, int, int]:
        decides = row.frames[0] == ledger.frame or row.removed is not None
        return decides, row.scans, row.hits + row.crossed

    ranked = sorted(rows, key=weight, reverse=True)
    return sorted(ranked[:ROWS], key=lambda row: row.frames)


def _rest(
    ledger: PointLedger, rows: Sequence[DecidingScans], shown: Sequence[DecidingScans]
) -> str | None:
    """A line on the scans that are not shown."""
    left_out = sum(row.scans for row in rows) - sum(row.scans for row in shown)
    others = len(ledger.entries) - sum(row.scans for row in rows)
    parts = []
    if left_out:
        parts.append(f"{left_out:,} more scan{'s' * (left_out > 1)} decided as well")
    if others:
        parts.append(f"{others:,} scan{'s' * (others > 1)} touched it without effect")
    return f"{'; '.join(parts)}. --json lists all." if parts else None


def _span(ends: tuple[float, float], decimals: int) -> str:
    low, high = (f"{end:.{decimals}f}" for end in ends)
    return low if low == high else f"{low}-{high}"


def _rules(ledger: PointLedger) -> Table:
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 1, 0, 0))
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for rule in ledger.rules:
        table.add_row(
            "yes" if rule.holds else "no ",
            Text(rule_words(rule)),
            style=None if rule.holds else "dim",
        )
    return table
