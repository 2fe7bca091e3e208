"""Reports: each format is parsed, and its numbers compared with those of the results."""

from __future__ import annotations

import csv
import io
import json
import math
import re

import pytest
from helpers.html_pages import Page, markdown_table
from helpers.made_results import result
from hypothesis import given
from hypothesis import strategies as st

from dynaviz.reports.reporting import Study
from dynaviz.scores.collect import collect
from dynaviz.scores.result import Result
from dynaviz.scores.sections import SequenceInfo
from dynaviz_eval.report import boards
from dynaviz_eval.report.tables import tables


def report(study: Study, format: str) -> str:
    from dynaviz.contracts import registry

    text: str = registry.load("reports", format)(study)
    return text


TWO = (result("octomap_g"), result("erasor", numbers=(950, 50, 40, 60)))


def test_markdown_has_the_numbers_of_the_results(study):
    text = report(study(*TWO, failed=("removert",)), "md")
    rows = {row["method"]: row for row in markdown_table(text, "Accuracy")}
    for each in TWO:
        row = rows[each.method]
        for name in ("SA", "DA", "AA", "HA"):
            assert row[f"hall: {name} ↑"].strip("*") == f"{each.metrics[name]:.2f}"
    assert rows["octomap_g"]["hall: AA ↑"] == "**84.85**"
    assert rows["erasor"]["hall: SA ↑"] == "**95.00**"
    assert {
        row["runtime per frame [s] ↓: hall"]
        for row in markdown_table(text, "Runtime and parameters")
    } == {"**0.500 ± 0.100**"}
    assert "no \\<memory\\> & 100 % \\| lost" in text
    assert "1 run failed" in text


def test_csv_has_all_fields(study, tmp_path):
    rows = list(csv.DictReader(io.StringIO(report(study(*TWO, failed=("removert",)), "csv"))))
    assert [row["method"] for row in rows] == ["octomap_g", "erasor", "removert"]
    for row, each in zip(rows, TWO, strict=False):
        assert {name: int(row[name]) for name in each.counts} == each.counts
        assert {name: float(row[name]) for name in each.metrics} == each.metrics
        assert json.loads(row["parameters"]) == each.parameters
        assert (float(row["runtime_mean_s"]), row["n_parameters"], row["scoring"]) == (
            0.5,
            "2",
            "mask",
        )
        assert (row["sequence_digest"], row["labels_sha256"]) == ("digest of hall", "ab" * 32)
    assert (rows[2]["error"], rows[2]["SA"]) == ("no <memory> & 100 % | lost", "")


def test_the_page_is_well_formed_self_contained_and_sorted(study):
    text = report(
        study(*TWO, result("dufomap", numbers=(999, 1, 0, 0)), failed=("removert",)), "html"
    )
    page = Page(text)
    assert len(page.ids) == len(set(page.ids))
    assert {link[1:] for link in page.links if link.startswith("#")} <= set(page.ids)
    assert all(place.startswith(("#", "data:")) for place in page.loaded)
    rows = page.body("glance")
    assert [row[0]["text"] for row in rows] == ["octomap_g", "erasor", "dufomap"]
    assert [row[1].get("data-sort") for row in rows] == [
        str(each.metrics["AA"]) for each in TWO
    ] + [None]
    assert [row[1]["text"] for row in rows] == ["84.85", "61.64", "n/a"]
    assert [row[3]["bold"] for row in page.body("accuracy")] == [True, False, False]
    assert rows[0][2]["text"] == "dynamic kept: nothing behind (−20.0 DA)"
    assert "no <memory> & 100 % | lost" in page.body("failed")[0][2]["text"]
    assert "Best on hall: octomap_g, AA 84.85 %." in page.text

    assert not re.search(r"""(src|href|url\()\s*=?\s*["'(]?\s*(https?:)?//""", text)
    assert "@import" not in text

    assert (
        text.count("<svg ") == text.count('role="img"') == len(re.findall(r"<title id=", text)) > 3
    )


@pytest.mark.parametrize(
    ("numbers", "best"),
    [
        ([(900, 100, 80, 20), (900, 100, 90, 10)], {1}),
        ([(900, 100, 80, 20), (90, 10, 8, 2)], {0, 1}),
        ([(900, 100, 80, 20), (999, 1, 0, 0)], {0}),
        ([(900, 100, 0, 0), (999, 1, 0, 0)], set()),
        ([(900000, 100000, 80000, 20000), (900001, 99999, 80000, 20000)], {0, 1}),
        ([(900, 100, 80, 20)], set()),
        ([(900, 100, 0, 5), (800, 200, 0, 5)], {0, 1}),
    ],
    ids=["one", "tie", "one undefined", "all undefined", "tie as printed", "no rival", "all 0"],
)
def test_the_best_are_bold(study, numbers, best):
    made = tables(study(*(result(f"m{k}", numbers=n) for k, n in enumerate(numbers))))
    assert {row[0].text for row in made.glance.rows if row[1].bold} == {f"m{k}" for k in best}
    assert {row[0].text for row in made.accuracy.rows if row[3].bold} == {f"m{k}" for k in best}


