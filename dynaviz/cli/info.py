"""dynaviz info."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dynaviz.cli.console import print_json, progress, show
from dynaviz.cli.options import (
    SEQUENCE,
    Json,
    Quiet,
    open_posed_or_not,
    proposal,
    recording_in,
    refuse,
    takes,
)
from dynaviz.errors import UsageError

if TYPE_CHECKING:
    from dynaviz.arrays import F64
    from dynaviz.contracts.scan import Scan, Sequence
    from dynaviz.scores.result import Result
    from dynaviz.sources.drive import Drive


@takes(SEQUENCE)
def info(
    path: Annotated[
        str,
        typer.Argument(
            metavar="SEQ|RUN",
            help="Sequence (FORMAT:PATH forces the format), or a run: folder or file.",
        ),
    ],
    failures: Annotated[
        bool, typer.Option("--failures", help="List the failure cases of a run, costliest first.")
    ] = False,
    top: Annotated[
        int | None,
        typer.Option(
            min=1, metavar="N", help="With --failures: number of cases to list. [default: 20]"
        ),
    ] = None,
    json: Json = None,
    quiet: Quiet = False,
    *,
    options: dict[str, Any],
) -> None:
    """Describe a sequence or a run, or list the failures of a run.

    For a sequence this shows the detected format, the sensor, the numbers of frames and points, the
    distance travelled, the rate, the share of dynamic points, and the extent.

    \b
    dynaviz info path/to/sequence
    dynaviz info path/to/scans --poses trajectory.tum
    dynaviz info recordings/demo/octomap/run.rrd
    dynaviz info recordings/demo/octomap/result.json
    dynaviz info recordings/demo/octomap --failures

    Each failure case has its position, its frames, its number of points, and the reasons for the
    errors. For a run without ground truth, --failures lists clusters of removed points that look
    suspicious.
    """
    if failures:
        refuse(options, "--failures")
        from dynaviz.cli.cases import show_failures

        show_failures(Path(path), top or 20, json)
        return
    if top is not None:
        raise UsageError("--top: only with --failures")
    from dynaviz.io.lock import unfinished

    if (Path(path) / "result.json").is_file():
        path = str(Path(path) / "result.json")
    suffix = Path(path).suffix
    if suffix == ".json":
        from dynaviz.scores.result import Result

        result = Result.load(path)
        if not print_json(result.to_dict(), json):
            _show_result(result)
    elif suffix == ".rrd" or path.endswith(".rrd.part"):
        from dynaviz.views.read.reader import RunRecording, read

        path = str(recording_in(Path(path)))
        recording = read(path)
        if print_json(recording.facts(), json):
            return
        _show_pairs(path, recording.facts())
        if isinstance(recording, RunRecording) and recording.result is not None:
            _show_result(recording.result)
    else:
        if left := unfinished(Path(path)):
            raise left
        opened, unposed = open_posed_or_not(path, options)
        facts = _sequence_facts(opened)
        if unposed:
            facts |= {
                "poses": f"none: {unposed}",
                "distance": "unknown",
                "extent": "unknown",
                "low corner": "unknown",
            }
        if not print_json(facts, json):
            _show_pairs(path, facts)
            if unposed:
                show(f"Estimate the poses and clean the map with: {proposal(path)}")


def _show_result(result: Result) -> None:
    from rich.table import Table

    from dynaviz.scores.sections import Reasons, Removals

    show(result)
    reasons = result.sections.reasons or Reasons()
    removals = result.sections.removals or Removals()
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


def _sequence_facts(sequence: Drive) -> dict[str, str]:
    from dynaviz.sources.summary import summarize

    with progress(sequence.name) as report:
        counted = _Counted(sequence)
        summary = summarize(counted, lambda done: report("read", done, len(sequence)))
    low = summary.extent.low
    high = summary.extent.high
    return {
        "name": sequence.name,
        "format": sequence.reader.format,
        "sensor": _sensor(sequence),
        "frames": f"{summary.frames:,}",
        "points": f"{summary.points:,} ({summary.points // max(summary.frames, 1):,} per frame)",
        "ground truth": counted.truth() if sequence.has_labels else "no",
        "distance": f"{counted.distance():,.1f} m",
        "rate": counted.rate(),
        "extent": " x ".join(f"{size:.1f}" for size in high - low) + " m",
        "low corner": " ".join(f"{x:.2f}" for x in low) + " m",
        "digest": summary.digest,
        **sequence.facts,
        **({} if sequence.exact else dict(sequence.reading.rows())),
    }


def _sensor(sequence: Drive) -> str:
    """The sensor, or estimates of an unknown one."""
    from dynaviz.sources.sensing import estimate_sensor, sentence

    sensor = sequence.sensor
    if sensor.name != "unknown":
        return f"{sensor.name} ({sensor.title})"
    return f"unknown; estimated from the scans: {sentence(estimate_sensor(sequence))}"


class _Counted:
    """A sequence that counts labels and keeps poses and stamps while it is read in order."""

    def __init__(self, sequence: Sequence) -> None:
        self._sequence = sequence
        self._labelled = 0
        self._points = 0
        self._dynamic = 0
        self._positions: list[F64] = []
        self._stamps: list[int | None] = []
        self.name = sequence.name
        self.sensor = sequence.sensor
        self.has_labels = sequence.has_labels

    def __len__(self) -> int:
        return len(self._sequence)

    def __getitem__(self, position: int) -> Scan:
        scan = self._sequence[position]
        self._positions.append(scan.position)
        self._stamps.append(scan.stamp_ns)
        if scan.labels is not None:
            static, dynamic = (int((scan.labels == label).sum()) for label in (0, 1))
            self._labelled += static + dynamic > 0
            self._points += static + dynamic
            self._dynamic += dynamic
        return scan

    def truth(self) -> str:
        """How many frames have labels, and the share of dynamic points."""
        share = (
            f", {100 * self._dynamic / self._points:.2f} % of their points dynamic"
            if self._points
            else ""
        )
        return f"{self._labelled:,} of {len(self):,} frames{share}"

    def distance(self) -> float:
        """Metres along the poses."""
        return sum(math.dist(a, b) for a, b in pairwise(self._positions))

    def rate(self) -> str:
        """Scans per second, from the median step of the stamps."""
        steps = [
            b - a for a, b in pairwise(self._stamps) if a is not None and b is not None and b > a
        ]
        return f"{1e9 / median(steps):.1f} Hz" if steps else "unknown"


def _show_pairs(title: str, facts: dict[str, str]) -> None:
    from rich.table import Table

    table = Table("name", "value", title=title, title_justify="left", show_header=False)
    for name, value in facts.items():
        table.add_row(name, value)
    show(table)
