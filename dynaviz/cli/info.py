"""dynaviz info."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynaviz.cli.console import progress, show
from dynaviz.cli.options import Deskew, PointsIn, Poses, open_sequence

if TYPE_CHECKING:
    from dynaviz.results.result import Result
    from dynaviz.scan import Sequence


def add_to(app: typer.Typer) -> None:
    """Register the verb."""
    app.command("info")(info)


def info(
    what: Annotated[str, typer.Argument(metavar="SEQ|RUN.rrd|RESULT.json")],
    poses: Poses = None,
    points_in: PointsIn = None,
    deskew: Deskew = None,
) -> None:
    """Say what a sequence, a recording or a result is.

    \b
    dynaviz info path/to/sequence
    dynaviz info path/to/scans --poses trajectory.tum
    dynaviz info recordings/demo/octomap/run.rrd
    dynaviz info recordings/demo/octomap/result.json
    """
    suffix = Path(what).suffix
    if suffix == ".json":
        from dynaviz.results.result import Result

        _show_result(Result.load(what))
    elif suffix == ".rrd" or what.endswith(".rrd.part"):
        from dynaviz.viz.reader import RunRecording, read

        recording = read(what)
        _show_pairs(what, recording.facts())
        if isinstance(recording, RunRecording) and recording.result is not None:
            _show_result(recording.result)
    else:
        _show_pairs(what, _sequence_facts(open_sequence(what, poses=poses, points_in=points_in, deskew=deskew)))


def _show_result(result: Result) -> None:
    from rich.table import Table

    show(result)
    reasons = result.sections.get("reasons", {})
    for outcome, meaning in (("false_positive", "static points removed"), ("false_negative", "dynamic points kept")):
        table = Table("reason", "points", box=None)
        for name, count in sorted(reasons.get(outcome, {}).items(), key=lambda pair: -pair[1]):
            table.add_row(name, f"{count:,}")
        if table.row_count:
            show(f"\n{meaning}, by reason", table)


def _sequence_facts(sequence: Sequence) -> dict[str, str]:
    from dynaviz.engine.summary import summarize

    with progress(sequence.name) as tell:
        seen = summarize(sequence, lambda done: tell("reading", done, len(sequence)))
    low, high = seen.extent.low, seen.extent.high
    return {
        "name": sequence.name,
        "format": type(sequence).__name__,
        "sensor": f"{sequence.sensor.name} ({sequence.sensor.title})",
        "frames": f"{seen.frames:,}",
        "points": f"{seen.points:,} ({seen.points // max(seen.frames, 1):,} a frame)",
        "ground truth": "yes" if sequence.has_labels else "no",
        "extent": " x ".join(f"{size:.1f}" for size in high - low) + " m",
        "low corner": " ".join(f"{x:.2f}" for x in low) + " m",
        "digest": seen.digest,
        **getattr(sequence, "facts", {}),
    }


def _show_pairs(title: str, facts: dict[str, str]) -> None:
    from rich.table import Table

    table = Table("what", "value", title=title, title_justify="left", show_header=False)
    for name, value in facts.items():
        table.add_row(name, value)
    show(table)
