"""dynaviz compare."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from dynaviz import isolated
from dynaviz.cli.console import print_json, program, progress, show
from dynaviz.cli.options import Json, Quiet, Review, recording_in


def compare(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            metavar="A.rrd B.rrd...",
            help="Recordings or folders of runs on the same frames, compared with A.",
        ),
    ],
    out: Annotated[
        Path, typer.Option("-o", "--out", help="Recording to write, with the runs side by side.")
    ] = Path("compare.rrd"),
    card: Annotated[
        Path | None,
        typer.Option(
            metavar="CARD.md",
            help="Write what changed as Markdown, for a pull request, with pictures next to it.",
        ),
    ] = None,
    view: Annotated[
        bool, typer.Option("--view", help="Open the written recording in the viewer.")
    ] = False,
    json: Json = None,
    fail_below: Annotated[
        float | None,
        typer.Option(
            metavar="DELTA",
            help="Exit with code 1 if the AA of any other run minus the AA of A is below DELTA.",
        ),
    ] = None,
    review: Review = None,
    quiet: Quiet = False,
) -> None:
    """Compare runs on the same sequence.

    Shows the difference in scores, which run is right where they disagree, and the places and
    frames of the differences. Writes a recording with the runs side by side.

    \b
    dynaviz compare recordings/street/octomap/run.rrd recordings/street/dufomap/run.rrd
    dynaviz compare a.rrd b.rrd c.rrd -o compare.rrd --json compare.json
    dynaviz compare old.rrd new.rrd --fail-below -0.5
    dynaviz compare old.rrd new.rrd --card card.md
    """
    isolated.without_pandas()
    from dynaviz.reports import change_card
    from dynaviz.views.compare.compare import Compared

    if card is not None:
        change_card.checked(card)
    opened = [recording_in(each) for each in recordings]
    truth = None
    if review is not None:
        from dynaviz.runs.reviewed import truths
        from dynaviz.runs.run import open_run

        with progress("compare") as report:
            truth = truths(open_run(opened[0]), review, report)
    with progress("compare", unit="recordings") as report:
        compared = Compared(opened, out, report, truth)
    comparison = compared.comparison
    printed = print_json(comparison.to_dict(), json)
    if not printed:
        show(comparison)  # before the recording is written, which takes longer
    if card is not None:
        with progress("compare", unit="pairs") as report:
            change_card.write_card(card, comparison, compared.recordings, report)
    with progress("compare", unit="recordings") as report:
        compared.write(report)
    if not printed:
        show(f"Written to {out}. Open it with: {program()} view {out}")
        if card is not None:
            show(f"Written to {card}, with pictures next to it.")
    if json is not None and not printed:
        show(f"Written to {json}.")
    if view:
        from dynaviz.views.read.view import view as open_viewer

        open_viewer([out])
    if fail_below is not None and (drops := comparison.drops_below(fail_below)):
        for line in drops:
            print(f"dynaviz: {line}", file=sys.stderr)
        raise typer.Exit(1)
