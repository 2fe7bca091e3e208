"""The parameters of a method, and the properties of a sensor, as tables."""

from __future__ import annotations

import dataclasses
from json import dumps
from pathlib import Path
from typing import Any

from dynaviz.cli.console import print_json, show


def show_parameters(method: str, options: dict[str, Any], json: Path | None) -> None:
    """Print each parameter with its value, meaning, range, and where it is set.

    Args:
        method: name of the method.
        options: preset, config and settings, as ``dynaviz.run`` takes them.
        json: where to write the same as JSON; ``-`` for standard output, instead of the table.
    """
    from rich.markup import escape
    from rich.table import Table

    from dynaviz.contracts import params, registry

    kind = registry.load("methods", method)
    resolved = params.resolve(kind, **options)
    described = params.describe(kind.Params)
    rows = [
        {
            "name": name,
            "value": getattr(resolved.params, name),
            "set_by": resolved.source[name],
            **dataclasses.asdict(each),
        }
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


def show_sensor(name: str, json: Path | None) -> None:
    """Print the properties of a sensor, given its name or its TOML file."""
    from rich.table import Table

    from dynaviz.contracts.sensors import load_sensor

    properties = dataclasses.asdict(load_sensor(name))
    if print_json({"sensor": name, "properties": properties}, json):
        return
    table = Table("property", "value", title=f"sensor {name}", title_justify="left")
    for field, value in properties.items():
        table.add_row(field, repr(value))
    show(table)
