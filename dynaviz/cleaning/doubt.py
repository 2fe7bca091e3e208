"""Whether the result of a cleaning needs a second look before it is used, why, and what to try."""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dynaviz.scores.account import PointAccount
from dynaviz.scores.result import Result
from dynaviz.sources.drive import Drive

if TYPE_CHECKING:
    from rich.console import RenderableType

MOST_REMOVED = 30.0
"""Percent of the judged points: movers are rarely more; wrong poses remove more."""

NOISY = 0.01
"""Metres; pose noise from which refining poses is advised."""


@dataclass(frozen=True)
class Doubt:
    """A reason to check a map before it is used.

    Attributes:
        problem: what is unusual, with the figure.
        cause: the likeliest cause.
        command: the command to try, or empty.
    """

    problem: str
    cause: str
    command: str

    def lines(self) -> tuple[str, ...]:
        """What to tell the user."""
        return (
            self.problem,
            f"Likeliest cause: {self.cause}",
            *([f"Try: {self.command}"] if self.command else []),
            "From symptom to cause: docs/wrong_map.md",
        )

    def __rich__(self) -> RenderableType:
        from rich.panel import Panel
        from rich.text import Text

        return Panel(
            Text("\n".join(self.lines())),
            title="check this map before you use it",
            style="bold red",
        )


def doubt_of(
    result: Result,
    account: PointAccount,
    source: str,
    words: Sequence[str],
    given: bool,
    in_world: bool,
) -> Doubt | None:
    """What is doubtful about a cleaning; None if nothing is.

    Args:
        result: of the run.
        account: where the points went.
        source: what was cleaned, as a command names it.
        words: the command that cleaned it.
        given: whether its poses were given, and not estimated from the scans.
        in_world: whether its points are in the world frame, so that poses cannot be estimated.
    """
    share = account.percent or 0.0
    if not result.pose_findings and share <= MOST_REMOVED:
        return None
    doctor = shlex.join(["dynaviz", "doctor", source])
    removed = f"{share:.1f} % of the points were removed"
    estimating = "" if in_world or not given else "--poses small-gicp"
    if result.pose_findings:
        found = result.pose_findings[0]
        option = found.option or estimating
        return Doubt(
            f"The poses are likely wrong; {removed}", f"{found}.", _with(words, option) or doctor
        )
    noise = result.pose_noise
    if noise is not None and noise.translation_m > NOISY:
        return Doubt(
            f"{removed}.", f"noisy poses ({noise})", _with(words, "--refine-poses") or doctor
        )
    if given:
        cause = (
            "poses that do not fit the scans: of another sensor, in other axes, or on another clock"
        )
        return Doubt(f"{removed}.", cause, _with(words, estimating) or doctor)
    cause = (
        "estimated poses that drift or lost track. Give those of a SLAM system with --poses FILE"
    )
    return Doubt(f"{removed}.", cause, doctor)


def doubt_in(
    result: Result,
    account: PointAccount,
    opened: Drive,
    command: str,
    out: Path,
    given: bool,
) -> Doubt | None:
    """What is doubtful about the cleaning of a sequence; None if nothing is.

    Args:
        result, account, given: as for ``doubt_of``.
        opened: the sequence.
        command: that cleaned it; empty for one from Python.
        out: the map.
    """
    facts = opened.facts
    source = " ".join(opened.provenance.sources) or "SEQ"
    in_world = facts.get("points in", "").startswith("world")
    words = shlex.split(command) or ["dynaviz", "clean", source, "-o", os.fspath(out)]
    return doubt_of(result, account, source, words, given, in_world)


def _with(words: Sequence[str], option: str) -> str:
    """The command with another option; empty if there is none."""
    return shlex.join([*words, *option.split()]) if option else ""
