"""Reports: errors by cause, by object, by range and height, and runs without ground truth."""

from __future__ import annotations

import pytest
from helpers.html_pages import Page, markdown_table
from helpers.made_results import REMOVALS, case, result, thing, without_truth

from dynaviz.contracts import registry
from dynaviz.scores.scores import Counts
from dynaviz_eval.report.tables import tables

CAUSES = {
    "false_positive": {
        "grazing rays": {"cases": 2, "points": 75},
        "shared cell": {"cases": 1, "points": 25},
    },
    "false_negative": {"nothing behind": {"cases": 1, "points": 20}},
}


def test_the_losses_of_all_causes_add_up(study):
    made = tables(
        study(result("a", sections={"failures": {"causes": CAUSES}}), result("b"))
    ).failures
    assert [column.name for column in made.columns] == [
        "method", "all", "grazing rays", "shared cell", "all", "nothing behind",
    ]  # fmt: skip
    row = next(row for row in made.rows if row[0].text == "a")
    assert [value.text for value in row[1:]] == ["10.00", "7.50", "2.50", "20.00", "20.00"]
    assert row[1].sort == sum(value.sort for value in row[2:4])


def test_a_larger_loss_has_a_stronger_colour(study):
    made = tables(
        study(result("a", sections={"failures": {"causes": CAUSES}}), result("b"))
    ).failures
    heats = {row[0].text: [value.heat for value in row[1:]] for row in made.rows}
    assert heats["a"] == [
        None,
        0.87,
        0.5,
        None,
        1.0,
    ]  # square roots of 7.5 and 2.5 of 10, and 20 of 20
    assert heats["b"] == [None, 1.0, None, None, 1.0]
    page = Page(registry.load("reports", "html")(study(result("c"))))
    cells = [
        cell
        for row in page.body("failures")
        for cell in row
        if "heat" in (cell["class"] or "").split()
    ]
    assert cells
    assert all(cell["style"].startswith("--heat: ") for cell in cells)


def test_small_losses_are_not_printed_as_zero(study):
    tiny = {
        "false_positive": {
            "grazing rays": {"cases": 1, "points": 1},
            "shared cell": {"cases": 1, "points": 99999},
        }
    }
    numbers = (10**9, 10**5, 80, 20)
    made = tables(
        study(result("a", numbers=numbers, sections={"failures": {"causes": tiny}}))
    ).failures
    assert dict(zip([c.name for c in made.columns], [v.text for v in made.rows[0]], strict=False))[
        "grazing rays"
    ] == "<0.01"  # fmt: skip


def objects(*things, failures=None, method="a"):
    breakdown = {"object": list(things)}
    return result(method, sections={"breakdown": breakdown, "failures": {"cases": failures or []}})


def test_objects_show_each_methods_verdict_and_reason(study):
    ghost = case(
        "false_negative", 1.0, (0, 0, 0), (1, 1, 1), what="moving car", instance=3, **{"class": 252}
    )
    made = tables(
        study(
            objects(thing(3, 10, 90), thing(4, 100, 0), failures=[ghost], method="a"),
            objects(
                thing(3, 20, 80, reasons={"low": 70, "grazed": 10}), thing(4, 60, 40), method="b"
            ),
            objects(thing(3, 100, 0), thing(4, 100, 0), method="c"),
        )
    )
    first, second = made.by_board[0].objects.rows
    labels = [column.name for column in made.by_board[0].objects.columns]
    row = dict(zip(labels, first, strict=True))
    assert (row["object"].text, row["points"].text) == ("moving car 3", "100")
    assert row["kept by"].text == "2 of 3 methods, for 2 reasons"
    assert [(row[name].text, row[name].detail, row[name].heat) for name in "abc"] == [
        ("10", "never crossed", 0.9),
        ("20", "low", 0.8),
        ("100", "", 0.0),
    ]
    assert (
        dict(zip(labels, second, strict=True))["kept by"].text == "0 of 3 methods"
    )  # 60 % were removed


