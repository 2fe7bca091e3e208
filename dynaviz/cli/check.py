"""dynaviz check."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynaviz.cli.console import show

if TYPE_CHECKING:
    from rich.table import Table

    from dynaviz.results.regression import CheckedValue, RegressionCheck

ROWS = 40  # of a table; what holds is only counted beyond


def add_to(app: typer.Typer) -> None:
    """Register the verb."""
    app.command("check")(check)


def check(
    results: Annotated[
        list[Path], typer.Argument(metavar="RESULT.json|DIR...", help="Results, or folders with results below them.")
    ],
    minima: Annotated[
        list[str] | None,
        typer.Option("--min", metavar="METRIC=PERCENT", help="The least value of a metric; may be repeated."),
    ] = None,
    baseline: Annotated[
        Path | None, typer.Option(help="What results were: a baseline, or the result.json of an earlier run.")
    ] = None,
    tolerance: Annotated[
        float, typer.Option(min=0.0, help="Percentage points by which SA, DA, AA and HA may be lower.")
    ] = 0.5,
    write_baseline: Annotated[
        Path | None, typer.Option(metavar="F", help="Write a baseline of these results, unless one falls.")
    ] = None,
) -> None:
    """Say whether results are good enough, and what fell: exit 0 or 1, for CI.

    \b
    dynaviz check recordings/street/octomap/result.json --min AA=90 --min SA=95
    dynaviz check new/result.json --baseline old/result.json --tolerance 0.5
    dynaviz check bench --write-baseline baseline.json
    dynaviz check bench --baseline baseline.json
    """
    from dynaviz.errors import UsageError
    from dynaviz.results import regression as core
    from dynaviz.results.collect import collect

    if not minima and baseline is None and write_baseline is None:
        raise UsageError("nothing to check: give --min METRIC=PERCENT or --baseline FILE")
    limits = [_limit(text) for text in minima or []]
    old = None if baseline is None else core.read_baseline(baseline)
    cells = collect(results)
    found = core.check(cells, limits, old, tolerance, complete=any(path.is_dir() for path in results))
    if found.findings:
        show(*_lines(found, fell=True), table(found), *_lines(found, fell=False), _verdict(found, len(cells), baseline))
    if found.fallen:
        raise typer.Exit(1)
    if write_baseline is not None:
        core.write_baseline(write_baseline, (cell.result for cell in cells if cell.result))
        show(f"Written to {write_baseline}.")


def _limit(text: str) -> tuple[str, float]:
    from dynaviz.errors import UsageError

    name, _, value = text.partition("=")
    try:
        return name.strip(), float(value)
    except ValueError:
        raise UsageError(f"--min {text}: give a metric and its least value in percent, as AA=90") from None


def _verdict(found: RegressionCheck, results: int, baseline: Path | None) -> str:
    from dynaviz.results.regression import CheckOutcome

    compared = [f for f in found.findings if f.verdict is not CheckOutcome.TOLD]
    better = [f for f in found.findings if f.verdict is CheckOutcome.BETTER]
    head = f"{len(found.fallen)} of {len(compared)} fell" if found.fallen else f"all {len(compared)} hold"
    words = f"{results} result{'s' * (results != 1)}: {head}."
    if better:
        runs = len({finding.run for finding in better})
        words += f" {runs} run{'s are' if runs > 1 else ' is'} better; consider updating the baseline {baseline}."
    return words


def _lines(found: RegressionCheck, fell: bool) -> Iterator[str]:
    """What has no numbers: before the table if it fell, else after it."""
    from rich.markup import escape

    from dynaviz.results.regression import CheckOutcome

    for finding in found.findings:
        if finding.in_words and finding.remark and (finding.verdict is CheckOutcome.FELL) == fell:
            what = "" if finding.what == "run" else f" {finding.what}"
            yield ("[bold red]FELL[/]  " if fell else "") + escape(f"{finding.run}:{what} {finding.remark}")


def table(found: RegressionCheck) -> Table:
    """A row a number, failures first, in 80 columns."""
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    from dynaviz.results.regression import CheckOutcome

    looks = {CheckOutcome.FELL: "[bold red]FELL[/]", CheckOutcome.BETTER: "[green]better[/]", CheckOutcome.HOLDS: "ok"}
    rows = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, width=80)
    rows.caption, rows.caption_justify = "in %; FP: static points removed, FN: dynamic points kept", "left"
    rows.add_column("")
    rows.add_column("run", overflow="fold", ratio=1)
    rows.add_column("metric", no_wrap=True)
    for name in ("value", "limit", "diff"):
        rows.add_column(name, justify="right", no_wrap=True)
    rows.add_column("points", no_wrap=True)
    numbers = [finding for finding in found.findings if not finding.in_words]
    holds = [finding for finding in numbers if finding.verdict is CheckOutcome.HOLDS]
    hidden = holds[max(0, ROWS - len(numbers) + len(holds)) :]
    for finding in numbers:
        if not any(finding is other for other in hidden):
            look = looks.get(finding.verdict, "")
            rows.add_row(look, escape(finding.run), finding.what, *_numbers(finding), "\n".join(_words(finding)))
    if hidden:
        rows.caption = f"and {len(hidden)} that hold; {rows.caption}"
    return rows


def _numbers(finding: CheckedValue) -> tuple[str, str, str]:
    """Value, limit and their difference."""
    digits = 3 if finding.what == "s/frame" else 2
    value, limit = ("n/a" if x is None else f"{x:.{digits}f}" for x in (finding.value, finding.limit))
    if finding.value is None or finding.limit is None:
        return value, limit, ""
    return value, limit, f"{finding.value - finding.limit:+.{digits}f}"


SHORT = {"static_removed": "FP", "dynamic_kept": "FN"}
PARTS = {"SA": ("static_removed",), "DA": ("dynamic_kept",)}  # the counts that a metric falls by


def _words(finding: CheckedValue) -> Iterator[str]:
    from dynaviz.results.regression import CheckOutcome

    if finding.remark:
        yield finding.remark
    if finding.verdict in (CheckOutcome.FELL, CheckOutcome.BETTER):
        for part in PARTS.get(finding.what, tuple(SHORT)):
            if part in finding.counts:
                count, change = finding.counts[part]
                yield f"{SHORT[part]} {count:,}" + (f" ({change:+,})" if change else "")
