"""dynaviz implant."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Annotated, Any

import typer

from dynaviz.cli.console import program, progress, show
from dynaviz.cli.options import SEQUENCE, takes


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("implant")(implant)


@takes(SEQUENCE)
def implant(
    sequence: Annotated[
        str, typer.Argument(metavar="SEQ", help="Sequence folder or bag. FORMAT:PATH forces the format.")
    ],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Output folder. Must not exist.")],
    cars: Annotated[int, typer.Option(min=0, metavar="N", help="Cars that drive; every third waits on its way.")] = 4,
    trucks: Annotated[int, typer.Option(min=0, metavar="N", help="Trucks.")] = 1,
    cyclists: Annotated[int, typer.Option(min=0, metavar="N", help="Cyclists.")] = 2,
    persons: Annotated[
        int, typer.Option(min=0, metavar="N", help="Persons; every second walks close to walls and other obstacles.")
    ] = 6,
    parks: Annotated[int, typer.Option(min=0, metavar="N", help="Cars that arrive and park, in addition.")] = 1,
    seed: Annotated[
        int, typer.Option(min=0, metavar="N", help="Random seed. The same seed gives identical files.")
    ] = 0,
    scene: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Scene file (implants.toml) instead of numbers and seed.")
    ] = None,
    panel: Annotated[
        str | None,
        typer.Option(
            metavar="METHODS",
            help="Without labels: methods, separated by commas, that vote on which points are static; or 'none'. "
            "[default: three fast methods]",
        ),
    ] = None,
    *,
    options: dict[str, Any],
) -> None:
    """Put movers with exact ground truth into a recorded sequence.

    Writes the public benchmark's layout and implants.toml, the scene file. Static world, noise and poses stay yours.

    \b
    dynaviz implant path/to/sequence out/implants --cars 6 --persons 10 --seed 3
    dynaviz implant path/to/sequence out/again --scene out/implants/implants.toml
    dynaviz run dufomap "implant:path/to/sequence?cars=6&seed=3"
    """
    from dynaviz import api
    from dynaviz.synthetic.implants.implant_options import ImplantOptions
    from dynaviz.synthetic.implants.implanted_sequence import ImplantedSequence
    from dynaviz.synthetic.implants.panel import default_panel
    from dynaviz.synthetic.implants.write_implants import SCENE_FILE, write

    opened = api.open(sequence, **options)
    methods: tuple[str, ...] = () if opened.has_labels else default_panel()
    if panel is not None:
        methods = () if panel == "none" else tuple(filter(None, panel.split(",")))
    movers = ImplantOptions(
        cars=cars,
        trucks=trucks,
        cyclists=cyclists,
        persons=persons,
        parks=parks,
        seed=seed,
        scene=None if scene is None else str(scene),
        panel=methods,
    )
    with progress(f"implant {opened.name}") as report:
        implanted = ImplantedSequence.of(opened, movers, report)
        done = write(implanted, out, lambda frame, total: report("write", frame, total))
    for remark in done.remarks():
        warnings.warn(remark, stacklevel=1)
    show(f"Written to {out}: {done.frames:,} frames, {done.points:,} points; scene in {out / SCENE_FILE}.")
    for name, fact in implanted.facts.items():
        show(f"{name.capitalize()}: {fact}.")
    show(f"Next: {program()} run METHOD {out}")
