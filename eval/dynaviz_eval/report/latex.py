"""A report in LaTeX: the paper's two tables and published numbers, to be input into a document with booktabs."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

from dynaviz.reporting import Study
from dynaviz_eval.report.tables import Column, Table, Value, tables

WIDE = 17  # columns that fit across a page in small print; more go into a further table

_ESCAPES = {
    **{c: f"\\{c}" for c in "&%$#_{}"},
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", "[": "{[}", "]": "{]}",
    "↑": r"$\uparrow$", "↓": r"$\downarrow$", "±": r"$\pm$", "−": r"$-$", "–": "--", "·": r"$\cdot$",
    "√": r"$\surd$", "†": r"$^\dagger$", "×": r"$\times$",
}  # fmt: skip


def latex_report(study: Study) -> str:
    """The tables of accuracy and runtime, and the published numbers of public sequences."""
    made = tables(study)
    wanted = [table for table in (*made.tables[:2], *made.public.values()) if table.rows]
    parts = [r"% Needs \usepackage{booktabs} and \usepackage{graphicx}."]
    parts += [_table(part) for table in wanted for part in _parts(table)]
    return "\n\n".join(parts) + "\n"


def escape(text: str) -> str:
    """Text that LaTeX prints as it is."""
    return "".join(_ESCAPES.get(letter, letter) for letter in text)


def _parts(table: Table) -> Iterator[Table]:
    """A table that is too wide in pieces, by whole groups of columns; each repeats the first column."""
    groups = [
        list(group) for _, group in itertools.groupby(range(1, len(table.columns)), lambda k: table.columns[k].group)
    ]
    piece: list[int] = [0]
    pieces = [piece]
    for group in groups:
        if len(piece) > 1 and len(piece) + len(group) > WIDE:
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
    """One line of names, and above it one of groups with a rule below each, where there are any."""
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
