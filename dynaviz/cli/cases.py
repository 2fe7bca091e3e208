"""Failure cases and clusters of removed points in the terminal, with hanging indents
at any width.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dynaviz.cli.console import print_json, show
from dynaviz.cli.options import run_in
from dynaviz.scores.failure_case import FailureCase
from dynaviz.scores.sections import Failures, RemovedCluster

if TYPE_CHECKING:
    from rich.console import RenderableType

    from dynaviz.scores.result import Result
    from dynaviz.scores.sections import Removals

TOP = 3  # listed after a run
RANKING = (
    "Ordered by suspicion, from 0 (looks like a mover) to 1 (looks like a static surface), times "
    "points."
)


def listing(cases: Sequence[FailureCase | RemovedCluster], details: bool = True) -> RenderableType:
    """Numbered cases: the cost or the suspicion, the sentence, and its numbers if ``details``."""
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(justify="right", no_wrap=True, style="bold")
    table.add_column(no_wrap=True, style="bold")
    table.add_column(overflow="fold")
    for number, case in enumerate(cases, 1):
        text = Text(case.sentence)
        if details:
            text.append(f"\n{_details(case)}", style="dim")
        table.add_row(str(number), _weight(case), text)
    return table


def top_of(result: Result, command: str) -> tuple[RenderableType, ...]:
    """The costliest failures of a run, or its most suspicious clusters without ground truth.

    Args:
        result: of the run.
        command: lists all of them.
    """
    cases = result.failures if result.has_truth else result.clusters
    if not cases:
        return ()
    what = "Costliest failures" if result.has_truth else "Removed points that look most suspicious"
    return f"[bold]{what}[/] ({command} lists all):", listing(cases[:TOP], details=False)


def _weight(case: FailureCase | RemovedCluster) -> str:
    return (
        f"-{case.cost:.2f} % {case.metric}"
        if isinstance(case, FailureCase)
        else f"{case.suspicion:.2f}"
    )


def _details(case: FailureCase | RemovedCluster) -> str:
    low, high = (" ".join(f"{x:.1f}" for x in corner) for corner in (case.low, case.high))
    frames = f"frames {case.first_frame} to {case.last_frame}, worst {case.worst_frame}"
    cause = f"{case.cause}: " if isinstance(case, FailureCase) and case.cause else ""
    return (
        f"{case.points:,} points, {frames}, from ({low}) to ({high}) m; "
        f"{cause}{main_reasons(case.reasons)}"
    )


def main_reasons(reasons: Mapping[str, int], most: int = 3) -> str:
    """The most frequent reasons with their shares."""
    total = sum(reasons.values())
    return ", ".join(
        f"{name} {100 * count / total:.0f}\N{NO-BREAK SPACE}%"
        for name, count in list(reasons.items())[:most]
    )


def show_failures(run: Path, top: int, json: Path | None) -> None:
    """Print the ``top`` costliest failure cases of a run.

    Without ground truth, clusters of removed points.
    """
    import msgspec

    section = _section(run)
    if print_json(msgspec.to_builtins(section), json):
        return
    show(*(_cases(section, top) if isinstance(section, Failures) else _clusters(section, top)))


def _cases(section: Failures, top: int) -> list[RenderableType]:
    if not section.cases:
        return ["No failure cases: no labelled point is wrong."]
    more = max(len(section.cases) - top, 0) + section.others.cases
    return [listing(section.cases[:top]), f"{more:,} more cases."]


def _clusters(section: Removals, top: int) -> list[RenderableType]:
    lines = ["There is no ground truth, so it is unknown which points are wrong."]
    if not section.removed:
        return [*lines, "No point was removed."]
    share = (
        f"{section.removed:,} of {section.points:,} points were removed ({section.percent:.2f} %)"
    )
    more = max(len(section.clusters) - top, 0) + section.others.cases
    found: list[RenderableType] = [*lines, f"{share}: {main_reasons(section.reasons)}."]
    if not section.clusters:
        return [
            *found,
            "The recording contains no clusters of removed points. Run the method again to find "
            "them.",
        ]
    found += [
        f"Clusters of removed points, most suspicious first. {RANKING}",
        listing(section.clusters[:top]),
    ]
    return [*found, f"{more:,} more clusters."]


def _section(run: Path) -> Failures | Removals:
    """The failures of a run, or its removals without ground truth, from its result file or its
    recording.
    """
    from dynaviz.errors import DataError
    from dynaviz.runs.run import open_run

    whole = (run / "result.json").is_file()  # then the recording is not needed
    result = open_run(run if whole else run_in(run)).result
    section = result.sections.failures if result.has_truth else result.sections.removals
    if section is None:
        problem = (
            "has no failure cases"
            if result.has_truth
            else "has no ground truth and no section on removed points"
        )
        raise DataError(run, problem, hint="Run the method again")
    return section
