"""Tables in LaTeX, and tables of fewer columns."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from helpers.made_results import result

from dynaviz.contracts import registry
from dynaviz.reports.reporting import Study, report
from dynaviz.scores.collect import collect
from dynaviz_eval.report.latex import escaped
from dynaviz_eval.report.latex import table as latex_table
from dynaviz_eval.report.table import Column, Table, Value
from dynaviz_eval.report.tables import tables


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two methods on two sequences, of which one method lacks the second."""
    for number, each in enumerate(
        (result("octomap_gf", "street"), result("erasor", "street"), result("erasor", "hall"))
    ):
        each.save(tmp_path / f"{number}" / "result.json")
    return tmp_path


def test_every_table_has_as_many_fields_as_columns(folder: Path) -> None:
    text = report(folder, format="latex")
    bodies = re.findall(r"\\begin\{tabular\}\{([lr]+)\}(.*?)\\end\{tabular\}", text, re.S)
    assert len(bodies) == text.count(r"\begin{table}") > 2
    for kinds, body in bodies:
        for row in re.findall(r"^(.*) \\\\$", body, re.M):
            spans = [int(width) - 1 for width in re.findall(r"\\multicolumn\{(\d+)\}", row)]
            assert len(re.findall(r"(?<!\\)&", row)) + 1 + sum(spans) == len(kinds)
    assert not re.search(r"(?<!\\)[%#$_]\w*(?<!pm)\b_", text)
    assert r"octomap\_gf" in text


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a_b & 5 %", r"a\_b \& 5 \%"),
        ("1 ± 2", r"1 $\pm$ 2"),
        ("{x}^2", r"\{x\}\textasciicircum{}2"),
    ],
)
def test_special_characters_are_escaped(text: str, expected: str) -> None:
    assert escaped(text) == expected


def test_a_group_spans_its_columns() -> None:
    columns = [Column("m", number=False), Column("SA", "A"), Column("DA", "A"), Column("s", "B")]
    rows = [[Value("x"), Value("1", bold=True), Value("2"), Value("3")]]
    text = latex_table(Table("t", "T", columns, rows))
    assert r" & \multicolumn{2}{c}{A} & \multicolumn{1}{c}{B} \\" in text
    assert r"\cmidrule(lr){2-3} \cmidrule(lr){4-4}" in text
    assert r"x & \textbf{1} & 2 & 3 \\" in text


def test_narrow_tables_keep_the_named_columns(folder: Path) -> None:
    wide = report(folder, format="md")
    narrow = report(folder, format="md", columns=["SA", "AA"])
    accuracy = narrow[narrow.index("## Accuracy") :].splitlines()[2]
    assert re.findall(r"(\w+ ?\d?): (\w+)", accuracy) == [
        (of, name) for of in ("all 2", "street", "hall") for name in ("SA", "AA")
    ]
    assert len(narrow) < len(wide)


def test_a_method_that_lacks_a_sequence_leaves_the_others_their_column(folder: Path) -> None:
    made = tables(Study(collect([folder]), folder))
    (board,) = made.combined
    assert [row.label for row in board.rows] == ["erasor"]
    assert any("Missing: octomap_gf on hall" in note for note in made.accuracy.notes)


def test_a_sequence_has_one_name(folder: Path) -> None:
    """The most frequent one; a note has the others."""
    hall = {"name": "roof", "digest": "digest of hall", "frames": 1, "points": 1100}
    result("octomap", "hall").save(folder / "3" / "result.json")
    result("dufomap", hall).save(folder / "4" / "result.json")
    made = tables(Study(collect([folder]), folder))
    assert [board.title for board in made.boards] == ["street", "hall"]
    assert len(made.boards[1].rows) == 3
    assert "hall: roof in some results; the points are the same." in made.accuracy.notes
    text = report(folder, format="latex")
    assert text.count("roof") < text.count("hall")


def test_the_format_follows_from_the_suffix(folder: Path) -> None:
    assert report(folder, out=folder / "table.tex") == report(folder, format="latex")
    assert "latex" in [handle.name for handle in registry.handles("reports")]
