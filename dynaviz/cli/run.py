"""dynaviz run."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Any

import typer

from dynaviz.cli.console import print_json, program, progress, show, written
from dynaviz.cli.options import RUN, SEQUENCE, Json, Method, Quiet, takes, typed_command


@takes(SEQUENCE, RUN)
def run(
    method: Method,
    sequence: Annotated[
        list[str],
        typer.Argument(
            metavar="SEQ",
            help="Sequence folder or bag; several drives in one world frame are one sequence. "
            "FORMAT:PATH forces the "
            "format.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="Output folder. [default: recordings/SEQUENCE/METHOD]"),
    ] = None,
    json: Json = None,
    quiet: Quiet = False,
    *,
    options: dict[str, Any],
) -> None:
    """Run a method on a sequence.

    Writes labels, maps, scores and a recording.

    \b
    dynaviz run octomap_gf path/to/sequence
    dynaviz run octomap kitti/sequences/08 --frames 0:100 -o out/08
    dynaviz run octomap path/to/sequence --set resolution=0.2 --record scores
    dynaviz run dufomap path/to/scans --poses trajectory.tum
    dynaviz run dufomap "drive.bag#/velodyne_points" --poses map
    dynaviz run seethrough monday/ tuesday/ --tiles 200 --workers 4
    """
    from dynaviz.precompile import compiling_the_rest
    from dynaviz.runs.execution import run_method
    from dynaviz.runs.options import split
    from dynaviz.sources.opening import open_source

    opening, running = split(options)
    with progress("open") as report:
        source = sequence if len(sequence) > 1 else sequence[0]
        opened = open_source(source, opening.without_refinement, progress=report)
    folder = out or Path("recordings") / opened.name / method
    with compiling_the_rest(method), progress(f"{method} on {opened.name}") as report:
        result = run_method(
            method,
            opened,
            running,
            out=folder,
            refine_poses=opening.refine_poses,
            command=typed_command(),
            progress=report,
        )
    if print_json(result.to_dict(), json):
        return
    from dynaviz.cli.cases import top_of

    command = f"{program()} info {shlex.quote(str(folder))} --failures"
    show(result, *top_of(result, command), written(folder, running.record != "none"))
