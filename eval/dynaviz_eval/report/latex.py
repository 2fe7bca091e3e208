"""A report in LaTeX: the tables, to paste into a paper that loads ``booktabs``."""

from __future__ import annotations

from dynaviz.reports.reporting import Study
from dynaviz_eval.report.table import Table, Value
from dynaviz_eval.report.tables import tables

_SPECIAL = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "±": r"$\pm$",
    "·": r"$\cdot$",
    "√": r"$\surd$",
    "–": "--",
    "†": r"$\dagger$",
    "↑": r"$\uparrow$",
    "↓": r"$\downarrow$",
    "\N{NO-BREAK SPACE}": "~",
}


def latex_report(study: Study) -> str:
    """The tables in LaTeX, each in a ``table`` with its title and notes as caption."""
    head = "% Tables of a report. They need \\usepackage{booktabs}.\n\n"
    return head + "\n".join(table(each.narrowed(study.columns)) for each in tables(study).every)


def table(table: Table) -> str:
    """A table; groups of columns have a line above their names."""
    kinds = "".join("r" if column.number else "l" for column in table.columns)
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{escaped(' '.join([f'{table.title}.', *table.notes]))}}}",
        rf"\label{{tab:{table.name}}}",
        rf"\begin{{tabular}}{{{kinds}}}",
        r"\toprule",
        *_groups(table),
        _line([escaped(column.name) for column in table.columns]),
        r"\midrule",
        *(_line([_field(value) for value in row]) for row in table.rows),
        r"\bottomrule",
        r"\end{tabular}",
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def escaped(text: str) -> str:
    """A text without commands of LaTeX."""
    return "".join(_SPECIAL.get(each, each) for each in " ".join(text.split(" ")))


def _groups(table: Table) -> list[str]:
    """The line with the names of the groups, and the rules below it; none without groups."""
    if not any(column.group for column in table.columns):
        return []
    spans: list[tuple[str, int]] = []
    for column in table.columns:
        if spans and column.group and spans[-1][0] == column.group:
            spans[-1] = column.group, spans[-1][1] + 1
        else:
            spans.append((column.group, 1))
    fields = []
    rules = []
    first = 1
    for name, width in spans:
        fields.append(rf"\multicolumn{{{width}}}{{c}}{{{escaped(name)}}}" if name else "")
        if name:
            rules.append(rf"\cmidrule(lr){{{first}-{first + width - 1}}}")
        first += width
    return [_line(fields), " ".join(rules)]


def _field(value: Value) -> str:
    text = escaped(value.text)
    if value.bold:
        text = rf"\textbf{{{text}}}"
    return rf"{text} {{\footnotesize ({escaped(value.interval)})}}" if value.interval else text


def _line(fields: list[str]) -> str:
    return " & ".join(fields) + r" \\"
