"""dynaviz download."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import program, progress, show


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("download")(download)


def download(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="00, 05, av2 or semindoor; without ground truth: twofloor, kthcampus.")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="Parent folder of the new folder NAME.")] = Path("data"),
    url: Annotated[
        str | None,
        typer.Option(
            envvar="DYNAVIZ_DOWNLOAD_URL",
            metavar="URL",
            help="Mirror that serves NAME.zip. [default: the benchmark's record on Zenodo]",
        ),
    ] = None,
) -> None:
    """Download a sequence of the public benchmark.

    \b
    dynaviz download 00
    dynaviz download semindoor -o /data/benchmark
    dynaviz download 05 --url https://mirror.example.org/benchmark

    An interrupted download resumes. The archive is verified, unpacked and deleted; its checksum is kept in
    NAME.download.json next to the sequence. A sequence.toml with the sensor is added. The data keep
    their original licences.
    """
    from dynaviz.sources.datasets.download import BASE, SEQUENCES
    from dynaviz.sources.datasets.download import download as fetch

    with progress(name, unit={"fetch": "MB", "unpack": "files"}) as report:
        folder = fetch(name, out, url or BASE, report)
    remark = "" if SEQUENCES[name].labelled else " It has no ground truth, so runs on it have no scores."
    show(f"Written to {folder}: {SEQUENCES[name].title}.{remark}", f"Next: {program()} run METHOD {folder}")
