"""dynaviz simulate."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import program, progress, show


def add_to(app: typer.Typer) -> None:
    """Register the verb."""
    app.command("simulate")(simulate)


def simulate(
    preset: Annotated[str, typer.Argument(help="A scene with its sensor (dynaviz list scenes).")],
    out: Annotated[Path, typer.Argument(help="Folder for the sequence; must not exist.")],
    frames: Annotated[int | None, typer.Option(min=1, help="How many sweeps. [default: the scene's own]")] = None,
    seed: Annotated[int, typer.Option(help="Another seed, another scene; the same seed, the same bytes.")] = 0,
) -> None:
    """Write a simulated sequence with exact ground truth, in the public benchmark's layout.

    \b
    dynaviz simulate street_hdl64 out/street
    dynaviz simulate hall_vlp16 out/hall --frames 200 --seed 7
    """
    from dynaviz.simulate import simulate as write

    with progress(f"simulating {preset}") as tell:
        folder = write(preset, out, frames=frames, seed=seed, progress=lambda done, total: tell("frames", done, total))
    show(f"Written to {folder}. Next: {program()} run octomap_gf {folder}")
