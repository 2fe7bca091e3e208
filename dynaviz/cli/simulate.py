"""dynaviz simulate."""

from __future__ import annotations

import dataclasses
import warnings
from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import program, progress, show
from dynaviz.errors import UsageError

IMPLANT = "implant:"


def simulate(
    scene: Annotated[
        str,
        typer.Argument(
            metavar="SCENE|implant:SEQ",
            help="Scene with its sensor, see 'dynaviz list scenes'; or a sequence to put movers "
            "into. Options of both "
            "follow ?.",
        ),
    ],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Output folder. Must not exist.")],
    frames: Annotated[
        str | None,
        typer.Option(
            metavar="N|A:B",
            help="Number of sweeps of a scene, or frames of SEQ. [default: set by the scene; all]",
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            metavar="N", help="Random seed. The same seed gives identical files.", show_default="0"
        ),
    ] = None,
) -> None:
    """Simulate a labelled sequence, or add movers to a recorded one.

    Writes it in the public benchmark's layout. Scenes that end in _real have the effects of real
    scans; single effects are options of the scene, separated by &.

    \b
    dynaviz simulate street_hdl64 out/street
    dynaviz simulate hall_vlp16 out/hall --frames 200 --seed 7
    dynaviz simulate street_hdl64_real out/real
    dynaviz simulate "street_hdl64?jitter_m=0.03&brushing=6" out/jitter
    dynaviz simulate "implant:path/to/sequence?cars=6&persons=10" out/implants --seed 3
    dynaviz simulate "implant:path/to/sequence?scene=out/implants/implants.toml" out/again
    dynaviz run dufomap "simulate:street_hdl64?frames=20&jitter_m=0.03"

    Options for a recorded sequence: numbers of cars, trucks, cyclists, persons, and parks (cars
    that arrive and park). The scene file implants.toml is written with the sequence; scene=FILE
    uses it again. The static world, the noise and the poses of SEQ do not change. If SEQ has no
    labels, the methods of panel=A,B,C vote on which points are static (default: three fast methods;
    panel=none: no vote). If SEQ needs options, such as poses, convert it first.
    """
    if scene.startswith(IMPLANT):
        _implant(scene.removeprefix(IMPLANT), out, seed, frames)
    else:
        _simulate(scene, out, frames, seed)


def _simulate(scene: str, out: Path, frames: str | None, seed: int | None) -> None:
    from dynaviz.synthetic.simulate import simulate as write

    if frames is not None and not frames.isdecimal():
        raise UsageError(
            f"--frames {frames}: a scene takes a number of sweeps, such as --frames 200"
        )
    number = None if frames is None else int(frames)
    with progress(scene.partition("?")[0]) as report:
        folder = write(
            scene,
            out,
            frames=number,
            seed=seed,
            progress=lambda done, total: report("simulate", done, total),
        )
    show(f"Written to {folder}. Next: {program()} run METHOD {folder}")


def _implant(text: str, out: Path, seed: int | None, frames: str | None) -> None:
    from dynaviz import api
    from dynaviz.synthetic.implants.implant_options import parse
    from dynaviz.synthetic.implants.implanted_sequence import SCENE_FILE, ImplantedSequence, write
    from dynaviz.synthetic.implants.panel import default_panel

    path, movers = parse(text)
    if seed is not None:
        movers = dataclasses.replace(movers, seed=seed)
    opened = api.open(path, frames=frames)
    chosen = any(part.startswith("panel=") for part in text.partition("?")[2].split("&"))
    if not chosen and not opened.has_labels:
        movers = dataclasses.replace(movers, panel=default_panel())
    with progress(f"implant {opened.name}") as report:
        implanted = ImplantedSequence.of(opened, movers, report)
        done = write(implanted, out, lambda frame, total: report("write", frame, total))
    for remark in done.remarks():
        warnings.warn(remark, stacklevel=1)
    show(
        f"Written to {out}: {done.frames:,} frames, {done.points:,} points; scene in "
        f"{out / SCENE_FILE}."
    )
    for name, fact in implanted.facts.items():
        show(f"{name.capitalize()}: {fact}.")
    show(f"Next: {program()} run METHOD {out}")
