"""A report in Markdown: the tables."""

from __future__ import annotations

import re

from dynaviz.reports.reporting import Study
from dynaviz_eval.report.table import Column, Table, Value
from dynaviz_eval.report.tables import tables

_SPECIAL = re.compile(r"([\\`*_\[\]<>|])")


def markdown_report(study: Study) -> str:
    """The tables in Markdown."""
    content = tables(study)
    every = (table(each.narrowed(study.columns)) for each in content.every)
    parts = ["# Report", *(_escaped(line) for line in content.headline), *every]
    return "\n\n".join(parts) + "\n"


def table(table: Table) -> str:
    """A table with its title and notes; column names start with their group."""
    head = [_head(column) for column in table.columns]
    lines = [_line(head), _line(["---:" if column.number else ":---" for column in table.columns])]
    lines += [_line([_field(value) for value in row]) for row in table.rows]
    notes = "\n\n".join(_escaped(note) for note in (*table.notes, table.details) if note)
    return f"## {_escaped(table.title)}\n\n" + "\n".join(lines) + (f"\n\n{notes}" if notes else "")


def _head(column: Column) -> str:
    return _escaped(f"{column.group}: {column.name}" if column.group else column.name)


def _field(value: Value) -> str:
    text = _escaped(value.text)
    if value.link:
        text = f"[{text}](<{value.link}>)"
    if value.bold:
        text = f"**{text}**"
    if value.interval:
        text = f"{text} ({_escaped(value.interval)})"
    return f"{text} ({_escaped(value.detail)})" if value.detail else text


def _line(fields: list[str]) -> str:
    return "| " + " | ".join(fields) + " |"


def _escaped(text: str) -> str:
    return _SPECIAL.sub(r"\\\1", " ".join(text.split()))
