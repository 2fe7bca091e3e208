"""dynaviz check."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynaviz.cli.console import show

if TYPE_CHECKING:
    from rich.table import Table

    from dynaviz.scores.regression import CheckedValue, RegressionCheck

ROWS = 40  # rows of a table; passed checks beyond that are only counted


def check(
    results: Annotated[
        list[Path],
        typer.Argument(
            metavar="RESULT.json|DIR...", help="Result files, or folders to search for them."
        ),
    ],
    minima: Annotated[
        list[str] | None,
        typer.Option(
            "--min", metavar="METRIC=PERCENT", help="Minimum value of a metric. Repeatable."
        ),
    ] = None,
    baseline: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Earlier results: a baseline file, or the result.json of a run."
        ),
    ] = None,
    tolerance: Annotated[
        float,
        typer.Option(
            min=0.0,
            help="Allowed drop of SA, DA, AA and HA against the baseline, in percentage points.",
        ),
    ] = 0.5,
    write_baseline: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Write these results to a baseline file if all checks pass."
        ),
    ] = None,
    junit: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the checks as JUnit XML.")
    ] = None,
    markdown: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write them as Markdown, for the summary of a job."),
    ] = None,
) -> None:
    """Check results against limits or a baseline.

    Exit code 0: all checks passed, 1: a check failed, for use in CI. Cases
    that are new or cost more than in the baseline are listed.

    \b
    dynaviz check recordings/street/octomap/result.json --min AA=90 --min SA=95
    dynaviz check new/result.json --baseline old/result.json --tolerance 0.5
    dynaviz check bench --write-baseline baseline.json
    dynaviz check bench --baseline baseline.json --junit checks.xml
    """
    from dynaviz.errors import UsageError
    from dynaviz.scores import regression as core
    from dynaviz.scores.collect import collect

    if not minima and baseline is None and write_baseline is None:
        raise UsageError("nothing to check. Give --min METRIC=PERCENT or --baseline FILE")
    limits = [_limit(text) for text in minima or []]
    entries = None if baseline is None else core.read_baseline(baseline)
    cells = collect(results)
    checked = core.check(
        cells, limits, entries, tolerance, complete=any(path.is_dir() for path in results)
    )
    if checked.values:
        show(*_remarks(checked, failed=True), table(checked), *_remarks(checked, failed=False))
        show(*_changes(checked), _summary(checked, len(cells), baseline))
    _write(checked, junit, markdown)
    if checked.failed:
        raise typer.Exit(1)
    if write_baseline is not None:
        core.write_baseline(write_baseline, (cell.result for cell in cells if cell.result))
        show(f"Written to {write_baseline}.")


def _write(checked: RegressionCheck, junit: Path | None, markdown: Path | None) -> None:
    """Write the files that were asked for."""
    from dynaviz.io.atomic import write_atomic
    from dynaviz.scores import check_reports

    if junit is not None:
        write_atomic(junit, check_reports.junit_xml(checked))
    if markdown is not None:
        write_atomic(markdown, check_reports.markdown(checked).encode())


def _changes(checked: RegressionCheck) -> Iterator[str]:
    """The cases that are new or grew, and how to look at each."""
    from rich.markup import escape

    for run, changes in checked.cases.items():
        yield escape(f"{run}: cases that are new or cost more")
        for change in changes:
            yield escape(f"  {change.text}")
            if change.command is not None:
                yield escape(f"    {change.command}")


def _limit(text: str) -> tuple[str, float]:
    from dynaviz.errors import UsageError

    name, _, value = text.partition("=")
    try:
        return name.strip(), float(value)
    except ValueError:
        raise UsageError(
            f"--min {text}: give a metric and its minimum in percent, such as AA=90"
        ) from None


def _summary(checked: RegressionCheck, results: int, baseline: Path | None) -> str:
    """The closing line: how many checks failed, and whether the baseline could be raised."""
    from dynaviz.scores.regression import CheckOutcome

    total = sum(value.outcome is not CheckOutcome.INFO for value in checked.values)
    improved = {value.run for value in checked.values if value.outcome is CheckOutcome.IMPROVED}
    failed = len(checked.failed)
    head = (
        f"{failed} of {_counted(total, 'check')} failed"
        if failed
        else f"all {_counted(total, 'check')} passed"
    )
    text = f"{_counted(results, 'result')}: {head}."
    if improved:
        text += (
            f" {_counted(len(improved), 'run')} improved; consider updating the baseline "
            f"{baseline}."
        )
    return text


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _remarks(checked: RegressionCheck, failed: bool) -> Iterator[str]:
    """Lines for the entries without numbers.

    Failures are shown above the table, all others below it.
    """
    from rich.markup import escape

    from dynaviz.scores.regression import CheckOutcome

    for value in checked.values:
        if value.is_text and value.remark and (value.outcome is CheckOutcome.FAILED) == failed:
            name = "" if value.name == "run" else f" {value.name}"
            yield ("[bold red]FAIL[/]  " if failed else "") + escape(
                f"{value.run}:{name} {value.remark}"
            )


def table(checked: RegressionCheck) -> Table:
    """One row per number, failures first, in 80 columns."""
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    from dynaviz.scores.regression import CheckOutcome

    styles = {
        CheckOutcome.FAILED: "[bold red]FAIL[/]",
        CheckOutcome.IMPROVED: "[green]improved[/]",
        CheckOutcome.PASSED: "ok",
    }
    rows = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, width=80)
    rows.caption = "In %. FP: static points removed, FN: dynamic points kept."
    rows.caption_justify = "left"
    rows.add_column("")
    rows.add_column("run", overflow="fold", ratio=1)
    rows.add_column("metric", no_wrap=True)
    for name in ("value", "limit", "before", "diff"):
        rows.add_column(name, justify="right", no_wrap=True)
    rows.add_column("points", no_wrap=True)
    numbers = [value for value in checked.values if not value.is_text]
    passed = [value for value in numbers if value.outcome is CheckOutcome.PASSED]
    hidden = passed[max(0, ROWS - len(numbers) + len(passed)) :]
    for value in numbers:
        if not any(value is other for other in hidden):
            style = styles.get(value.outcome, "")
            rows.add_row(
                style, escape(value.run), value.name, *_numbers(value), "\n".join(_points(value))
            )
    if hidden:
        rows.caption = f"{len(hidden)} more passed. {rows.caption}"
    return rows


def _numbers(checked: CheckedValue) -> tuple[str, str, str, str]:
    """Value, limit, value before, and the difference from that, or else from the limit."""
    digits = 3 if checked.name == "s/frame" else 2
    numbers = (checked.value, checked.limit, checked.before)
    value, limit, before = ("" if x is None else f"{x:.{digits}f}" for x in numbers)
    against = checked.limit if checked.before is None else checked.before
    if checked.value is None or against is None:
        return value or "n/a", limit, before, ""
    return value, limit, before, f"{checked.value - against:+.{digits}f}"


SHORT = {"static_removed": "FP", "dynamic_kept": "FN"}
ERRORS = {"SA": ("static_removed",), "DA": ("dynamic_kept",)}  # the counts that lower a metric


def _points(checked: CheckedValue) -> Iterator[str]:
    """The remark, and for a change the number of wrong points with its difference from the
    baseline.
    """
    from dynaviz.scores.regression import CheckOutcome

    if checked.remark:
        yield checked.remark
    if checked.outcome in (CheckOutcome.FAILED, CheckOutcome.IMPROVED):
        for name in ERRORS.get(checked.name, tuple(SHORT)):
            if name in checked.counts:
                count, change = checked.counts[name]
                yield f"{SHORT[name]} {count:,}" + (f" ({change:+,})" if change else "")
