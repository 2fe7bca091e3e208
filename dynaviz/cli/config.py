"""dynaviz config."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import show


def add_to(app: typer.Typer) -> None:
    """Register the verb."""
    app.command("config")(config)


def config(
    method: Annotated[str, typer.Argument(help="A method's name (dynaviz list methods).")],
    preset: Annotated[str | None, typer.Option(help="Published parameters (dynaviz list presets).")] = None,
    file: Annotated[Path | None, typer.Option("--config", help="TOML file with parameters.")] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="One parameter; may be repeated.")
    ] = None,
    sensor: Annotated[str | None, typer.Option(help="Also show the facts of a sensor (dynaviz list sensors).")] = None,
) -> None:
    """Show every parameter of a method, its value, and which layer set it.

    \b
    dynaviz config octomap_gf
    dynaviz config octomap --preset av2 --set prob_hit=0.65
    """
    from rich.table import Table

    from dynaviz import params, registry
    from dynaviz.sensors import load_sensor

    kind = registry.load("methods", method)
    resolved = params.resolve(kind, preset, file, settings or ())
    table = Table("parameter", "value", "set by", title=f"{kind.info.title}: parameters", title_justify="left")
    for field in dataclasses.fields(resolved.params):
        table.add_row(field.name, json.dumps(getattr(resolved.params, field.name)), resolved.source[field.name])
    show(table)
    if sensor:
        facts = Table("fact", "value", title=f"sensor {sensor}", title_justify="left")
        for name, value in dataclasses.asdict(load_sensor(sensor)).items():
            facts.add_row(name, repr(value))
        show(facts)
