"""Results on a terminal."""

import io

import pytest
from rich.console import Console

from dynaviz.scores.result import Result, result_table

COUNTS = {
    "static_kept": 900,
    "static_removed": 100,
    "dynamic_removed": 64,
    "dynamic_kept": 36,
    "unlabelled": 5,
}


def result(method: str, aa: float | None, **more) -> Result:
    metrics = {
        "SA": 90.0,
        "DA": aa and 64.0,
        "AA": aa,
        "HA": aa and 74.8,
        "precision": 39.0,
        "IoU": 32.0,
    }
    given = {
        "method": method,
        "parameters": {},
        "sequence": {"name": "00", "digest": "a"},
        "counts": COUNTS,
        "metrics": metrics,
        "runtime": {"mean_s": 0.0123, "std_s": 0.0004},
    }
    return Result.from_dict({**given, **more}, "result.json")


def shown(*results: Result, color: bool = False) -> str:
    console = Console(file=io.StringIO(), width=200, force_terminal=color, legacy_windows=False)
    console.print(result_table(results, title="scores"))
    return console.file.getvalue()


def test_a_row_has_every_number_with_its_unit():
    text = shown(result("octomap", 75.894))
    for column in ("sequence", "method", "SA ↑", "AA ↑", "s/frame", "scoring"):
        assert column in text
    for value in ("00", "octomap", "90.00", "75.89", "100", "36", "0.012 ±0.000", "mask"):
        assert value in text


def test_undefined_is_not_a_number():
    text = shown(result("octomap", None))
    assert text.count("n/a") == 3  # DA, AA, HA
    assert "None" not in text
    assert "nan" not in text


def test_a_result_without_metrics_still_shows():
    assert shown(result("octomap", 1.0, counts={}, metrics={}, runtime={})).count("n/a") == 7


@pytest.mark.parametrize("rival", [{"scoring": "nn"}, {"sequence": {"name": "05", "digest": "b"}}])
def test_bold_marks_the_best_among_comparable_results(rival):
    bold = "\x1b[1m"
    text = shown(result("a", 70.0), result("b", 80.0), color=True)
    assert f"{bold}80.00" in text
    assert f"{bold}70.00" not in text
    text = shown(result("a", 70.0), result("b", 80.0, **rival), color=True)
    assert f"{bold}80.00" in text
    assert f"{bold}70.00" in text


def test_what_slowed_a_run_down_is_said():
    assert "0.000*" in shown(result("a", 70.0, instrumented=True))
    assert "*" not in shown(result("a", 70.0))


def test_eighty_columns_cut_no_number():
    console = Console(file=io.StringIO(), width=80)
    counts = {name: 4_300_000 + i for i, name in enumerate(COUNTS)}
    console.print(result("octomap_gf", 75.894, counts=counts))
    for value in ("octomap_gf", "90.00", "75.89", "4,300,001", "4,300,003", "0.012 ±0.000"):
        assert value in console.file.getvalue()


def test_result_shows_itself():
    console = Console(file=io.StringIO(), width=200)
    console.print(result("octomap", 75.894))
    assert "75.89" in console.file.getvalue()
