"""dynaviz compare."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import program, progress, show


def add_to(app: typer.Typer) -> None:
    """Register the verb."""
    app.command("compare")(compare)


def compare(
    recordings: Annotated[list[Path], typer.Argument(metavar="A.rrd B.rrd...", help="Runs on the same sequence.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Recording that shows them side by side.")] = Path(
        "compare.rrd"
    ),
    view: Annotated[bool, typer.Option("--view", help="Open it in a viewer.")] = False,
    json: Annotated[Path | None, typer.Option(help="Write everything printed here, for machines.")] = None,
    fail_below: Annotated[
        float | None,
        typer.Option(metavar="DELTA", help="Exit with 1 if AA minus A's AA is below DELTA for any other run."),
    ] = None,
) -> None:
    """Say what differs between runs: scores, who is right, where and when; and show them side by side.

    \b
    dynaviz compare recordings/street/octomap/run.rrd recordings/street/dufomap/run.rrd
    dynaviz compare a.rrd b.rrd c.rrd -o compare.rrd --json compare.json
    dynaviz compare old.rrd new.rrd --fail-below -0.5
    """
    from dynaviz import api

    with progress("compare") as tell:
        comparison = api.compare(*recordings, out=out, progress=tell)
    show(comparison, f"Written to {out}. Look at it: {program()} view {out}")
    if json is not None:
        comparison.save(json)
        show(f"Written to {json}.")
    if view:
        from dynaviz.viz.view import view as open_viewer

        open_viewer([out])
    if fail_below is not None and (fallen := comparison.fallen(fail_below)):
        for line in fallen:
            print(f"dynaviz: {line}", file=sys.stderr)
        raise typer.Exit(1)
