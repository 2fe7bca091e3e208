"""dynaviz repair."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynaviz.cli.console import program, show

if TYPE_CHECKING:
    from dynaviz.views.read.repair import SalvagedRecording

PARTIAL, NOTHING = 3, 1


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("repair")(repair)


def repair(
    broken: Annotated[
        Path,
        typer.Argument(
            metavar="BROKEN.rrd",
            help="Damaged recording, .run.rrd.part of a killed run, or live-N.rrd of a live session.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="Output file. [default: run.rrd for .run.rrd.part, else run-repaired.rrd]"),
    ] = None,
) -> None:
    """Recover a recording that is damaged, or whose writer was killed.

    Damaged parts are left out; all others are kept. The input file is not changed.
    Exit code 0: nothing to do, or no frame is missing, 3: frames are missing, 1: nothing could be recovered.

    \b
    dynaviz repair recordings/demo/octomap/.run.rrd.part
    dynaviz repair run.rrd -o recovered.rrd
    """
    from dynaviz.views.read.repair import repair as salvage

    salvaged = salvage(broken, out)
    for line in _summary(broken, salvaged):
        show(line)
    if not salvaged.whole and salvaged.path != broken:
        raise typer.Exit(NOTHING if salvaged.path is None else PARTIAL)


def _summary(broken: Path, salvaged: SalvagedRecording) -> list[str]:
    """What was recovered, and what to do next."""
    damaged = f" {salvaged.damaged} damaged chunk{'s' * (salvaged.damaged != 1)} left out." if salvaged.damaged else ""
    if salvaged.path is None and damaged:
        return [f"Nothing to recover in {broken}: what describes the run is damaged.", "Run the method again."]
    if salvaged.path is None:
        first = f"the first of its {salvaged.frames} frames" if salvaged.frames else "its first frame"
        return [f"Nothing to recover in {broken}: it ends before {first}.", "Run the method again."]
    if salvaged.path == broken:
        head = f"Nothing to do: {broken} can be opened, with {salvaged.answered} of {salvaged.frames} frames."
    else:
        head = f"{_recovered(salvaged)}{damaged} Written to {salvaged.path}."
    lines = [head, f"Open it with: {program()} view {salvaged.path}"]
    if not salvaged.finished:
        lines.append("Run the method again for the missing frames; it writes all files of the run again.")
    return lines


def _recovered(salvaged: SalvagedRecording) -> str:
    if not salvaged.answered:
        return f"Recovered the states of {salvaged.observed} of {salvaged.frames} frames; no frame has labels yet."
    if salvaged.live:
        return f"Recovered {salvaged.answered} frames of a live session."
    result = " and the result" if salvaged.finished else ""
    return f"Recovered {salvaged.answered} of {salvaged.frames} frames{result}."
