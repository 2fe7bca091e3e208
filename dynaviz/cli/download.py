"""dynaviz download."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import program, progress, show


def add_to(app: typer.Typer) -> None:
    """Register the verb."""
    app.command("download")(download)


def download(
    name: Annotated[str, typer.Argument(help="00, 05, av2, semindoor; without ground truth: twofloor, kthcampus.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder in which the folder NAME is made.")] = Path("data"),
    url: Annotated[
        str | None,
        typer.Option(
            envvar="DYNAVIZ_DOWNLOAD_URL",
            metavar="ADDRESS",
            help="Another place that has NAME.zip. [default: the benchmark's record on Zenodo]",
        ),
    ] = None,
) -> None:
    """Download a sequence of the public benchmark.

    \b
    dynaviz download 00
    dynaviz download semindoor -o /data/benchmark
    dynaviz download 05 --url https://mirror.example.org/benchmark

    An interrupted download goes on where it stopped. The archive is checked, unpacked and removed; NAME.download.json
    beside the sequence keeps its checksum. sequence.toml with the sensor is added. docs/datasets.md has the licences.
    """
    from dynaviz.datasets.download import BASE, SEQUENCES
    from dynaviz.datasets.download import download as fetch

    with progress(name) as tell:
        folder = fetch(name, out, url or BASE, tell)
    scores = "" if SEQUENCES[name].labelled else " It has no ground truth, so runs have no scores."
    show(f"Written to {folder}: {SEQUENCES[name].title}.{scores}", f"Next: {program()} run octomap_gf {folder}")
