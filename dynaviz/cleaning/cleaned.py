"""What a cleaning did, on one page: removed points by reason and range, suspicious clusters, poses, files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from dynaviz.engine.cleaned_map import WrittenMap
from dynaviz.scores.result import Result
from dynaviz.scores.sections import Removals
from dynaviz.sources.odometry.estimate import EstimatedPoses

if TYPE_CHECKING:
    from rich.console import RenderableType

CASES = 5  # listed
NOISY = 0.01  # metres; pose noise from which refining poses is advised
_ADVICE = "; `--refine-poses` may reduce it, and keep more static points"


@dataclass(frozen=True)
class Cleaned:
    """The result of ``dynaviz.clean``. Printing it shows the summary.

    Attributes:
        result: of the run: labels, parameters, and what was removed.
        maps: the maps that were written; the clean map first.
        folder: files of the run: summary, labels, recording, and estimated poses.
        poses: estimated poses; None if the sequence had poses.
        facts: further facts of the sequence, such as the source of its poses.
        sensor: estimates of an unknown sensor in one line; empty for a known one.
    """

    result: Result
    maps: tuple[WrittenMap, ...]
    folder: Path
    poses: EstimatedPoses | None = None
    facts: Mapping[str, str] = field(default_factory=dict)
    sensor: str = ""

    @property
    def removals(self) -> Removals:
        """What was removed."""
        return self.result.sections.removals or Removals()

    def headline(self) -> str:
        """One line: how many points were removed."""
        found = self.removals
        share = "" if found.percent is None else f" ({found.percent:.1f} %)"
        return f"Removed {found.removed:,} of {found.points:,} points{share}"

    def to_dict(self) -> dict[str, Any]:
        """The summary in plain values, for JSON."""
        found = self.removals
        poses = self.poses and {
            "odometry": self.poses.odometry,
            "version": self.poses.version,
            "file": str(self.poses.file),
            "distance": self.poses.distance,
            "seconds": self.poses.seconds,
            "reused": self.poses.reused,
        }
        return {
            "sequence": self.result.sequence.name,
            "method": self.result.method,
            "points": found.points,
            "removed": found.removed,
            "metrics": dict(self.result.metrics),
            "maps": [{"file": str(m.path), "points": m.points, "attributes": list(m.attributes)} for m in self.maps],
            "poses": poses,
            "pose_noise": msgspec.to_builtins(self.result.pose_noise),
            "pose_refinement": msgspec.to_builtins(self.result.pose_refinement),
            "folder": str(self.folder),
        }

    def markdown(self) -> str:
        """The summary as a page."""
        return "\n".join(self._lines())

    def _lines(self) -> Iterator[str]:
        run, found = self.result, self.removals
        yield f"# {run.sequence.name}, cleaned with {run.method}"
        yield ""
        yield f"{self.headline()} in {run.sequence.frames:,} frames."
        yield ""
        for each in self.maps:
            names = f", with {', '.join(each.attributes)}" if each.attributes else ""
            yield f"- `{each.path}`: {each.points:,} points{names}"
        yield from self._about_poses()
        yield from _table("Removed by reason", "reason", list(found.reasons.items()), found.removed)
        rows = [(_interval(r.low, r.high), r.removed, r.points) for r in found.range if r.points]
        yield from ["", "## Removed by range", "", "| range | removed | points | share |", "|---|---:|---:|---:|"]
        yield from (f"| {name} | {n:,} | {total:,} | {100 * n / total:.1f} % |" for name, n, total in rows)
        yield from self._cases()
        yield ""

    def _about_poses(self) -> Iterator[str]:
        if self.poses is not None:
            yield f"\nPoses were estimated with {self.poses}. They are in `{self.poses.file}`; `--poses` reads them."
        elif "poses" in self.facts:
            yield f"\nPoses: {self.facts['poses']}."
        if refined := self.result.pose_refinement:
            yield f"\nPoses were refined: {refined}. They are in `{self.folder / 'poses_refined.csv'}`."
        elif noise := self.result.pose_noise:
            yield f"\nPose noise: {noise}{_ADVICE if noise.translation_m > NOISY else ''}."
        if self.sensor:
            yield f"\nThe sensor is unknown. Estimated from the scans: {self.sensor}. `--sensor` overrides this."

    def _cases(self) -> Iterator[str]:
        """The clusters to look at first, or the scores and failures of a sequence with ground truth."""
        if self.result.has_truth:
            named = {name: self.result.metrics.get(name) for name in ("SA", "DA", "AA")}
            scores = ", ".join(f"{name} {value:.2f}" for name, value in named.items() if value is not None)
            yield from ["", f"## Scores: {scores}", ""]
            yield from (f"{n}. {case.sentence}" for n, case in enumerate(self.result.failures[:CASES], 1))
            return
        clusters = self.result.clusters
        yield from ["", "## Look at these first", ""]
        if not clusters:
            yield "No removed points form a cluster."
            return
        yield "Clusters of removed points that may be static. Suspicion runs from 0 (mover) to 1 (static surface).\n"
        yield from (f"{n}. {c.suspicion:.2f}: {c.sentence}" for n, c in enumerate(clusters[:CASES], 1))

    def __str__(self) -> str:
        return self.markdown()

    def __rich__(self) -> RenderableType:
        from rich.markdown import Markdown

        return Markdown(self.markdown())


def _table(title: str, column: str, counts: list[tuple[str, int]], total: int) -> Iterator[str]:
    if counts:
        yield from ["", f"## {title}", "", f"| {column} | points | share |", "|---|---:|---:|"]
        yield from (f"| {name} | {n:,} | {100 * n / total:.1f} % |" for name, n in counts)


def _interval(low: float | None, high: float | None) -> str:
    return f"beyond {low:g} m" if high is None else f"{low or 0:g} to {high:g} m"
