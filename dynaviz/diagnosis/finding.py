"""What the doctor found: findings, each with how sure it is and what mends it, and all of them together."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import RenderResult


SHOWN = 5  # frames that a finding names


class Confidence(IntEnum):
    """How sure a finding is."""

    CERTAIN = 0
    LIKELY = 1
    PERHAPS = 2


@dataclass(frozen=True)
class Finding:
    """Something that is wrong with a sequence.

    Attributes:
        name: of the check, as in ``docs/doctor.md``.
        sure: how sure.
        what: a sentence with the figure it rests on.
        mend: a sentence with the flag or command that mends it.
        frames: numbers of the first frames concerned; empty where it is the whole sequence.
        count: how many frames are concerned.
        file: of the first of them, where the format tells.
    """

    name: str
    sure: Confidence
    what: str
    mend: str
    frames: tuple[int, ...] = ()
    count: int = 0
    file: str | None = None

    @property
    def where(self) -> str:
        """The frames, in words; none where only the file is known."""
        if not self.frames:
            return "" if self.file else "all frames"
        numbers = ", ".join(map(str, self.frames))
        more = f" and {self.count - len(self.frames):,} more" if self.count > len(self.frames) else ""
        return f"frame{'s' * (self.count > 1)} {numbers}{more}"


@dataclass(frozen=True)
class Diagnosis:
    """All findings, the surest first. Printing it shows a list.

    Attributes:
        sequence: its name.
        frames: how many it has.
        examined: how many of them were read; the others were not looked at.
    """

    sequence: str
    frames: int
    examined: int
    findings: tuple[Finding, ...]

    @classmethod
    def of(cls, sequence: str, frames: int, examined: int, findings: Iterable[Finding]) -> Diagnosis:
        """Put findings in order."""
        return cls(sequence, frames, examined, tuple(sorted(findings, key=lambda finding: finding.sure)))

    @property
    def sound(self) -> bool:
        """Whether nothing was found."""
        return not self.findings

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        rows = [{**asdict(finding), "sure": finding.sure.name.lower()} for finding in self.findings]
        return {"sequence": self.sequence, "frames": self.frames, "examined": self.examined, "findings": rows}

    def __str__(self) -> str:
        from rich.console import Console

        console = Console(width=100, color_system=None)
        with console.capture() as captured:
            console.print(self)
        return captured.get().rstrip()

    def __rich_console__(self, console: object, options: object) -> RenderResult:
        from rich.padding import Padding
        from rich.text import Text

        looks = {Confidence.CERTAIN: "bold red", Confidence.LIKELY: "bold yellow", Confidence.PERHAPS: "bold cyan"}
        for number, finding in enumerate(self.findings, 1):
            head = Text.assemble((f"{finding.sure.name.lower()}  ", looks[finding.sure]), (finding.name, "bold"))
            yield Text.assemble(f"{number:>2}  ", head, (f"  {finding.where}", "dim"))
            lines = [(finding.what, ""), (f"Mend: {finding.mend}", "green")]
            if finding.file is not None:
                lines.insert(1, (finding.file, "dim"))
            for line, style in lines:
                yield Padding(Text(line, style), (0, 0, 0, 4), expand=False)
        count = len(self.findings)
        found = f"{count} finding{'s' * (count > 1)}" if count else "nothing found"
        yield Text(f"{self.sequence}: {found}. {self._read}")

    @property
    def _read(self) -> str:
        if self.examined == self.frames:
            return f"All {self.frames:,} frames were examined."
        part = f"{self.examined:,} of {self.frames:,} frames were examined"
        return f"{part}, in stretches over the whole; --frames A:B examines a part in full."


def settable(parameter: str, value: str) -> str:
    """The methods that have a parameter, and how it is set there, in words."""
    from dynaviz import registry
    from dynaviz.errors import PluginError

    names = []
    for handle in registry.handles("methods"):
        with contextlib.suppress(PluginError):
            if parameter in getattr(handle.load().Params, "__dataclass_fields__", {}):
                names.append(handle.name)
    return f"--set {parameter}={value} ({', '.join(names)})" if names else f"{parameter}={value}"
