"""The doctor's result: findings with confidence, evidence and fix, and the diagnosis that collects
them.
"""

from __future__ import annotations

import contextlib
import dataclasses
import re
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any

from dynaviz.diagnosis.sampling import Sampling
from dynaviz.errors import addressed
from dynaviz.sources.origin import PoseNoise

if TYPE_CHECKING:
    from rich.console import RenderResult


SHOWN = 5  # frames that a finding lists


_OPTIONS = {
    "points in sensor frame": "--points-in sensor",
    "points in world frame": "--points-in world",
    "poses missing": "--poses small-gicp",
    "poses drift": "--poses small-gicp",
    "poses do not fit": "--poses small-gicp",
}


class Confidence(IntEnum):
    """Confidence in a finding, highest first."""

    CERTAIN = 0
    LIKELY = 1
    PERHAPS = 2


@dataclass(frozen=True)
class Finding:
    """A problem of a sequence.

    Attributes:
        name: name of the check, as in ``docs/doctor.md``.
        confidence: certain, likely or perhaps.
        problem: a sentence that states the problem and the figure it is based on.
        fix: a sentence with the flag or command that fixes it.
        frames: numbers of the first affected frames; empty if the whole sequence is affected.
        count: number of affected frames.
        file: file of the first affected frame; None if the format does not keep one file per frame.
    """

    name: str
    confidence: Confidence
    problem: str
    fix: str
    frames: tuple[int, ...] = ()
    count: int = 0
    file: str | None = None

    @property
    def option(self) -> str:
        """The option that fixes it, such as ``--points-in world``.

        Empty if the data must be written again.
        """
        given = re.search(r"--extrinsic [-\d.,]+$", self.fix)
        return given[0] if given else _OPTIONS.get(self.name, "")

    @property
    def where(self) -> str:
        """The affected frames in words; empty if only the file is known."""
        if not self.frames:
            return "" if self.file else "all frames"
        numbers = ", ".join(map(str, self.frames))
        more = (
            f" and {self.count - len(self.frames):,} more" if self.count > len(self.frames) else ""
        )
        return f"frame{'s' * (self.count > 1)} {numbers}{more}"


@dataclass(frozen=True)
class Diagnosis:
    """All findings on a sequence, in order of confidence. Printing it shows a list.

    Attributes:
        sequence: name of the sequence.
        frames: number of frames in the sequence.
        examined: number of frames that were read.
        findings: certain ones first.
        pose_noise: None if too few planes are seen, or if the poses are wrong.
        of_poses: the findings on poses, frames, units and columns among them.
        sampling: which methods have too few scans or rings; None if the poses are wrong.
    """

    sequence: str
    frames: int
    examined: int
    findings: tuple[Finding, ...]
    pose_noise: PoseNoise | None = None
    of_poses: tuple[Finding, ...] = ()
    sampling: Sampling | None = None

    @classmethod
    def of(
        cls,
        sequence: str,
        frames: int,
        examined: int,
        findings: Iterable[Finding],
        of_poses: Iterable[Finding] = (),
    ) -> Diagnosis:
        """Sort findings by confidence."""
        ordered = tuple(sorted(findings, key=lambda finding: finding.confidence))
        return cls(sequence, frames, examined, ordered, of_poses=tuple(of_poses))

    @property
    def ok(self) -> bool:
        """Whether there are no findings."""
        return not self.findings

    def to_dict(self) -> dict[str, Any]:
        """The content of the JSON file."""
        rows = [
            dataclasses.asdict(finding) | {"confidence": finding.confidence.name.lower()}
            for finding in self.findings
        ]
        noise = self.pose_noise
        return {
            "sequence": self.sequence,
            "frames": self.frames,
            "examined": self.examined,
            "findings": rows,
            "pose_noise": noise
            and {"translation_m": noise.translation_m, "rotation_deg": noise.rotation_deg},
            "sampling": self.sampling and dataclasses.asdict(self.sampling),
        }

    def __str__(self) -> str:
        from rich.console import Console

        console = Console(width=100, color_system=None)
        with console.capture() as captured:
            console.print(self)
        return captured.get().rstrip()

    def __rich_console__(self, console: object, options: object) -> RenderResult:
        from rich.padding import Padding
        from rich.text import Text

        styles = {
            Confidence.CERTAIN: "bold red",
            Confidence.LIKELY: "bold yellow",
            Confidence.PERHAPS: "bold cyan",
        }
        for number, finding in enumerate(self.findings, 1):
            head = Text.assemble(
                (f"{finding.confidence.name.lower()}  ", styles[finding.confidence]),
                (finding.name, "bold"),
            )
            yield Text.assemble(f"{number:>2}  ", head, (f"  {finding.where}", "dim"))
            lines = [(finding.problem, ""), (f"Fix: {addressed(finding.fix)}", "green")]
            if finding.file is not None:
                lines.insert(1, (finding.file, "dim"))
            for line, style in lines:
                yield Padding(Text(line, style), (0, 0, 0, 4), expand=False)
        count = len(self.findings)
        found = f"{count} finding{'s' * (count > 1)}" if count else "no problems found"
        yield Text(addressed(f"{self.sequence}: {found}. {self._coverage}"))
        if self.pose_noise:
            yield Text(
                f"Pose noise: {self.pose_noise}, from the planes that neighbouring frames see."
            )
        if self.sampling and self.sampling.poor:
            yield Text(str(self.sampling))

    @property
    def _coverage(self) -> str:
        if self.examined == self.frames:
            return f"All {self.frames:,} frames were examined."
        part = f"{self.examined:,} of {self.frames:,} frames were examined"
        return (
            f"{part}, spread over the whole sequence; use --frames A:B to examine a part "
            "completely."
        )


def settable(parameter: str, value: str) -> str:
    """The option that sets a parameter, and the methods that have it, in words."""
    from dynaviz.contracts import registry
    from dynaviz.errors import PluginError

    names = []
    for handle in registry.handles("methods"):
        with contextlib.suppress(PluginError):
            if parameter in getattr(handle.load().Params, "__dataclass_fields__", {}):
                names.append(handle.name)
    return f"--set {parameter}={value} ({', '.join(names)})" if names else f"{parameter}={value}"
