"""The ledger of a point in the terminal, in 80 columns."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

from dynaviz.explain.point_ledger import LedgerEntry, PointLedger, QuantityInfo
from dynaviz.explain.words import number, rule_words

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

ROWS = 20  # entries listed at most


def ledger_table(ledger: PointLedger, head: Sequence[str]) -> RenderableType:
    """The heading, the scans that mattered most, in order, and the rules that decided.

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

    turns = _turns(ledger)
    shown = _deciding(ledger, turns)
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, caption_justify="left")
    table.caption = _rest(ledger, {entry.frame for entry in shown})
    for name in ("frame", "m", "angle", "hit", "crossed"):
        table.add_column(name, justify="right", no_wrap=True)
    for quantity in ledger.quantities:
        table.add_column(quantity.name, justify="left" if quantity.legend else "right")
    table.add_column("so far")
    for entry in shown:
        own = entry.frame == ledger.frame
        table.add_row(
            f"{entry.frame}{'*' if own else ''}",
            f"{entry.range_m:.1f}",
            "" if entry.angle_deg is None else f"{entry.angle_deg:.0f}°",
            f"{entry.hits or ''}",
            f"{entry.crossed or ''}",
            *(_cell(entry, quantity) for quantity in ledger.quantities),
            turns.get(entry.frame, ""),
            style="bold" if own else None,
        )
    return table


def _turns(ledger: PointLedger) -> dict[int, str]:
    """The frames after which the verdict changed, and the verdict from then on."""
    turns = {}
    before = None
    for entry in ledger.entries:
        if entry.removed is not None and entry.removed != before:
            turns[entry.frame] = "removed" if entry.removed else "kept"
            before = entry.removed
    return turns


def _deciding(ledger: PointLedger, turns: Collection[int]) -> list[LedgerEntry]:
    """At most ``ROWS`` entries by frame.

    The point's own, those that turned the verdict, then by their contribution.

    Entries without any contribution are left out.
    """
    lasting = {rule.name for rule in ledger.rules if rule.frame is not None}
    readings = [quantity.name for quantity in ledger.quantities if not quantity.total]

    def weight(entry: LedgerEntry) -> tuple[bool, bool, float, bool, int]:
        decides = entry.frame == ledger.frame or entry.frame in turns
        change = max((abs(value) for value in entry.changes.values()), default=0.0)
        read = any(entry.values.get(name) is not None for name in readings)
        return (
            decides,
            not lasting.isdisjoint(entry.holds),
            change,
            read,
            entry.hits + entry.crossed,
        )

    ranked = sorted(ledger.entries, key=weight, reverse=True)
    if ledger.rules:
        ranked = [entry for entry in ranked if any(weight(entry)[:4])]
    return sorted(ranked[:ROWS], key=lambda entry: entry.frame)


def _rest(ledger: PointLedger, shown: Collection[int]) -> str | None:
    """A line on the entries that are not shown."""
    rest = [entry for entry in ledger.entries if entry.frame not in shown]
    hits, crossed = (
        sum(getattr(entry, name) > 0 for entry in rest) for name in ("hits", "crossed")
    )
    return (
        f"{len(rest):,} more scans ({hits:,} hit it, {crossed:,} crossed it); --json lists all."
        if rest
        else None
    )


def _cell(entry: LedgerEntry, quantity: QuantityInfo) -> str:
    value = entry.values.get(quantity.name)
    change = entry.changes.get(quantity.name)
    if value is None:
        return ""
    if quantity.legend:
        return quantity.legend[int(value)]
    return number(value) + (f" ({'+' if change > 0 else ''}{number(change)})" if change else "")


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