COUNTS = st.tuples(*[st.integers(0, 10**9)] * 4)


@given(st.lists(COUNTS, min_size=2, max_size=4))
def test_combined_scores_are_those_of_all_points(several):
    results = [result("octomap", f"s{k}", numbers) for k, numbers in enumerate(several)]
    rows = [boards.ScoreRow("octomap", each) for each in results]
    single = [boards.ScoreBoard(f"s{k}", "mask", (row,)) for k, row in enumerate(rows)]
    (combined,), notes = boards.combined_boards(Study([]), single)
    kept, removed, right, left = (sum(numbers[k] for numbers in several) for k in range(4))
    row = combined.rows[0]
    for name, part, rest in (("SA", kept, removed), ("DA", right, left)):
        assert row.score(name) == (
            pytest.approx(100 * part / (part + rest)) if part + rest else None
        )
    if kept + removed and right + left:
        assert row.score("AA") == pytest.approx(
            100 * math.sqrt(kept / (kept + removed) * right / (right + left))
        )
    assert not notes


def test_combined_scores_are_those_of_methods_that_ran_everywhere(study):
    made = tables(study(result("octomap", "a"), result("erasor", "a"), result("octomap", "b")))
    assert [row.label for board in made.combined for row in board.rows] == ["octomap"]
    assert "Missing: erasor on b" in " ".join(made.accuracy.notes)


def test_no_scores_are_combined_if_no_method_ran_everywhere(study):
    assert not tables(study(result("octomap", "a"), result("erasor", "b"))).combined


def test_different_parameters_are_reported(study):
    made = tables(
        study(result("octomap", "a"), result("octomap", "b", parameters={"resolution": 0.2}))
    )
    assert made.combined
    assert "octomap had different parameters" in " ".join(made.accuracy.notes)


def test_scorings_are_never_mixed(study):
    made = tables(
        study(
            result("a"),
            result("b", scoring="nn", numbers=(999, 1, 99, 1)),
            result("c", numbers=(800, 200, 80, 20)),
        )
    )
    assert [(board.title, len(board.rows)) for board in made.boards] == [
        ("hall (mask)", 2),
        ("hall (nn)", 1),
    ]
    assert made.boards[0].best("AA") == {"a"}
    assert not made.combined
    assert "cannot be compared" in " ".join(made.glance.notes)


def test_sequences_with_equal_names_have_separate_boards(study):
    other = {"name": "hall", "digest": "0123456789", "frames": 1, "points": 1}
    made = tables(study(result("a"), result("a", sequence=other)))
    assert [board.title for board in made.boards] == ["hall (digest o)", "hall (01234567)"]


def test_one_sequence_under_two_names_is_one_board(study):
    again = {"name": "copy of hall", "digest": "digest of hall", "frames": 1, "points": 1100}
    made = tables(study(result("a"), result("b", sequence=again)))
    assert [(board.title, len(board.rows)) for board in made.boards] == [("hall", 2)]
    assert "hall: copy of hall in some results; the points are the same." in made.accuracy.notes


def test_runs_of_one_method_have_different_labels(study, tmp_path):
    made = tables(
        study(result("a"), result("a"), result("a", variant="coarse"), result("a", online=True))
    )
    assert {row.label for row in made.boards[0].rows} == {
        "a [00]",
        "a [01]",
        "a (coarse)",
        "a (online)",
    }


def test_runs_of_two_folders_are_labelled_with_them(tmp_path):
    for folder in ("old", "new"):
        for sequence in "xy":
            result("a", sequence).save(tmp_path / folder / sequence / "result.json")
    made = tables(Study(collect([tmp_path / "old", tmp_path / "new"]), tmp_path))
    assert {row.label for row in made.boards[0].rows} == {"a [old]", "a [new]"}
    assert len(made.combined[0].rows) == 2


def test_runtimes_of_other_machines_are_labelled_and_recorded_ones_marked(study):
    fast = {"mean_s": 0.1, "std_s": 0.0, "frames": 1, "threads": 1}
    made = tables(
        study(
            result("a", runtime={**fast, "mean_s": 0.2}),
            result("b", runtime=fast),
            result("c", runtime=fast, instrumented=True),
            result("d", runtime={**fast, "threads": 8}),
            result("e", runtime={}),
        )
    )
    rows = {row[0].text: row for row in made.runtime.rows}
    assert [value.text for value in rows["d"][:3]] == [
        "d",
        "Linux x86_64, 2 cores, 8 threads",
        "0.100 ± 0.000",
    ]
    assert rows["c"][2].text.endswith("†")
    assert rows["e"][2].text == "n/a"
    assert [name for name, row in rows.items() if row[2].bold] == ["b"]


def test_parameters_of_another_program_are_unknown(study):
    made = tables(study(result("a", scoring="nn", sections={"source": {"file": "x.pcd"}})))
    assert made.runtime.rows[0][-1].text == "n/a"


