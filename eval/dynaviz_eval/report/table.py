"""A table of a report, independent of its format."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

NONE = "n/a"
ABSENT = "–"  # a field that does not apply


@dataclass(frozen=True)
class Value:
    """A field of a table.

    Attributes:
        text: the printed text.
        sort: sort key of the row; None sorts last.
        bold: whether it is the best of its column.
        link: target of a link, relative to the report.
        heat: 0 to 1, how strongly the field is coloured; None for no colour.
        detail: small print below the text.
        interval: of the number; empty if unknown.
    """

    text: str
    sort: float | str | None = None
    bold: bool = False
    link: str = ""
    heat: float | None = None
    detail: str = ""
    interval: str = ""


@dataclass(frozen=True)
class Column:
    """A column of a table: its name and group, whether it contains numbers, and whether it is the
    main score.
    """

    name: str
    group: str = ""
    number: bool = True
    main: bool = False


@dataclass(frozen=True)
class Table:
    """A table. The first column names the row.

    Attributes:
        name: a short name for links.
        notes: sentences below the table.
        details: what the details of the fields are; left out by formats that leave out the details.
    """

    name: str
    title: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[Value]]
    notes: Sequence[str] = field(default_factory=tuple)
    details: str = ""

    def narrowed(self, names: Sequence[str]) -> Table:
        """The table with the first column and those with some names only.

        All columns without names, and for a table that has none of them.
        """
        kept = [
            k
            for k, column in enumerate(self.columns)
            if k == 0 or column.name.rstrip(" ↑↓") in names
        ]
        if not names or len(kept) < 2:
            return self
        return replace(
            self,
            columns=[self.columns[k] for k in kept],
            rows=[[row[k] for k in kept] for row in self.rows],
        )

    @property
    def heated(self) -> bool:
        """Whether any field is coloured."""
        return any(value.heat is not None for row in self.rows for value in row)


def percent(value: float | None, bold: bool = False) -> Value:
    """A percentage with two decimals, as in the papers."""
    return Value(NONE) if value is None else Value(f"{value:.2f}", value, bold)


def count(value: int | None) -> Value:
    """A number of points."""
    return Value(NONE) if value is None else Value(f"{value:,}", value)


def named(label: str) -> Value:
    """The name of a row."""
    return Value(label, label)


def many(number: int, thing: str) -> str:
    """A number of things, with its plural."""
    return f"{number:,} {thing}{'s' * (number != 1)}"
