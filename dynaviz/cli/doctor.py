"""dynaviz doctor."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import progress, show
from dynaviz.cli.options import Deskew, Frames, PointsIn, Poses, SensorName


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("doctor")(doctor)


def doctor(
    sequence: Annotated[
        str, typer.Argument(metavar="SEQ", help="Sequence folder or bag. FORMAT:PATH forces the format.")
    ],
    frames: Frames = None,
    sensor: SensorName = None,
    poses: Poses = None,
    points_in: PointsIn = None,
    deskew: Deskew = None,
    out: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Also write the findings to a JSON file.")
    ] = None,
) -> None:
    """Diagnose a sequence and suggest fixes.

    Exit code 0: nothing found, 1: findings, 2: the data cannot be read.

    \b
    dynaviz doctor path/to/sequence
    dynaviz doctor kitti/sequences/08 --frames 0:200 --json findings.json
    dynaviz doctor files:scans --poses odometry.txt --sensor vlp16
    """
    import json

    from dynaviz.cli.options import open_sequence
    from dynaviz.diagnosis import doctor as examine
    from dynaviz.io.atomic import write_atomic

    opened = open_sequence(sequence, frames=frames, sensor=sensor, poses=poses, points_in=points_in, deskew=deskew)
    with progress(f"doctor on {opened.name}") as report:
        diagnosis = examine(opened, progress=report)
    show(diagnosis)
    if out:
        write_atomic(out, json.dumps(diagnosis.to_dict(), indent=1, allow_nan=False).encode())
    if not diagnosis.ok:
        raise typer.Exit(1)
