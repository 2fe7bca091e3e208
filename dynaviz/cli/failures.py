"""dynaviz failures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynaviz.cli.console import show

if TYPE_CHECKING:
    from dynaviz.results.sections import Failures


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("failures")(failures)


def failures(
    run: Annotated[Path, typer.Argument(metavar="RUN.rrd|RESULT.json", help="Recording or result of a run.")],
    top: Annotated[int, typer.Option(min=1, metavar="N", help="Number of cases to list.")] = 20,
    out: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Also write all cases to a JSON file.")
    ] = None,
) -> None:
    """List the failure cases of a run, costliest first.

    Each case has its position, its frames, its number of points, and the reasons for the errors.

    \b
    dynaviz failures recordings/demo/octomap/run.rrd
    dynaviz failures recordings/demo/octomap/result.json --top 5 --json failures.json
    """
    import json

    import msgspec
    from rich.markup import escape

    from dynaviz.io.atomic import write_atomic

    section = _section(run)
    for number, case in enumerate(section.cases[:top], 1):
        low, high = (" ".join(f"{x:.1f}" for x in getattr(case, corner)) for corner in ("low", "high"))
        frames = f"frames {case.first_frame} to {case.last_frame}, worst {case.worst_frame}"
        show(
            f"[bold]{number:>3}  -{case.cost:.2f} % {case.metric}[/]  {escape(case.sentence)}",
            f"     [dim]{case.points:,} points, {frames}, from ({low}) to ({high}) m; {_main_reasons(case.reasons)}[/]",
        )
    more = max(len(section.cases) - top, 0) + section.others.cases
    show(f"{more:,} more cases." if section.cases else "No failure cases: no point is wrong.")
    if out:
        write_atomic(out, json.dumps(msgspec.to_builtins(section), indent=1, allow_nan=False).encode())


def _section(run: Path) -> Failures:
    """The failures of a run, from its result file or its recording."""
    from dynaviz.errors import DataError
    from dynaviz.results.result import Result

    if run.suffix == ".rrd":
        from dynaviz.viz.failures import failures_of

        return failures_of(run)
    result = Result.load(run)
    if result.metrics.get("SA") is None and result.metrics.get("DA") is None:
        hint = "Run the method on a sequence with ground truth"
        raise DataError(run, "the sequence has no ground truth, so failures cannot be computed", hint=hint)
    section = result.sections.failures
    if section is None:
        raise DataError(run, "has no failure cases", hint="Run the method again, or give its run.rrd")
    return section


def _main_reasons(reasons: Mapping[str, int]) -> str:
    total = sum(reasons.values())
    return ", ".join(f"{name} {100 * count / total:.0f} %" for name, count in list(reasons.items())[:3])
