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
        int | None,
        typer.Option(
            min=0,
            metavar="F",
            help="Frame: its position in the run, as in 'dynaviz info --failures'.",
        ),
    ] = None,
    point: Annotated[
        int | None,
        typer.Option(min=0, metavar="P", help="Point: its row in the scan of that frame."),
    ] = None,
    case: Annotated[
        int | None,
        typer.Option(
            min=1, metavar="N", help="Case, as in 'dynaviz info --failures': its middle point."
        ),
    ] = None,
    near: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z",
            help="The point nearest to this place in the recording, metres; with --frame, of that "
            "frame.",
        ),
    ] = None,
    again: Annotated[
        bool,
        typer.Option("--again", help="Repeat the run even if the recording has the answer."),
    ] = False,
    sequence: Moved = None,
    out: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Also write the whole ledger to a JSON file."),
    ] = None,
    threads: Threads = None,
) -> None:
    """Explain the label of one point, or of a case.

    Lists the scans that decided, what each showed in the method's terms, and the rules. The scan of
    the point is marked with *. Points of cases are answered at once from the recording; for others
    the run is repeated.

    \b
    dynaviz why recordings/demo/octomap --case 3
    dynaviz why run.rrd --near 12.5,-3.1,0.8
    dynaviz why run.rrd --frame 41 --point 12345 --json ledger.json
    """
    import json

    from dynaviz.io.atomic import write_atomic
    from dynaviz.runs.explanation import why as explain

    with progress("repeat") as report:
        found = explain(
            run_in(run),
            frame,
            point,
            case=case,
            near=None if near is None else _place(near),
            again=again,
            sequence=sequence,
            threads=threads,
            progress=report,
        )
    show(found)
    if out:
        write_atomic(out, json.dumps(found.to_dict(), indent=1, allow_nan=False).encode())


def _place(text: str) -> tuple[float, float, float]:
    from dynaviz.errors import UsageError

    try:
        x, y, z = (float(number) for number in text.split(","))
    except ValueError:
        raise UsageError(f"--near {text}: give three numbers, such as 12.5,-3.1,0.8") from None
    return x, y, z
