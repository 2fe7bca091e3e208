"""dynaviz config."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import show


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("config")(config)


def config(
    method: Annotated[str, typer.Argument(metavar="METHOD", help="Method name; see 'dynaviz list methods'.")],
    preset: Annotated[
        str | None, typer.Option(metavar="NAME", help="Published parameter set; see 'dynaviz list presets'.")
    ] = None,
    file: Annotated[Path | None, typer.Option("--config", metavar="FILE", help="TOML file with parameters.")] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Set one parameter. Repeatable.")
    ] = None,
    sensor: Annotated[
        str | None, typer.Option(metavar="NAME", help="Also show this sensor; see 'dynaviz list sensors'.")
    ] = None,
) -> None:
    """Show the parameters of a method.

    Lists each value and where it is set: default, preset, file or --set.

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
        properties = Table("property", "value", title=f"sensor {sensor}", title_justify="left")
        for name, value in dataclasses.asdict(load_sensor(sensor)).items():
            properties.add_row(name, repr(value))
        show(properties)
