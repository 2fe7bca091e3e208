"""dynaviz failures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from dynaviz.cli.console import show


def add_to(app: typer.Typer) -> None:
    """Register the verb."""
    app.command("failures")(failures)


def failures(
    run: Annotated[Path, typer.Argument(metavar="RUN.rrd|RESULT.json")],
    top: Annotated[int, typer.Option(min=1, help="How many cases.")] = 20,
    out: Annotated[Path | None, typer.Option("--json", metavar="F", help="Write all cases to a file as well.")] = None,
) -> None:
    """List the failure cases of a run, costliest first: where, when, how many points, why.

    \b
    dynaviz failures recordings/demo/octomap/run.rrd
    dynaviz failures recordings/demo/octomap/result.json --top 5 --json failures.json
    """
    import json

    from rich.markup import escape

    from dynaviz.io.atomic import write_atomic

    section = _section(run)
    for number, case in enumerate(section["cases"][:top], 1):
        low, high = (" ".join(f"{x:.1f}" for x in case[corner]) for corner in ("low", "high"))
        score = "DA" if case["kind"] == "false_negative" else "SA"
        frames = f"frames {case['first_frame']} to {case['last_frame']}, look at {case['worst_frame']}"
        show(
            f"[bold]{number:>3}  -{case['cost']:.2f} % {score}[/]  {escape(case['sentence'])}",
            f"     [dim]{case['points']:,} points, {frames}, from ({low}) to ({high}) m; {_most(case['reasons'])}[/]",
        )
    others = section["others"]
    more = max(len(section["cases"]) - top, 0) + others["cases"]
    show(f"{more:,} more cases." if section["cases"] else "No failure case: no wrong point.")
    if out:
        write_atomic(out, json.dumps(section, indent=1, allow_nan=False).encode())


def _section(run: Path) -> dict[str, Any]:
    """The section of a result, from its own file or from a recording."""
    from dynaviz.errors import DataError
    from dynaviz.results.result import Result

    if run.suffix == ".rrd":
        from dynaviz.viz.failures import failures_of

        return failures_of(run)
    result = Result.load(run)
    if result.metrics.get("SA") is None and result.metrics.get("DA") is None:
        hint = "Run the method on a sequence with ground truth"
        raise DataError(run, "is of a sequence without ground truth, so nobody knows what is wrong", hint=hint)
    section: dict[str, Any] | None = result.sections.get("failures")
    if section is None:
        raise DataError(run, "was written without failure cases", hint="Run the method again, or give its run.rrd")
    return section


def _most(reasons: dict[str, int]) -> str:
    total = sum(reasons.values())
    return ", ".join(f"{name} {100 * count / total:.0f} %" for name, count in list(reasons.items())[:3])
