"""Checks of results against limits and a baseline.

What fails, what is refused, what is only reported.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynaviz.errors import DataError, UsageError
from dynaviz.scores.changed_cases import STORED_CASES, changed_cases
from dynaviz.scores.check_reports import junit_xml, markdown
from dynaviz.scores.collect import StudyRun, collect
from dynaviz.scores.failure_case import FailureCase, RangeSpan
from dynaviz.scores.regression import (
    STORED,
    CheckOutcome,
    RegressionCheck,
    check,
    label,
    read_baseline,
    write_baseline,
)
from dynaviz.scores.result import Result
from dynaviz.scores.sections import Failures, Runtime, Sections, SequenceInfo

Command = Callable[..., tuple[int, str, str]]


def result(
    static: tuple[int, int] = (80, 20), dynamic: tuple[int, int] = (45, 5), **changes: Any
) -> Result:
    """A result with given counts.

    Static points kept and removed, dynamic points removed and kept.
    """
    sa, da = (100 * a / (a + b) if a + b else None for a, b in (static, dynamic))
    both = sa is not None and da is not None
    metrics = {
        "SA": sa,
        "DA": da,
        "AA": math.sqrt(sa * da) if both else None,  # type: ignore[operator]
        "HA": 2 * sa * da / (sa + da) if both else None,  # type: ignore[operator]
    }
    names = ("static_kept", "static_removed", "dynamic_removed", "dynamic_kept")
    values: dict[str, Any] = {
        "method": "octomap",
        "parameters": {"resolution": 0.1},
        "sequence": SequenceInfo("street", "d1", 5, 150),
        "sections": Sections(
            metrics=metrics, counts=dict(zip(names, (*static, *dynamic), strict=True))
        ),
        "runtime": Runtime(0.5),
    }
    return Result(**(values | changes))


def cell(result: Result | None, error: str | None = None, method: str = "octomap") -> StudyRun:
    return StudyRun(Path("result.json"), result, error, method, "street", "", Path())


def outcomes(checked: RegressionCheck) -> dict[str, str]:
    return {value.name: value.outcome.name for value in checked.values}


def test_limits() -> None:
    checked = check([cell(result())], [("SA", 80.0), ("DA", 90.1), ("DA", 90.0)])
    assert [(f.name, f.outcome, f.value, f.limit) for f in checked.values] == [
        ("DA", CheckOutcome.FAILED, 90.0, 90.1),
        ("SA", CheckOutcome.PASSED, 80.0, 80.0),
        ("DA", CheckOutcome.PASSED, 90.0, 90.0),
    ]
    assert checked.failed[0].counts["dynamic_kept"] == (5, None)


@pytest.mark.parametrize(
    ("static", "dynamic", "why"),
    [((9, 1), (0, 0), "labelled as dynamic"), ((0, 0), (9, 1), "labelled as static")],
)
def test_an_undefined_metric_fails(
    static: tuple[int, int], dynamic: tuple[int, int], why: str
) -> None:
    (failed,) = check([cell(result(static, dynamic))], [("AA", 0.0)]).failed
    assert (failed.value, why in failed.remark) == (None, True)
    checked = check([cell(result(static, dynamic))], baseline=[result()])
    assert {f.name for f in checked.failed} >= {"AA", "HA"}
    again = check([cell(result(static, dynamic))], baseline=[result(static, dynamic)])
    assert not again.failed


def test_a_metric_that_does_not_exist_is_a_mistake() -> None:
    with pytest.raises(UsageError, match=r"FOO.*SA, DA, AA, HA"):
        check([cell(result())], [("FOO", 1.0)])


percent = st.floats(0, 100)


@given(percent, percent, st.floats(0, 5))
def test_a_drop_beyond_the_tolerance_fails(now: float, before: float, tolerance: float) -> None:
    new, old = (Sections(metrics=dict.fromkeys(("SA", "DA", "AA", "HA"), x)) for x in (now, before))
    checked = check(
        [cell(result(sections=new))], baseline=[result(sections=old)], tolerance=tolerance
    )
    outcomes = {f.outcome for f in checked.values if f.name != "s/frame"}
    if abs(abs(now - before) - tolerance) > 1e-6:
        assert outcomes == {
            CheckOutcome.PASSED
            if abs(now - before) < tolerance
            else CheckOutcome(int(now > before))
        }


def test_changes_of_counts_and_runtime_are_reported() -> None:
    before = result(runtime=Runtime(0.1))
    checked = check([cell(result((70, 30), (50, 0)))], baseline=[before])
    assert outcomes(checked) == {
        "SA": "FAILED",
        "DA": "IMPROVED",
        "AA": "FAILED",
        "HA": "FAILED",
        "s/frame": "INFO",
    }
    assert checked.failed[0].counts["static_removed"] == (30, 10)
    runtime = checked.values[-1]
    assert (runtime.value, runtime.limit, runtime.before) == (0.5, None, 0.1)


def test_different_data_or_scoring_is_refused() -> None:
    other = SequenceInfo("street", "d2", 5, 149)
    with pytest.raises(
        UsageError, match=r"data differ.*d1 \(5 frames, 150 points\).*d2 \(5 frames, 149 points\)"
    ):
        check(
            [cell(result())],
            baseline=[result(sequence=other), result(method="erasor")],
        )
    with pytest.raises(UsageError, match="scoring mask, the baseline nn"):
        check([cell(result())], baseline=[result(scoring="nn")])
    with pytest.raises(UsageError, match="data differ"):  # one run against another
        check(
            [cell(result())],
            baseline=[
                result(sequence=msgspec.structs.replace(other, name="hall"), method="erasor")
            ],
        )


def test_the_matching_entry_is_chosen_among_several() -> None:
    good, bad = result(), result((1, 99))
    baseline = [
        replace(bad, sequence=msgspec.structs.replace(bad.sequence, digest="d2")),
        replace(bad, scoring="nn"),
        replace(bad, parameters={"resolution": 0.2}),
        replace(bad, variant="fine"),
        replace(bad, online=True),
        good,
    ]
    for order in (baseline, baseline[::-1]):
        checked = check([cell(good)], baseline=order)
        assert "IMPROVED" not in outcomes(checked).values()
        assert not checked.failed


def test_a_sequence_may_be_renamed_and_parameters_may_change() -> None:
    renamed = result(
        sequence=msgspec.structs.replace(result().sequence, name="road"),
        parameters={"resolution": 0.3},
    )
    checked = check(
        [cell(renamed), cell(result(method="new"))],
        baseline=[result(), result(method="x")],
    )
    remarks = {
        (f.run, f.name): f.remark
        for f in checked.values
        if f.outcome is CheckOutcome.INFO and f.remark
    }
    assert remarks[("octomap on road", "parameters")] == "resolution 0.1 -> 0.3"
    assert remarks[("new on street", "run")] == "is not in the baseline"
    assert not checked.failed


def test_a_failed_or_missing_run_fails() -> None:
    baseline = [result(), result(method="erasor")]
    cells = [cell(None, "no memory", "erasor")]
    checked = check(cells, [("AA", 1.0)], baseline, complete=True)
    assert {f.run: f.remark for f in checked.failed} == {
        "erasor on street": "failed: no memory",
        "octomap on street": "is in the baseline, but has no result",
    }
    assert len(check(cells, baseline=baseline).failed) == 1


def test_a_failed_variant_does_not_hide_missing_ones() -> None:
    baseline = [result(variant=variant) for variant in ("", "fine", "coarse")]
    cells = [replace(cell(None, "no memory"), variant="fine"), cell(result())]
    assert {f.run: f.remark for f in check(cells, baseline=baseline, complete=True).failed} == {
        "octomap (fine) on street": "failed: no memory",
        "octomap (coarse) on street": "is in the baseline, but has no result",
    }


def test_a_label_names_the_variant_once() -> None:
    labels = [label(result(variant=variant, online=True)) for variant in ("online", "fine", "")]
    assert labels == [
        "octomap (online) on street",
        "octomap (fine) (online) on street",
        "octomap (online) on street",
    ]


def test_a_baseline_survives_its_file(tmp_path: Path) -> None:
    results = [result(method="b"), result((0, 0), method="a", variant="fine"), result(method="b")]
    write_baseline(tmp_path / "b.json", results)
    text = (tmp_path / "b.json").read_text()
    assert [line.count('"method": ') for line in text.splitlines()] == [0, 1, 1, 0]
    assert "mean_s" not in text
    entries = read_baseline(tmp_path / "b.json")
    for entry, stored in zip(entries, (results[1], results[0]), strict=True):
        assert all(getattr(entry, name) == getattr(stored, name) for name in STORED)
        assert entry.runtime.mean_s is None
    with pytest.raises(UsageError, match="b on street differ"):
        write_baseline(tmp_path / "c.json", [*results, result((1, 1), method="b")])


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("{", "not valid JSON"),
        ("[]", "not the result"),
        ('{"baseline": 9}', "newer"),
        ('{"baseline": 1}', "not a baseline"),
    ],
)
def test_files_that_are_not_a_baseline(tmp_path: Path, content: str, expected: str) -> None:
    (tmp_path / "b.json").write_text(content)
    with pytest.raises(DataError, match=expected):
        read_baseline(tmp_path / "b.json")


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """Two runs in the folders of a bench."""
    for name, static in (("octomap", (80, 20)), ("erasor", (95, 5))):
        result(static, method=name).save(tmp_path / "bench/street" / name / "result.json")
    return tmp_path / "bench"


def test_the_command(bench: Path, tmp_path: Path, run_command: Command) -> None:
    baseline = tmp_path / "baseline.json"
    code, out, err = run_command("check", bench, "--write-baseline", baseline)
    assert (code, "Written" in out) == (0, True), err
    code, out, _ = run_command(
        "check", bench, "--baseline", baseline, "--min", "SA=80", "--min", "AA=80"
    )
    assert (code, "all 12 checks passed" in out) == (0, True), out
    result((70, 30)).save(bench / "street/octomap/result.json")
    code, out, _ = run_command(
        "check", bench, "--baseline", baseline, "--junit", tmp_path / "checks.xml"
    )
    assert code == 1
    suites = {
        suite.get("name"): suite for suite in ElementTree.parse(tmp_path / "checks.xml").getroot()
    }
    assert set(suites) == {"octomap on street", "erasor on street"}
    cases = {case.get("name"): case.find("failure") for case in suites["octomap on street"]}
    assert (
        cases["SA"]
        .get("message")
        .startswith("SA 70.00 %; at least 79.50 % is required; 80.00 % before")
    )
    assert suites["octomap on street"].get("failures") == str(
        sum(found is not None for found in cases.values())
    )
    assert suites["erasor on street"].get("failures") == "0"
    first = next(line for line in out.splitlines() if "FAIL" in line)
    assert all(
        word in first
        for word in ("octomap on street", "SA", "70.00", "79.50", "80.00", "-10.00", "FP 30")
    )
    assert max(map(len, out.splitlines())) <= 80
    assert "failed" in out
    code, _, _ = run_command("check", bench, "--baseline", baseline, "--tolerance", 10.5)
    assert code == 0
    (bench / "street/octomap/result.json").unlink()
    (bench / "street/octomap/error.json").write_text(
        json.dumps({"method": "octomap", "sequence": "street", "error": "no memory"})
    )
    code, out, _ = run_command(
        "check", bench, "--min", "SA=1", "--write-baseline", tmp_path / "never.json"
    )
    assert (code, "failed: no memory" in out, (tmp_path / "never.json").exists()) == (
        1,
        True,
        False,
    )


def test_an_improvement_is_reported(bench: Path, tmp_path: Path, run_command: Command) -> None:
    run_command("check", bench, "--write-baseline", tmp_path / "b.json")
    result((90, 10)).save(bench / "street/octomap/result.json")
    code, out, _ = run_command("check", bench, "--baseline", tmp_path / "b.json")
    assert code == 0
    assert "+10.00" in out
    assert "consider updating the baseline" in out


@pytest.mark.parametrize(
    "typed",
    [
        "check {}",
        "check {} --min AA",
        "check {} --min FOO=1",
        "check absent --min AA=1",
        "check {} --baseline absent",
    ],
)
def test_a_mistake_gives_one_line(bench: Path, run_command: Command, typed: str) -> None:
    code, _, err = run_command(*(word.format(bench) for word in typed.split()))
    assert (code, err.count("\n")) == (2, 1), err


def test_cells_of_a_bench_are_found(bench: Path) -> None:
    assert sorted(cell.method for cell in collect([bench])) == ["erasor", "octomap"]


def case(cost: float, at: float = 0.0, **changes: Any) -> FailureCase:
    """A case of 1 m at a place along x, in frames 3 to 7."""
    values: dict[str, Any] = {"kind": "false_negative", "what": "van", "cause": "hidden"}
    corners = (at, 0.0, 0.0), (at + 1.0, 1.0, 1.0)
    return FailureCase(
        **(values | changes), points=10, cost=cost, first_frame=3, last_frame=7, worst_frame=5,
        frames=5, low=corners[0], high=corners[1], range=RangeSpan(8.0, 9.0, 10.0), moved=0.0,
        reasons={"low": 10},
    )  # fmt: skip


def failing(*cases: FailureCase, **changes: Any) -> Result:
    sections = result().sections
    sections = msgspec.structs.replace(sections, failures=Failures(cases))
    return result(sections=sections, **changes)


def test_new_and_grown_cases_are_found() -> None:
    before = failing(case(3.0, 0.0), case(2.0, 10.0), case(1.0, 20.0, class_=1, instance=4))
    now = failing(
        case(3.0, 0.5),  # moved a little
        case(2.6, 50.0, class_=1, instance=4),  # the same object elsewhere
        case(2.0, 10.0, kind="false_positive"),  # another error at the same place
        case(0.04, 30.0),  # too small to matter
    )
    found = changed_cases(now, before, Path("bench/run.rrd"))
    assert [(each.number, each.before) for each in found] == [(3, 0.0), (2, 1.0)]
    assert found[1].text == ("case 2: van, 2.60 % of DA (was 1.00 %), 9 m away, frames 3-7, hidden")
    assert found[0].command == "dynaviz view bench/run.rrd --case 3 -o case_3.png"
    assert changed_cases(now, now, None) == []
    both = failing(*(case(cost, class_=1, instance=4) for cost in (2.0, 1.0)))
    split = failing(*(case(cost, class_=1, instance=4) for cost in (1.6, 1.5)))
    assert [(each.number, round(each.before, 2)) for each in changed_cases(split, both, None)] == [
        (2, 1.4)
    ]
    assert changed_cases(now, result(), None) == []  # a baseline without cases


def test_of_a_baseline_only_the_stored_cases_are_known(tmp_path: Path) -> None:
    many = failing(*(case(20.0 - k, 10.0 * k) for k in range(STORED_CASES + 5)))
    write_baseline(tmp_path / "b.json", [many])
    (entry,) = read_baseline(tmp_path / "b.json")
    assert len(entry.failures) == STORED_CASES
    assert changed_cases(many, entry, None) == []  # the others may have been there before
    assert changed_cases(failing(case(15.0, -50.0)), entry, None)


@settings(max_examples=60)
@given(st.lists(st.tuples(st.floats(0.01, 20), st.integers(0, 12)), min_size=1, max_size=40))
def test_a_run_that_did_not_change_has_no_changed_cases(places: list[tuple[float, int]]) -> None:
    """Also if boxes of cases overlap, and if all but the costliest are forgotten."""
    now = failing(*(case(cost, 0.3 * at) for cost, at in sorted(places, reverse=True)))
    section = now.sections.failures
    assert section is not None
    kept = msgspec.structs.replace(section, cases=section.cases[:STORED_CASES])
    stored = replace(now, sections=msgspec.structs.replace(now.sections, failures=kept))
    assert changed_cases(now, stored, None) == []


@settings(max_examples=60)
@given(
    st.lists(st.tuples(st.floats(1.0, 20), st.integers(0, 12)), min_size=1, max_size=STORED_CASES,
             unique_by=lambda place: place[1]),
    st.integers(0, STORED_CASES - 1),
)  # fmt: skip
def test_of_cases_that_overlap_only_the_one_that_grew_is_listed(
    places: list[tuple[float, int]], which: int
) -> None:
    cases = [case(cost, 0.3 * at) for cost, at in sorted(places, reverse=True)]
    grown = which % len(cases)
    before = [replace_cost(each, 0.5 if k == grown else 1.0) for k, each in enumerate(cases)]
    found = changed_cases(failing(*cases), failing(*before), None)
    assert [each.number for each in found] == [grown + 1]
    assert found[0].before == pytest.approx(0.5 * cases[grown].cost)


def replace_cost(of: FailureCase, factor: float) -> FailureCase:
    return msgspec.structs.replace(of, cost=factor * of.cost)


def test_the_baseline_of_this_repository_has_causes_and_cases() -> None:
    entries = read_baseline(Path(__file__).parents[2] / "benchmarks/baseline.json")
    assert len(entries) > 8
    for entry in entries:
        section = entry.sections.failures
        assert section is not None
        assert section.causes
        costs = [each.cost for each in section.cases]
        assert 0 < len(costs) <= STORED_CASES
        assert costs == sorted(costs, reverse=True)
        assert all(each.cause and each.sentence for each in section.cases)


def test_reports_say_where(tmp_path: Path) -> None:
    before = failing(case(1.0))
    sections = msgspec.structs.replace(
        result((80, 20), (30, 20)).sections, failures=Failures((case(4.0),))
    )
    now = replace(cell(result(sections=sections)), file=tmp_path / "result.json")
    (tmp_path / "run.rrd").touch()
    checked = check([now], baseline=[before])
    (change,) = checked.cases["octomap on street"]
    assert change.recording == tmp_path / "run.rrd"
    text = markdown(checked)
    assert "| octomap on street | DA | 60.00 | 89.50 | 90.00 |" in text
    assert change.text in text
    assert f"`{change.command}`" in text
    failures = {
        each.get("name"): each.find("failure").text  # type: ignore[union-attr]
        for each in ElementTree.fromstring(junit_xml(checked)).iter("testcase")
        if each.find("failure") is not None
    }
    assert change.text in failures["DA"]
    assert change.text in failures["AA"]
    assert markdown(check([now], baseline=[now.result])).startswith("### Checks passed")
