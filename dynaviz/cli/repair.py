"""dynaviz repair."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynaviz.cli.console import program, show

if TYPE_CHECKING:
    from dynaviz.viz.repair import SalvagedRecording

IN_PART, NOTHING = 3, 1


def add_to(app: typer.Typer) -> None:
    """Register the verb."""
    app.command("repair")(repair)


def repair(
    broken: Annotated[
        Path, typer.Argument(metavar="BROKEN.rrd", help="A recording that was cut off, or .run.rrd.part.")
    ],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="Where to write it. [default: run.rrd of .run.rrd.part, or run-repaired.rrd]"),
    ] = None,
) -> None:
    """Salvage a recording whose writer was killed. The broken file stays as it is.

    Exit 0: nothing to do, or no frame is missing; 3: some are; 1: nothing was left.

    \b
    dynaviz repair recordings/demo/octomap/.run.rrd.part
    dynaviz repair run.rrd -o salvaged.rrd
    """
    from dynaviz.viz.repair import repair as salvage

    found = salvage(broken, out)
    for line in _words(broken, found):
        show(line)
    if not found.whole and found.path != broken:
        raise typer.Exit(NOTHING if found.path is None else IN_PART)


def _words(broken: Path, found: SalvagedRecording) -> list[str]:
    """What was salvaged, and what to do next."""
    again = "Run the method again for the rest: it writes every file of the run anew."
    if found.path is None:
        first = f"the first of its {found.frames} frames" if found.frames else "its first frame"
        return [f"Nothing to salvage in {broken}: it ends before {first}.", "Run the method again."]
    look = f"Look at it: {program()} view {found.path}"
    if found.path == broken:
        head = f"Nothing to do: {broken} opens as it is, with {found.answered} of {found.frames} frames."
        return [head, look] if found.finished else [head, look, again]
    if not found.answered:
        head = f"Salvaged what the method showed in {found.observed} of {found.frames} frames, before its first answer."
    else:
        head = f"Salvaged {found.answered} of {found.frames} frames{', and the result' if found.finished else ''}."
    return [f"{head} Written to {found.path}.", look, *([] if found.finished else [again])]
