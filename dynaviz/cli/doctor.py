"""dynaviz doctor."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from dynaviz.cli.console import print_json, progress, show
from dynaviz.cli.options import SEQUENCE, Json, Quiet, open_posed_or_not, proposal, takes


@takes(SEQUENCE)
def doctor(
    sequence: Annotated[
        str,
        typer.Argument(
            metavar="SEQ", help="Sequence folder or bag. FORMAT:PATH forces the format."
        ),
    ],
    json: Json = None,
    quiet: Quiet = False,
    *,
    options: dict[str, Any],
) -> None:
    """Diagnose a sequence and suggest fixes.

    Exit code 0: nothing found, 1: findings or no poses, 2: the data cannot be read.

    \b
    dynaviz doctor path/to/sequence
    dynaviz doctor kitti/sequences/08 --frames 0:200 --json findings.json
    dynaviz doctor files:scans --poses odometry.txt --sensor vlp16
    """
    from dynaviz.diagnosis import doctor as examine

    opened, unposed = open_posed_or_not(sequence, options)
    with progress(f"doctor on {opened.name}") as report:
        diagnosis = examine(opened, progress=report)
    if not print_json(diagnosis.to_dict(), json):
        show(diagnosis)
        if unposed:
            show(f"{opened.name} {unposed}, so only its scans were examined.")
            show(f"Estimate the poses and clean the map with: {proposal(sequence)}")
    if unposed or not diagnosis.ok:
        raise typer.Exit(1)
