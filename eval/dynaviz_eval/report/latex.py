"""A report in LaTeX: the paper's two tables and published numbers, for a document with booktabs."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

from dynaviz.reporting import Study
from dynaviz_eval.report.table import Column, Table, Value
from dynaviz_eval.report.tables import tables

MAX_COLUMNS = 17  # columns that fit on a page in small print; wider tables are split

_ESCAPES = {
    **{c: f"\\{c}" for c in "&%$#_{}"},
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", "[": "{[}", "]": "{]}",
    "↑": r"$\uparrow$", "↓": r"$\downarrow$", "±": r"$\pm$", "−": r"$-$", "–": "--", "·": r"$\cdot$",
    "√": r"$\surd$", "†": r"$^\dagger$", "×": r"$\times$",
}  # fmt: skip


def latex_report(study: Study) -> str:
    """The tables of accuracy and runtime, and published numbers of public sequences."""
    content = tables(study)
    of_boards = [table for board in content.by_board for table in board.every]
    wanted = [t for t in (content.accuracy, content.runtime, content.failures, *of_boards) if t.rows]
    parts = [r"% Needs \usepackage{booktabs} and \usepackage{graphicx}."]
    parts += [_table(part) for table in wanted for part in _parts(table)]
    return "\n\n".join(parts) + "\n"


def escape(text: str) -> str:
    """Escape text for LaTeX."""
    return "".join(_ESCAPES.get(letter, letter) for letter in text)


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
        *_heads(table.columns),
        r"\midrule",
        *(_line([_field(value) for value in row]) for row in table.rows),
        r"\bottomrule",
        r"\end{tabular}",
    ]
    wide = len(table.columns) > 6
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


def _heads(columns: Sequence[Column]) -> list[str]:
    """A line of column names, and above it a line of groups with rules, if there are groups."""
    names = _line([escape(column.name) for column in columns])
    if not any(column.group for column in columns):
        return [names]
    fields, rules, at = [], [], 1
    for group, members in itertools.groupby(columns, lambda column: column.group):
        span = len(list(members))
        fields.append(rf"\multicolumn{{{span}}}{{c}}{{{escape(group)}}}" if group else " & " * (span - 1))
        rules += [rf"\cmidrule(lr){{{at}-{at + span - 1}}}"] if group else []
        at += span
    return [_line(fields), " ".join(rules), names]


def _field(value: Value) -> str:
    return rf"\textbf{{{escape(value.text)}}}" if value.bold else escape(value.text)


def _line(fields: Sequence[str]) -> str:
    return " & ".join(fields) + r" \\"
