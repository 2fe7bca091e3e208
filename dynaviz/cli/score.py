"""dynaviz score."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from dynaviz.cli.console import print_json, progress, show, written
from dynaviz.cli.options import (
    SEQUENCE,
    Json,
    Moved,
    Quiet,
    Record,
    Review,
    Threads,
    refuse,
    takes,
    typed_command,
)

RADIUS = 0.05  # metres


@takes(SEQUENCE)
def score(
    map: Annotated[
        Path,
        typer.Argument(
            metavar="MAP",
            help="Cleaned map in the sequence's world frame (pcd, ply, las, laz, npy), folder with "
            "a .label, .npy or "
            ".npz file per scan, or labels.npz.",
        ),
    ],
    sequence: Annotated[
        str | None,
        typer.Argument(
            metavar="[SEQ]",
            help="Sequence with ground truth. FORMAT:PATH forces the format. Without it, MAP is a "
            "run to rescore.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="Output folder. [default: recordings/SEQUENCE/NAME]"),
    ] = None,
    radius: Annotated[
        float,
        typer.Option(
            help="A point counts as kept if the map has a point within this radius, in metres."
        ),
    ] = RADIUS,
    name: Annotated[
        str | None, typer.Option(help="Name in tables. [default: the name of the file or folder]")
    ] = None,
    key: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Name of the array with the labels, for .npz files with several arrays.",
        ),
    ] = None,
    review: Review = None,
    record: Record = "errors",
    threads: Threads = None,
    moved: Moved = None,
    json: Json = None,
    quiet: Quiet = False,
    *,
    options: dict[str, Any],
) -> None:
    """Score maps or labels of other programs, or rescore a run.

    Writes labels, maps, scores and a recording.

    \b
    dynaviz score erasor_output.pcd path/to/sequence
    dynaviz score cleaned.laz path/to/sequence --radius 0.1 -o out/cleaned
    dynaviz score mapmos/sequences/08/predictions kitti/sequences/08 --name mapmos
    dynaviz score recordings/demo/octomap/labels.npz path/to/demo --name again
    dynaviz score recordings/demo/octomap --review review.json

    Label files are named by frame number (000000.label). They contain 0 and 1, or classes of
    SemanticKITTI, of which 251 and above are moving. Scans without a file are not scored.

    With a run alone, this shows its scores against the ground truth that decisions state: those
    of --review, or in the review.json of the run, which the explorer writes. The files of the run
    and its sequence do not change.
    """
    if sequence is None:
        own = {"out": out, "name": name, "key": key, "json": json, "threads": threads}
        refuse(
            {**options, **own, "radius": radius != RADIUS, "record": record},
            "a run alone. Give SEQ, too",
        )
        from dynaviz.runs.reviewed import reviewed_scores

        show(str(reviewed_scores(map, moved, review)))
        return
    refuse({"sequence": moved}, "SEQ")
    from dynaviz import api
    from dynaviz.engine.external import default_name

    opened = api.open(sequence, **options)
    label = default_name(map) if name is None else name
    folder = out or Path("recordings") / opened.name / label
    with progress(f"{label} on {opened.name}") as report:
        result = api.score(
            map,
            opened,
            radius=radius,
            name=name,
            key=key,
            out=folder,
            record=record,
            threads=threads,
            review=review,
            command=typed_command(),
            progress=report,
        )
    if not print_json(result.to_dict(), json):
        show(result, written(folder, record != "none"))
