"""dynaviz config."""

from __future__ import annotations

import dataclasses
from dataclasses import asdict
from json import dumps
from typing import Annotated, Any

import typer

from dynaviz.cli.console import print_json, show
from dynaviz.cli.options import METHOD, Json, Method, sensor_completions, takes


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("config")(config)


@takes(METHOD, without=("seed", "threads"))
def config(
    method: Method,
    sensor: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE.toml",
            help="Also show this sensor; see 'dynaviz list sensors'.",
            autocompletion=sensor_completions,
        ),
    ] = None,
    json: Json = None,
    *,
    options: dict[str, Any],
) -> None:
    """Show the parameters of a method.

    Lists the meaning, unit and range of each parameter, its value, and where it is set: default, preset, file or --set.

    \b
    dynaviz config octomap_gf
    dynaviz config octomap --preset av2 --set prob_hit=0.65
    """
    from rich.markup import escape
    from rich.table import Table

    from dynaviz.contracts import params, registry
    from dynaviz.contracts.sensors import load_sensor

    kind = registry.load("methods", method)
    resolved = params.resolve(kind, **options)
    described = params.describe(kind.Params)
    rows = [
        {"name": name, "value": getattr(resolved.params, name), "set_by": resolved.source[name], **asdict(each)}
        for name, each in described.items()
    ]
    if print_json({"method": method, "parameters": rows}, json):
        return
    columns = ("parameter", "value", "set by", "meaning", "range")
    table = Table(*columns, title=f"{kind.info.title}: parameters", title_justify="left")
    for row in rows:
        shown = dumps(row["value"])
        table.add_row(row["name"], shown, row["set_by"], escape(row["meaning"]), escape(row["range"]))
    show(table)
    if sensor:
        properties = Table("property", "value", title=f"sensor {sensor}", title_justify="left")
        for name, value in dataclasses.asdict(load_sensor(sensor)).items():
            properties.add_row(name, repr(value))
        show(properties)
