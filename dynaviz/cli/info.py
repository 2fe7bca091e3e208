"""dynaviz info."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Protocol, runtime_checkable

import typer

from dynaviz.cli.console import progress, show
from dynaviz.cli.options import Deskew, PointsIn, Poses, open_sequence

if TYPE_CHECKING:
    from dynaviz.results.result import Result
    from dynaviz.scan import Sequence


@runtime_checkable
class HasFacts(Protocol):
    """A sequence with further facts, such as the topic of a bag or the number of tracks."""

    @property
    def facts(self) -> Mapping[str, str]:
        """Name and value, as ``dynaviz info`` shows them."""
        ...


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("info")(info)


def info(
    path: Annotated[
        str,
        typer.Argument(metavar="SEQ|RUN.rrd|RESULT.json", help="Sequence (FORMAT:PATH forces the format) or file."),
    ],
    poses: Poses = None,
    points_in: PointsIn = None,
    deskew: Deskew = None,
) -> None:
    """Describe a sequence, a recording or a result.

    For a sequence this shows the detected format, the sensor, the numbers of frames and points, and the extent.

    \b
    dynaviz info path/to/sequence
    dynaviz info path/to/scans --poses trajectory.tum
    dynaviz info recordings/demo/octomap/run.rrd
    dynaviz info recordings/demo/octomap/result.json
    """
    from dynaviz.io.lock import unfinished

    suffix = Path(path).suffix
    if suffix == ".json":
        from dynaviz.results.result import Result

        _show_result(Result.load(path))
    elif suffix == ".rrd" or path.endswith(".rrd.part"):
        from dynaviz.viz.reader import RunRecording, read

        recording = read(path)
        _show_pairs(path, recording.facts())
        if isinstance(recording, RunRecording) and recording.result is not None:
            _show_result(recording.result)
    else:
        if left := unfinished(Path(path)):
            raise left
        _show_pairs(path, _sequence_facts(open_sequence(path, poses=poses, points_in=points_in, deskew=deskew)))


def _show_result(result: Result) -> None:
    from rich.table import Table

    from dynaviz.results.sections import Reasons, Removals

    show(result)
    reasons, removals = result.sections.reasons or Reasons(), result.sections.removals or Removals()
    found = [
        ("Static points removed, by reason", reasons.false_positive),
        ("Dynamic points kept, by reason", reasons.false_negative),
        ("Points removed, by reason", {} if result.has_truth else removals.reasons),
    ]
    for title, counts in found:
        table = Table("reason", "points", box=None)
        for name, count in sorted(counts.items(), key=lambda pair: -pair[1]):
            table.add_row(name, f"{count:,}")
        if table.row_count:
            show(f"\n{title}", table)


def _sequence_facts(sequence: Sequence) -> dict[str, str]:
    from dynaviz.engine.summary import summarize

    with progress(sequence.name) as report:
        summary = summarize(sequence, lambda done: report("read", done, len(sequence)))
    low, high = summary.extent.low, summary.extent.high
    return {
        "name": sequence.name,
        "format": type(sequence).__name__,
        "sensor": f"{sequence.sensor.name} ({sequence.sensor.title})",
        "frames": f"{summary.frames:,}",
        "points": f"{summary.points:,} ({summary.points // max(summary.frames, 1):,} per frame)",
        "ground truth": "yes" if sequence.has_labels else "no",
        "extent": " x ".join(f"{size:.1f}" for size in high - low) + " m",
        "low corner": " ".join(f"{x:.2f}" for x in low) + " m",
        "digest": summary.digest,
        **(sequence.facts if isinstance(sequence, HasFacts) else {}),
    }


def _show_pairs(title: str, facts: dict[str, str]) -> None:
    from rich.table import Table

    table = Table("name", "value", title=title, title_justify="left", show_header=False)
    for name, value in facts.items():
        table.add_row(name, value)
    show(table)
