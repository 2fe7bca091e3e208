"""Results against limits and a baseline: what falls, what is refused, what is only told."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynaviz.errors import DataError, UsageError
from dynaviz.results.collect import StudyRun, collect
from dynaviz.results.regression import (
    BaselineEntry,
    CheckOutcome,
    RegressionCheck,
    check,
    read_baseline,
    write_baseline,
)
from dynaviz.results.result import Result

Command = Callable[..., tuple[int, str, str]]


def result(static: tuple[int, int] = (80, 20), dynamic: tuple[int, int] = (45, 5), **changes: Any) -> Result:
    """A result by hand: static points kept and removed, dynamic ones removed and kept."""
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
        "sequence": {"name": "street", "digest": "d1", "frames": 5, "points": 150},
        "sections": {"metrics": metrics, "counts": dict(zip(names, (*static, *dynamic), strict=True))},
        "runtime": {"mean_s": 0.5},
    }
    return Result(**(values | changes))


def cell(result: Result | None, error: str | None = None, method: str = "octomap") -> StudyRun:
    return StudyRun(Path("result.json"), result, error, method, "street", "", Path())


def verdicts(found: RegressionCheck) -> dict[str, str]:
    return {finding.what: finding.verdict.name for finding in found.findings}


def test_limits() -> None:
    found = check([cell(result())], [("SA", 80.0), ("DA", 90.1), ("DA", 90.0)])
    assert [(f.what, f.verdict, f.value, f.limit) for f in found.findings] == [
        ("DA", CheckOutcome.FELL, 90.0, 90.1),
        ("SA", CheckOutcome.HOLDS, 80.0, 80.0),
        ("DA", CheckOutcome.HOLDS, 90.0, 90.0),
    ]
    assert found.fallen[0].counts["dynamic_kept"] == (5, None)


@pytest.mark.parametrize(
    ("static", "dynamic", "why"), [((9, 1), (0, 0), "labelled as dynamic"), ((0, 0), (9, 1), "labelled as static")]
)
def test_what_is_undefined_falls(static: tuple[int, int], dynamic: tuple[int, int], why: str) -> None:
    (fallen,) = check([cell(result(static, dynamic))], [("AA", 0.0)]).fallen
    assert (fallen.value, why in fallen.remark) == (None, True)
    found = check([cell(result(static, dynamic))], baseline=[BaselineEntry.of(result())])
    assert {f.what for f in found.fallen} >= {"AA", "HA"}
    again = check([cell(result(static, dynamic))], baseline=[BaselineEntry.of(result(static, dynamic))])
    assert not again.fallen


def test_a_metric_that_does_not_exist_is_a_mistake() -> None:
    with pytest.raises(UsageError, match=r"FOO.*SA, DA, AA, HA"):
        check([cell(result())], [("FOO", 1.0)])


percent = st.floats(0, 100)


@given(percent, percent, st.floats(0, 5))
def test_it_falls_by_more_than_the_tolerance(now: float, before: float, tolerance: float) -> None:
    new, old = ({"metrics": dict.fromkeys(("SA", "DA", "AA", "HA"), x)} for x in (now, before))
    found = check([cell(result(sections=new))], baseline=[BaselineEntry.of(result(sections=old))], tolerance=tolerance)
    told = {f.verdict for f in found.findings if f.what != "s/frame"}
    if abs(abs(now - before) - tolerance) > 1e-6:
        assert told == {CheckOutcome.HOLDS if abs(now - before) < tolerance else CheckOutcome(int(now > before))}


def test_changes_of_counts_and_of_the_runtime_are_told() -> None:
    before = BaselineEntry.of(result(runtime={"mean_s": 0.1}))
    found = check([cell(result((70, 30), (50, 0)))], baseline=[before])
    assert verdicts(found) == {"SA": "FELL", "DA": "BETTER", "AA": "FELL", "HA": "FELL", "s/frame": "TOLD"}
    assert found.fallen[0].counts["static_removed"] == (30, 10)
    told = found.findings[-1]
    assert (told.value, told.limit) == (0.5, 0.1)


def test_other_data_and_other_scorings_are_refused() -> None:
    other = {"name": "street", "digest": "d2", "frames": 5, "points": 149}
    with pytest.raises(UsageError, match=r"other data.*d1 \(5 frames, 150 points\).*d2 \(5 frames, 149 points\)"):
        check(
            [cell(result())],
            baseline=[BaselineEntry.of(result(sequence=other)), BaselineEntry.of(result(method="erasor"))],
        )
    with pytest.raises(UsageError, match="mask, the baseline nn"):
        check([cell(result())], baseline=[BaselineEntry.of(result(scoring="nn"))])
    with pytest.raises(UsageError, match="other data"):  # the result of one run against that of another
        check([cell(result())], baseline=[BaselineEntry.of(result(sequence=other | {"name": "hall"}, method="erasor"))])


def test_of_several_entries_the_one_that_agrees_is_taken() -> None:
    good, bad = result(), result((1, 99))
    baseline = [
        BaselineEntry.of(replace(bad, sequence={**bad.sequence, "digest": "d2"})),
        BaselineEntry.of(replace(bad, scoring="nn")),
        BaselineEntry.of(replace(bad, parameters={"resolution": 0.2})),
        BaselineEntry.of(replace(bad, variant="fine")),
        BaselineEntry.of(replace(bad, online=True)),
        BaselineEntry.of(good),
    ]
    for order in (baseline, baseline[::-1]):
        found = check([cell(good)], baseline=order)
        assert "BETTER" not in verdicts(found).values()
        assert not found.fallen


def test_a_sequence_may_be_renamed_and_parameters_may_change() -> None:
    renamed = result(sequence={**result().sequence, "name": "road"}, parameters={"resolution": 0.3})
    found = check(
        [cell(renamed), cell(result(method="new"))],
        baseline=[BaselineEntry.of(result()), BaselineEntry.of(result(method="x"))],
    )
    told = {(f.run, f.what): f.remark for f in found.findings if f.verdict is CheckOutcome.TOLD and f.remark}
    assert told[("octomap on road", "parameters")] == "resolution 0.1 -> 0.3"
    assert told[("new on street", "run")] == "is not in the baseline"
    assert not found.fallen


def test_what_failed_or_is_missing_falls() -> None:
    baseline = [BaselineEntry.of(result()), BaselineEntry.of(result(method="erasor"))]
    cells = [cell(None, "no memory", "erasor")]
    found = check(cells, [("AA", 1.0)], baseline, complete=True)
    assert {f.run: f.remark for f in found.fallen} == {
        "erasor on street": "failed: no memory",
        "octomap on street": "is in the baseline, but has no result",
    }
    assert len(check(cells, baseline=baseline).fallen) == 1


def test_a_variant_that_failed_hides_no_other_that_is_missing() -> None:
    baseline = [BaselineEntry.of(result(variant=variant)) for variant in ("", "fine", "coarse")]
    cells = [replace(cell(None, "no memory"), variant="fine"), cell(result())]
    assert {f.run: f.remark for f in check(cells, baseline=baseline, complete=True).fallen} == {
        "octomap (fine) on street": "failed: no memory",
        "octomap (coarse) on street": "is in the baseline, but has no result",
    }


def test_what_sets_a_run_apart_is_said_once() -> None:
    labels = [BaselineEntry.of(result(variant=variant, online=True)).label for variant in ("online", "fine", "")]
    assert labels == ["octomap (online) on street", "octomap (fine) (online) on street", "octomap (online) on street"]


def test_a_baseline_survives_its_file(tmp_path: Path) -> None:
    results = [result(method="b"), result((0, 0), method="a", variant="fine"), result(method="b")]
    write_baseline(tmp_path / "b.json", results)
    text = (tmp_path / "b.json").read_text()
    assert [line.count('"method": ') for line in text.splitlines()] == [0, 1, 1, 0]
    assert "mean_s" not in text
    entries = read_baseline(tmp_path / "b.json")
    assert entries == [replace(BaselineEntry.of(r), mean_s=None) for r in (results[1], results[0])]
    with pytest.raises(UsageError, match="b on street differ"):
        write_baseline(tmp_path / "c.json", [*results, result((1, 1), method="b")])


@pytest.mark.parametrize(
    ("content", "says"),
    [("{", "not JSON"), ("[]", "not the result"), ('{"baseline": 9}', "newer"), ('{"baseline": 1}', "not a baseline")],
)
def test_files_that_are_no_baseline(tmp_path: Path, content: str, says: str) -> None:
    (tmp_path / "b.json").write_text(content)
    with pytest.raises(DataError, match=says):
        read_baseline(tmp_path / "b.json")


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """Two runs as a bench leaves them."""
    for name, static in (("octomap", (80, 20)), ("erasor", (95, 5))):
        result(static, method=name).save(tmp_path / "bench/street" / name / "result.json")
    return tmp_path / "bench"


def test_the_command(bench: Path, tmp_path: Path, run_command: Command) -> None:
    baseline = tmp_path / "baseline.json"
    code, out, err = run_command("check", bench, "--write-baseline", baseline)
    assert (code, "Written" in out) == (0, True), err
    code, out, _ = run_command("check", bench, "--baseline", baseline, "--min", "SA=80", "--min", "AA=80")
    assert (code, "all 12 hold" in out) == (0, True), out
    result((70, 30)).save(bench / "street/octomap/result.json")
    code, out, _ = run_command("check", bench, "--baseline", baseline)
    assert code == 1
    first = next(line for line in out.splitlines() if "FELL" in line)
    assert all(word in first for word in ("octomap on street", "SA", "70.00", "80.00", "-10.00", "FP 30 (+10)"))
    assert max(map(len, out.splitlines())) <= 80
    assert "fell" in out
    code, _, _ = run_command("check", bench, "--baseline", baseline, "--tolerance", 10.5)
    assert code == 0
    (bench / "street/octomap/result.json").unlink()
    (bench / "street/octomap/error.json").write_text(
        json.dumps({"method": "octomap", "sequence": "street", "error": "no memory"})
    )
    code, out, _ = run_command("check", bench, "--min", "SA=1", "--write-baseline", tmp_path / "never.json")
    assert (code, "failed: no memory" in out, (tmp_path / "never.json").exists()) == (1, True, False)


def test_an_improvement_is_told(bench: Path, tmp_path: Path, run_command: Command) -> None:
    run_command("check", bench, "--write-baseline", tmp_path / "b.json")
    result((90, 10)).save(bench / "street/octomap/result.json")
    code, out, _ = run_command("check", bench, "--baseline", tmp_path / "b.json")
    assert code == 0
    assert "+10.00" in out
    assert "consider updating the baseline" in out


@pytest.mark.parametrize(
    "typed",
    ["check {}", "check {} --min AA", "check {} --min FOO=1", "check absent --min AA=1", "check {} --baseline absent"],
)
def test_a_mistake_is_answered_in_one_line(bench: Path, run_command: Command, typed: str) -> None:
    code, _, err = run_command(*(word.format(bench) for word in typed.split()))
    assert (code, err.count("\n")) == (2, 1), err


def test_cells_of_a_bench_are_found(bench: Path) -> None:
    assert sorted(cell.method for cell in collect([bench])) == ["erasor", "octomap"]
