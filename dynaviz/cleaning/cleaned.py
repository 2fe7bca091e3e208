"""What a cleaning did, on one page.

Removed points by reason and range, suspicious clusters, poses, files.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from dynaviz.cleaning.changes import Changes
from dynaviz.cleaning.doubt import NOISY, Doubt
from dynaviz.cleaning.followed import Reviewed
from dynaviz.contracts import registry
from dynaviz.engine.cleaned_map import WrittenMap
from dynaviz.errors import addressed
from dynaviz.scores.account import PointAccount
from dynaviz.scores.result import Result
from dynaviz.scores.sections import Removals, RemovedCluster
from dynaviz.sources.origin import EstimatedPoses

if TYPE_CHECKING:
    from rich.console import RenderableType

CASES = 5  # listed
_FLOAT64 = (
    "x y z are float64, so that far coordinates stay exact; PCL before 1.15 reads them as zeros: "
    "write .laz for other programs, or float32 in local coordinates with --tiles autoware"
)
_ADVICE = "; `--refine-poses` may reduce it, and keep more static points"


@dataclass(frozen=True)
class Cleaned:
    """The result of ``dynaviz.clean``. Printing it shows the summary.

    Attributes:
        result: of the run: labels, parameters, and what was removed.
        account: where the points of the source went.
        maps: the maps that were written; the clean map first.
        folder: files of the run: summary, labels, recording, and estimated poses.
        poses: estimated poses; None if the sequence had poses.
        facts: further facts of the sequence, such as the source of its poses.
        sensor: estimates of an unknown sensor in one line; empty for a known one.
        doubt: why the map should be checked before it is used; None if nothing is unusual.
        trajectory: file with the poses that were used; None for several lidars.
        marked: whether the map has all points, marked.
        changes: what changed between two drives, if it was asked for.
        review: the decisions that the map follows, and what they changed; None without any.
    """

    result: Result
    account: PointAccount
    maps: tuple[WrittenMap, ...]
    folder: Path
    poses: EstimatedPoses | None = None
    facts: Mapping[str, str] = field(default_factory=dict)
    sensor: str = ""
    doubt: Doubt | None = None
    trajectory: Path | None = None
    marked: bool = False
    changes: Changes | None = None
    review: Reviewed | None = None

    @property
    def removals(self) -> Removals:
        """What was removed."""
        return self.result.sections.removals or Removals()

    def headline(self) -> str:
        """One line: how many points were removed."""
        found = self.removals
        removed = found.removed
        if self.review:
            by_hand = self.review.applied.by_hand
            removed += by_hand.removed - by_hand.kept
        share = f" ({100.0 * removed / found.points:.1f} %)" if found.points else ""
        return f"Removed {removed:,} of {found.points:,} points{share}"

    def to_dict(self) -> dict[str, Any]:
        """The summary in plain values, for JSON."""
        found = self.removals
        run = self.result
        poses = self.poses and {
            "odometry": self.poses.odometry,
            "version": self.poses.version,
            "file": str(self.poses.file),
            "distance": self.poses.distance,
            "seconds": self.poses.seconds,
            "reused": self.poses.reused,
        }
        return {
            "sequence": run.sequence.name,
            "method": run.method,
            "frames": run.sequence.frames,
            "points": found.points,
            "removed": found.removed,
            "account": msgspec.to_builtins(self.account),
            "doubt": self.doubt and asdict(self.doubt),
            "metrics": dict(run.metrics),
            "maps": [
                {"file": str(m.path), "points": m.points, "attributes": list(m.attributes)}
                for m in self.maps
            ],
            "marked": self.marked,
            "poses": poses,
            "poses_used": {
                "source": self.facts.get("poses"),
                "file": self.trajectory and str(self.trajectory),
            },
            "reading": msgspec.to_builtins(run.reading),
            "pose_noise": msgspec.to_builtins(run.pose_noise),
            "pose_refinement": msgspec.to_builtins(run.pose_refinement),
            "pose_findings": msgspec.to_builtins(run.pose_findings),
            "sensor": self.sensor or None,
            "reasons": dict(found.reasons),
            "reason_names": self._reason_names(),
            "range": msgspec.to_builtins(found.range),
            "clusters": msgspec.to_builtins(self.clusters),
            "failures": msgspec.to_builtins(run.failures),
            "changed": self.changes and self.changes.to_dict(),
            "review": self.review and self.review.to_dict(),
            "folder": str(self.folder),
        }

    @property
    def clusters(self) -> tuple[RemovedCluster, ...]:
        """Clusters of removed points, the most suspicious first.

        Of equal suspicion, the largest first.
        """
        return tuple(sorted(self.result.clusters, key=lambda each: (-each.suspicion, -each.points)))

    def _reason_names(self) -> list[str]:
        """The names of reason codes, by code."""
        info = registry.load("methods", self.result.method).info
        return [reason.name for reason in info.reasons]

    def markdown(self) -> str:
        """The summary as a page."""
        return addressed("\n".join(self._lines()))

    def _lines(self) -> Iterator[str]:
        run = self.result
        found = self.removals
        yield f"# {run.sequence.name}, cleaned with {run.method}"
        yield ""
        if self.doubt:
            yield "> **Check this map before you use it.**"
            yield from (f"> {line}  " for line in self.doubt.lines())
            yield ""
        yield f"{self.headline()} in {run.sequence.frames:,} frames."
        yield f"\nPoints: {self.account}."
        yield ""
        for each in self.maps:
            names = f", with {', '.join(each.attributes)}" if each.attributes else ""
            yield f"- `{each.path}`: {each.points:,} points{names}"
            if each.double_pcd:
                yield f"  ({_FLOAT64})"
        if self.trajectory:
            yield f"- `{self.trajectory}`: the poses that were used; `--poses` reads them"
        if self.marked:
            legend = ", ".join(f"{code} {name}" for code, name in enumerate(self._reason_names()))
            yield (
                "\nThe map has all points. `dynamic`: 0 static, 1 dynamic, 2 not judged. "
                f"`reason`: {legend}."
            )
            if self.review:
                yield "`by_hand`: 1 where a decision changed the answer of the method."
        yield from self._about_poses()
        yield from self._about_reading()
        if self.review:
            yield from self.review.lines()
        if self.changes:
            yield from self.changes.lines()
        yield from self._reasons()
        rows = [(_interval(r.low, r.high), r.removed, r.points) for r in found.range if r.points]
        yield from [
            "",
            "## Removed by range",
            "",
            "| range | removed | points | share |",
            "|---|---:|---:|---:|",
        ]
        yield from (
            f"| {name} | {n:,} | {total:,} | {100 * n / total:.1f} % |" for name, n, total in rows
        )
        yield from self._cases()
        yield ""

    def _reasons(self) -> Iterator[str]:
        """Removed points by reason, with what each means."""
        found = self.removals
        if not found.reasons:
            return
        info = registry.load("methods", self.result.method).info
        meaning = {reason.name: reason.meaning for reason in info.reasons}
        yield from [
            "",
            "## Removed by reason",
            "",
            "| reason | points | share | meaning |",
            "|---|---:|---:|---|",
        ]
        for name, n in found.reasons.items():
            share = 100 * n / found.removed
            yield f"| {name} | {n:,} | {share:.1f} % | {meaning.get(name, '')} |"

    def _about_poses(self) -> Iterator[str]:
        if self.poses is not None:
            yield (
                f"\nPoses were estimated with {self.poses}. They are in `{self.poses.file}`; "
                "`--poses` reads them."
            )
        elif "poses" in self.facts:
            yield f"\nPoses: {self.facts['poses']}."
        if refined := self.result.pose_refinement:
            yield (
                f"\nPoses were refined: {refined}. They are in "
                f"`{self.folder / 'poses_refined.csv'}`."
            )
        elif noise := self.result.pose_noise:
            yield f"\nPose noise: {noise}{_ADVICE if noise.translation_m > NOISY else ''}."
        if self.sensor:
            yield (
                f"\nThe sensor is unknown. Estimated from the scans: {self.sensor}. `--sensor` "
                "overrides this."
            )

    def _about_reading(self) -> Iterator[str]:
        """What was found in the source or assumed."""
        if reading := self.result.reading:
            yield from ["", "## How the data were read", "", "| what | how |", "|---|---|"]
            yield from (f"| {name} | {value} |" for name, value in reading.rows())

    def _cases(self) -> Iterator[str]:
        """The clusters to look at first, or the scores and failures of a sequence with ground
        truth.
        """
        if self.result.has_truth:
            named = {name: self.result.metrics.get(name) for name in ("SA", "DA", "AA")}
            scores = ", ".join(
                f"{name} {value:.2f}" for name, value in named.items() if value is not None
            )
            yield from ["", f"## Scores: {scores}", ""]
            yield from (
                f"{n}. {case.sentence}" for n, case in enumerate(self.result.failures[:CASES], 1)
            )
            return
        clusters = self.clusters
        yield from ["", "## Look at these first", ""]
        if not clusters:
            yield "No removed points form a cluster."
            return
        yield (
            "Clusters of removed points that may be static. Suspicion runs from 0 (mover) to 1 "
            "(static surface).\n"
        )
        yield from (
            f"{n}. {c.suspicion:.2f}: {c.sentence} {self._place(c)}"
            for n, c in enumerate(clusters[:CASES], 1)
        )

    def _place(self, cluster: RemovedCluster) -> str:
        """The middle of a cluster, in the coordinates of the map."""
        origin = self.result.answers.sequence.origin
        middle = (np.array(cluster.low) + np.array(cluster.high)) / 2 + origin
        return f"At {', '.join(f'{x:.1f}' for x in middle)} m."

    def __str__(self) -> str:
        return self.markdown()

    def __rich__(self) -> RenderableType:
        from rich.markdown import Markdown

        return Markdown(self.markdown())


def _interval(low: float | None, high: float | None) -> str:
    return f"beyond {low:g} m" if high is None else f"{low or 0:g} to {high:g} m"
