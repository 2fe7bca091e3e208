"""dynaviz why."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import progress, show
from dynaviz.cli.options import Moved, Threads, run_in


def why(
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="Folder, result.json or run.rrd of a run.")
    ],
    frame: Annotated[
        int,
        typer.Option(
            min=0,
            metavar="F",
            help="Frame: its position in the run, as in 'dynaviz info --failures'.",
        ),
    ],
    point: Annotated[
        int, typer.Option(min=0, metavar="P", help="Point: its row in the scan of that frame.")
    ],
    sequence: Moved = None,
    out: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Also write the whole ledger to a JSON file."),
    ] = None,
    threads: Threads = None,
) -> None:
    """Explain the label of one point.

    Repeats the run and lists every scan whose rays hit or crossed the point's cell, what each
    contributed in the method's terms, and the rules that decided. The frame of the point is marked
    with *.

    \b
    dynaviz why recordings/demo/octomap --frame 41 --point 12345
    dynaviz why run.rrd --frame 41 --point 12345 --json ledger.json
    """
    import json

    from dynaviz.io.atomic import write_atomic
    from dynaviz.runs.explanation import why as explain

    with progress("replay") as report:
        found = explain(
            run_in(run), frame, point, sequence=sequence, threads=threads, progress=report
        )
    show(found)
    if out:
        write_atomic(out, json.dumps(found.to_dict(), indent=1, allow_nan=False).encode())