def test_objects_that_all_methods_removed_are_not_listed(study):
    made = tables(study(objects(thing(3, 10, 0)), objects(thing(3, 10, 0), method="b")))
    assert not made.by_board[0].objects.rows
    assert (
        "Objects"
        not in Page(registry.load("reports", "html")(study(objects(thing(3, 10, 0))))).text
    )


def test_disputed_objects_come_first(study):
    many = [thing(k, 0, 50) for k in range(1, 30)]
    disputed = [thing(30, 0, 50)], [thing(30, 50, 0)]
    made = (
        tables(study(objects(*many, *disputed[0]), objects(*many, *disputed[1], method="b")))
        .by_board[0]
        .objects
    )
    assert made.rows[0][0].text == "class 252 30"
    assert len(made.rows) == 20
    assert "10 objects with errors not listed" in " ".join(made.notes)


def test_range_and_height_have_figures_and_numbers(study):
    near, far = Counts(90, 10, 8, 2), Counts(50, 50, 0, 0)
    by = [{"from": None, "to": 0.5, **near.row()}, {"from": 0.5, "to": None, **far.row()}]
    breakdown = {"height": by, "range": [{**by[0], "from": 0.0}, by[1]]}
    given = study(result("a", sections={"breakdown": breakdown}))
    made = tables(given).by_board[0]
    assert [column.name for column in made.height.columns] == [
        "method",
        "< 0.5",
        "≥ 0.5",
        "< 0.5",
        "≥ 0.5",
    ]
    assert [column.name for column in made.range.columns][1:3] == ["0–0.5", "≥ 0.5"]
    assert [value.text for value in made.height.rows[0]] == ["a", "90.00", "50.00", "80.00", "n/a"]
    text = registry.load("reports", "html")(given)
    for name in ("ranges", "heights"):
        assert text.count(f'id="{name}-0-0-title"') == text.count(f'id="{name}-0-1-title"') == 1


def test_runs_without_ground_truth_show_what_they_removed(study):
    given = study(without_truth("a", REMOVALS), without_truth("b", {**REMOVALS, "clusters": []}))
    made = tables(given)
    assert not made.glance.rows
    assert not made.accuracy.rows
    assert not made.failures.rows
    assert [value.text for value in made.by_board[0].removals.rows[0]] == [
        "a", "50", "5.00", "10.00", "1.67", "seen free 80 %, low 20 %",
    ]  # fmt: skip
    (cluster,) = made.by_board[0].case_list.rows
    assert [value.text for value in cluster] == ["1. Removed: wall", "40", "–"]
    assert [value.detail for value in cluster] == ["Removed: wall.", "flat", ""]
    page = Page(registry.load("reports", "html")(given))
    assert set(page.tables) == {"runtime", "removals-1", "cases-1", "runs"}
    assert "it is unknown which of these points" in page.text
    assert (
        markdown_table(registry.load("reports", "md")(given), "Removed points: open")[0][
            "removed: points"
        ]
        == "50"
    )


@pytest.mark.parametrize("format", ["html", "md"])
def test_an_unlabelled_run_of_an_earlier_version_has_no_false_numbers(study, format):
    text = registry.load("reports", format)(study(without_truth("one")))
    assert "one" in text
    assert "0.00" not in text
    assert "100.00" not in text


def test_runs_with_and_without_ground_truth_are_kept_apart(study):
    made = tables(study(result("a"), without_truth("a", REMOVALS)))
    assert [column.name for column in made.accuracy.columns] == [
        "method",
        "SA ↑",
        "DA ↑",
        "AA ↑",
        "HA ↑",
    ]
    assert [bool(board.removals.rows) for board in made.by_board] == [False, True]
    runs = {row[1].text: [value.text for value in row[4:8]] for row in made.runs.rows}
    assert runs == {"hall": ["900", "100", "80", "20"], "open": ["n/a"] * 4}
