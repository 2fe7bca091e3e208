"""dynaviz clean."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dynaviz.cli.console import print_json, program, progress, show, warn
from dynaviz.cli.options import (
    RUN,
    SEQUENCE,
    Json,
    Moved,
    Quiet,
    method_names,
    refuse,
    takes,
    typed_command,
)
from dynaviz.contracts.registry import BEST

if TYPE_CHECKING:
    from dynaviz.cleaning import Cleaned

TILES = Annotated[
    str | None,
    typer.Option(
        metavar="METRES|autoware",
        help="Run on squares of this size, for drives of any length, and write a file for each "
        "into a folder, or "
        "Autoware's divided map if MAP has no suffix; 'autoware' writes one without dividing the "
        "run.",
    ),
]


@takes(SEQUENCE, {**RUN, "tiles": TILES}, without=("maps",))
def clean(
    sequence: Annotated[
        list[str],
        typer.Argument(
            metavar="SEQ|RUN",
            help="Bag, folder of scans or sequence; several drives in one world frame make one "
            "map. FORMAT:PATH forces "
            "the format. A run's folder: write its map again, with the decisions about it.",
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "-o",
            "--out",
            metavar="MAP",
            help="Clean map: pcd, ply, las, laz or npz; a folder for tiles.",
        ),
    ],
    method: Annotated[
        str,
        typer.Option(
            "-m", "--method", metavar="METHOD", help="Method.", autocompletion=method_names
        ),
    ] = BEST,
    region: Annotated[
        str | None,
        typer.Option(
            metavar="BOX|FILE",
            help="Write only points inside: X0,Y0,X1,Y1 or X0,Y0,Z0,X1,Y1,Z1, or a file with the "
            "corners of a polygon.",
        ),
    ] = None,
    voxel_size: Annotated[
        float | None, typer.Option(metavar="METRES", help="Write one point per voxel of this size.")
    ] = None,
    keep_dynamic: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the removed points to this file.")
    ] = None,
    mark: Annotated[
        bool,
        typer.Option(
            "--mark", help="Write all points, with the attributes 'dynamic' and 'reason'."
        ),
    ] = False,
    drop_unposed: Annotated[
        bool,
        typer.Option(
            "--drop-unposed", help="Discard points without a pose instead of keeping them."
        ),
    ] = False,
    changed: Annotated[
        bool, typer.Option("--changed", help="Also find what changed between two drives.")
    ] = False,
    accept: Annotated[
        bool,
        typer.Option(
            "--accept", help="Exit with 0 even if much was removed or the poses are likely wrong."
        ),
    ] = False,
    moved: Moved = None,
    json: Json = None,
    quiet: Quiet = False,
    *,
    options: dict[str, Any],
) -> None:
    """Remove moving objects: from raw data to a clean map.

    Poses are estimated with small-gicp if there are none. Intensity, ring, time and all other
    attributes are kept. Writes the map, and next to it a folder with a summary, the labels and a
    recording. Exit code 3: the map is written, but more than 30 % of its points were removed, or
    the poses are likely wrong; --accept gives 0 instead.

    With the folder of a run, the map is written from its labels and the decisions in its
    review.json, without running the method: with the same attributes, marks and tiles as the first.

    \b
    dynaviz clean drive.bag -o clean.laz
    dynaviz clean clean_run -o signed.laz
    dynaviz clean drive.bag -o clean.laz --review review.json
    dynaviz clean scans/ --poses trajectory.tum -o clean.pcd --voxel-size 0.1
    dynaviz clean drive.mcap -o map --tiles autoware --keep-dynamic removed.pcd
    dynaviz clean city/ -o city.laz --tiles 200 --workers 4
    dynaviz clean monday/ tuesday/ -o both.laz --changed
    dynaviz clean survey.laz --poses trajectory.csv -o clean.laz --region
    500100,5400200,500300,5400400
    """
    from dynaviz import cleaning
    from dynaviz.cleaning.reviewing import run_of
    from dynaviz.precompile import compiling_the_rest

    if len(sequence) == 1 and (run := run_of(sequence[0])) is not None:
        own = {**options, "review": None, "changed": changed, "method": method != BEST}
        refuse(own, "a run")
        options = {name: options[name] for name in ("review", "record")}
        written: dict[str, Any] = {
            "region": region, "voxel_size": voxel_size, "keep_dynamic": keep_dynamic,
            "mark": mark, "drop_unposed": drop_unposed,
        }  # fmt: skip
        with progress(f"write the map of {run}") as report:
            review = cleaning.Review(run, options["review"], moved, report)
            again = review.write(out, command=typed_command(), progress=report, **written)
        _show(again, options, accept, json)
        return
    refuse({"sequence": moved}, "SEQ")
    with compiling_the_rest(method), progress(f"clean {' '.join(sequence)}") as report:
        cleaned = cleaning.clean(
            sequence if len(sequence) > 1 else sequence[0],
            out,
            method=method,
            region=region,
            voxel_size=voxel_size,
            keep_dynamic=keep_dynamic,
            mark=mark,
            drop_unposed=drop_unposed,
            changed=changed,
            command=typed_command(),
            progress=report,
            **options,
        )
    _show(cleaned, options, accept, json)


def _show(cleaned: Cleaned, options: dict[str, Any], accept: bool, json: Path | None) -> None:
    """Print the summary, and what to do next; exit with 3 if the map is doubtful."""
    printed = print_json(cleaned.to_dict(), json)
    if not printed:
        show(cleaned, f"Written to {cleaned.maps[0].path} and {cleaned.folder}.")
        if options["record"] != "none":
            recording = shlex.quote(str(cleaned.folder / "run.rrd"))
            show(
                f"Check what was removed with: {program()} view {recording}",
                f"or: {program()} explore {recording}",
            )
            if cleaned.changes:
                show(
                    f"Check what changed with: {program()} explore "
                    f"{shlex.quote(str(cleaned.changes.folder))}"
                )
    if cleaned.doubt and not accept:
        if printed:
            warn(cleaned.doubt)
        else:
            warn(
                "Check this map before you use it: why is said at the top of the summary. "
                "Exit code 3; --accept gives 0."
            )
        raise typer.Exit(3)