def test_errors_without_causes_still_have_their_cost(study):
    plain = result("a", sections={"failures": {}})
    made = tables(study(plain))
    assert made.glance.rows[0][2].text == "n/a"
    assert [value.text for value in made.failures.rows[0]] == ["a", "10.00", "20.00"]


def test_published_numbers_of_a_public_sequence(study):
    public = {"name": "semantickitti_00", "digest": "d", "frames": 141, "points": 17362230}
    indices = {"breakdown": {"frame": [{"frame": 0, "index": 4390}, {"frame": 140, "index": 4530}]}}
    made = tables(study(result("octomap", sequence=public, sections=indices)))
    table = made.by_board[0].published
    row = next(row for row in table.rows if row[0].text == "OctoMap")
    assert [value.text for value in row[1:5]] == ["68.05", "99.69", "82.37", "80.89"]
    assert [value.text for value in row[5:9]] == ["90.00", "80.00", "84.85", "84.71"]
    assert table.notes[0].startswith("Name, frames and points match")
    assert "ITSC 2023" in " ".join(table.notes)


@pytest.mark.parametrize(
    ("facts", "indices", "message"),
    [
        (
            {"name": "00", "frames": 30, "points": 5},
            (4390, 4419),
            "Only the name matches: 30 frames from 4390 to 4419 here",
        ),
        (
            {"name": "kitti_00", "frames": 141, "points": 5},
            (4390, 4530),
            "but not the points: 5 here",
        ),
        (
            {"name": "kitti_01", "frames": 101, "points": 5},
            (150, 250),
            "number of points was not published",
        ),
    ],
)
def test_what_matches_a_public_sequence_is_reported(study, facts, indices, message):
    frames = {
        "breakdown": {"frame": [{"frame": k, "index": index} for k, index in enumerate(indices)]}
    }
    made = tables(study(result("octomap", sequence={"digest": "d", **facts}, sections=frames)))
    table = made.by_board[0].published
    assert message in table.notes[0]


def test_other_sequences_have_no_published_numbers(study):
    assert tables(study(*TWO)).by_board[0].published is None


@pytest.mark.parametrize(
    "results",
    [
        (),
        (result("one_a"),),
        (result("one_a", numbers=(0, 0, 0, 0)),),
        (Result("one_a", {}, SequenceInfo("s")),),
    ],
    ids=["only a failed one", "one", "no points", "no sections"],
)
def test_reports_of_few_results(study, results):
    given = study(*results, failed=() if results else ("one_a",))
    assert "one_a" in Page(report(given, "html")).text
    assert "one\\_a" in report(given, "md")
    assert "one_a" in report(given, "csv")


def test_variants_show_their_pareto_front(study):
    spread = [(900, 100, 50, 50), (800, 200, 90, 10), (850, 150, 40, 60), (700, 300, 95, 5)]
    page = Page(
        report(
            study(*(result("a", numbers=n, variant=f"v{k}") for k, n in enumerate(spread))), "html"
        )
    )
    words = [word.strip() for word in page.words]
    assert words.count("v2") == 0  # beaten by v0 in both
    assert {"v0", "v1", "v3"} <= set(words)
    assert "no other variant beats in both" in page.text


def test_the_ceiling_has_a_table_and_a_bar_of_each_method(study):
    shares = {"removed_seen": 70.0, "removed_unseen": 10.0, "kept_seen": 15.5, "kept_unseen": 4.5}
    ceiling = {
        "possible": {"percent": 85.5, "error": 0.8},
        "possible_by_object": {"percent": 100.0, "error": 0.0},
        **{name: {"percent": share, "error": 0.0} for name, share in shares.items()},
    }
    known = result("octomap_g", sections={"ceiling": ceiling})
    text = report(study(known, result("erasor")), "md")
    (row,) = markdown_table(text, "What the drive showed: hall")
    assert row["method"] == "octomap_g"
    assert row["possible DA [%]: by point"] == "85.5 ±0.8"
    assert row["dynamic points [%]: kept, evidence"] == "15.5"
    assert "Dynamic points on hall by answer" in report(study(known), "html")
    assert "What the drive showed" not in report(study(result("erasor")), "md")


def test_runs_of_one_method_with_other_code_are_said(study):
    codes = {"octomap": ("aa" * 32, "ab" * 32), "erasor": ("cc" * 32, "cc" * 32)}
    runs = [
        result(method, sequence, plugin={"sha256": code})
        for method, both in codes.items()
        for sequence, code in zip(("hall", "street"), both, strict=True)
    ]
    text = report(study(*runs), "md")
    rows = markdown_table(text, "All runs")
    assert sorted(row["code"] for row in rows) == ["aaaaaaaa", "abababab", "cccccccc", "cccccccc"]
    assert "The code differs between the runs of octomap." in text
    alike = report(study(*runs[2:], result("removert")), "md")
    assert "The code differs" not in alike
    assert "n/a" in {row["code"] for row in markdown_table(alike, "All runs")}
