"""dynaviz simulate."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import program, progress, show


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("simulate")(simulate)


def simulate(
    preset: Annotated[
        str, typer.Argument(metavar="SCENE", help="Scene with its sensor, and options; see 'dynaviz list scenes'.")
    ],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Output folder. Must not exist.")],
    frames: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Number of sweeps. [default: set by the scene]")
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(metavar="N", help="Random seed. The same seed gives identical files.", show_default="0"),
    ] = None,
) -> None:
    """Simulate a sequence with exact ground truth.

    Writes it in the public benchmark's layout. Scenes that end in _real have the effects of real scans; single effects
    are options of the scene, separated by &.

    \b
    dynaviz simulate street_hdl64 out/street
    dynaviz simulate hall_vlp16 out/hall --frames 200 --seed 7
    dynaviz simulate street_hdl64_real out/real
    dynaviz simulate "street_hdl64?jitter_m=0.03&brushing=6" out/jitter
    dynaviz run dufomap "simulate:street_hdl64?frames=20&jitter_m=0.03"
    """
    from dynaviz.synthetic.simulate import simulate as write

    with progress(preset.partition("?")[0]) as report:
        folder = write(
            preset, out, frames=frames, seed=seed, progress=lambda done, total: report("simulate", done, total)
        )
    show(f"Written to {folder}. Next: {program()} run METHOD {folder}")
