"""A report in LaTeX: the tables, for a document with booktabs."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

from dynaviz.reports.reporting import Study
from dynaviz_eval.report.table import Column, Table, Value
from dynaviz_eval.report.tables import tables

MAX_COLUMNS = 17  # columns that fit on a page in small print; wider tables are split
NARROW = 6  # columns that need no special treatment
LONGER = 2  # letters by which a name exceeds its fields before it is rotated
LATIN_END = 0x180  # pdflatex prints Latin letters without additional packages

_ESCAPES = {
    **{c: f"\\{c}" for c in "&%$#_{}"},
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", "[": "{[}", "]": "{]}",
    "↑": r"$\uparrow$", "↓": r"$\downarrow$", "±": r"$\pm$", "−": r"$-$", "–": "--", "·": r"$\cdot$",
    "√": r"$\surd$", "†": r"$^\dagger$", "×": r"$\times$", "≥": r"$\geq$", "≤": r"$\leq$",
    "…": r"\dots{}",
}  # fmt: skip


def latex_report(study: Study) -> str:
    """The tables of accuracy, runtime, causes, published numbers, cases, objects, range and height."""
    content = tables(study)
    of_boards = [table for board in content.by_board for table in board.every]
    wanted = [t for t in (content.accuracy, content.runtime, content.failures, *of_boards) if t.rows]
    parts = [r"% Needs \usepackage{booktabs} and \usepackage{graphicx}."]
    parts += [_table(part) for table in wanted for part in _parts(table)]
    return "\n\n".join(parts) + "\n"


def escape(text: str) -> str:
    """Escape text for LaTeX; letters that pdflatex cannot print become question marks."""
    return "".join(
        _ESCAPES.get(letter, letter if ord(letter) < LATIN_END else "?") for letter in " ".join(text.split())
    )


def _parts(table: Table) -> Iterator[Table]:
    """Split a table that is too wide between groups of columns. Each part repeats the first column."""
    groups = [
        list(group) for _, group in itertools.groupby(range(1, len(table.columns)), lambda k: table.columns[k].group)
    ]
    piece: list[int] = [0]
    pieces = [piece]
    for group in groups:
        if len(piece) > 1 and len(piece) + len(group) > MAX_COLUMNS:
            piece = [0]
            pieces.append(piece)
        piece += group
    for number, chosen in enumerate(pieces, 1):
        suffix = f"-{number}" if len(pieces) > 1 else ""
        rows = [[row[k] for k in chosen] for row in table.rows]
        yield Table(table.name + suffix, table.title, [table.columns[k] for k in chosen], rows, table.notes)


def _table(table: Table) -> str:
    align = "".join("r" if column.number else "l" for column in table.columns)
    body = [
        r"\begin{tabular}{" + align + "}",
        r"\toprule",
        *_heads(table),
        r"\midrule",
        *(_line([_field(value) for value in row]) for row in table.rows),
        r"\bottomrule",
        r"\end{tabular}",
    ]
    wide = len(table.columns) > NARROW
    if wide:
        body = [r"\resizebox{\textwidth}{!}{%", *body, "}"]
    kind = "table*" if wide else "table"
    caption = escape(" ".join([f"{table.title}.", *table.notes]))
    return "\n".join(
        [
            rf"\begin{{{kind}}}[t]",
            r"\centering",
            rf"\caption{{{caption}}}",
            rf"\label{{tab:{table.name.replace('_', '-')}}}",
            *body,
            rf"\end{{{kind}}}",
        ]
    )


def _heads(table: Table) -> list[str]:
    """A line of column names, and above it a line of groups with rules, if there are groups.

    In wide tables, the names of groups with names much longer than the fields below are rotated.
    """
    columns = table.columns
    rotated = {
        column.group
        for k, column in enumerate(columns)
        if column.number and len(column.name) > LONGER + max((len(row[k].text) for row in table.rows), default=0)
    }
    if len(columns) <= NARROW:
        rotated = set()
    names = _line([_name(column, column.number and column.group in rotated) for column in columns])
    if not any(column.group for column in columns):
        return [names]
    fields, rules, at = [], [], 1
    for group, members in itertools.groupby(columns, lambda column: column.group):
        span = len(list(members))
        fields.append(rf"\multicolumn{{{span}}}{{c}}{{{escape(group)}}}" if group else " & " * (span - 1))
        rules += [rf"\cmidrule(lr){{{at}-{at + span - 1}}}"] if group else []
        at += span
    return [_line(fields), " ".join(rules), names]


def _name(column: Column, rotated: bool) -> str:
    return rf"\rotatebox{{60}}{{{escape(column.name)}}}" if rotated else escape(column.name)


def _field(value: Value) -> str:
    return rf"\textbf{{{escape(value.text)}}}" if value.bold else escape(value.text)


def _line(fields: Sequence[str]) -> str:
    return " & ".join(fields) + r" \\"
