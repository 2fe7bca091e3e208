"""The failure cases of a run in the terminal."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from dynaviz.cli.console import print_json, show
from dynaviz.cli.options import run_in

if TYPE_CHECKING:
    from rich.console import RenderableType

    from dynaviz.scores.sections import Failures, Removals


def show_failures(run: Path, top: int, json: Path | None) -> None:
    """Print the ``top`` costliest failure cases of a run; without ground truth, clusters of removed points."""
    import msgspec

    from dynaviz.scores.sections import Failures

    section = _section(run)
    if print_json(msgspec.to_builtins(section), json):
        return
    show(*(_cases(section, top) if isinstance(section, Failures) else _clusters(section, top)))


def _cases(section: Failures, top: int) -> list[RenderableType]:
    from dynaviz.cli.cases import listing

    if not section.cases:
        return ["No failure cases: no labelled point is wrong."]
    more = max(len(section.cases) - top, 0) + section.others.cases
    return [listing(section.cases[:top]), f"{more:,} more cases."]


def _clusters(section: Removals, top: int) -> list[RenderableType]:
    from dynaviz.cli.cases import RANKING, listing, main_reasons

    lines = ["There is no ground truth, so it is unknown which points are wrong."]
    if not section.removed:
        return [*lines, "No point was removed."]
    share = f"{section.removed:,} of {section.points:,} points were removed ({section.percent:.2f} %)"
    more = max(len(section.clusters) - top, 0) + section.others.cases
    found: list[RenderableType] = [*lines, f"{share}: {main_reasons(section.reasons)}."]
    if not section.clusters:
        return [*found, "The recording contains no clusters of removed points. Run the method again to find them."]
    found += [f"Clusters of removed points, most suspicious first. {RANKING}", listing(section.clusters[:top])]
    return [*found, f"{more:,} more clusters."]


def _section(run: Path) -> Failures | Removals:
    """The failures of a run, or its removals without ground truth, from its result file or its recording."""
    from dynaviz.errors import DataError
    from dynaviz.runs.run import open_run

    whole = (run / "result.json").is_file()  # then the recording is not needed
    result = open_run(run if whole else run_in(run)).result
    section = result.sections.failures if result.has_truth else result.sections.removals
    if section is None:
        problem = "has no failure cases" if result.has_truth else "has no ground truth and no section on removed points"
        raise DataError(run, problem, hint="Run the method again")
    return section
