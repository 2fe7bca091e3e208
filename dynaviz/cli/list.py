"""dynaviz list."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Iterator
from enum import StrEnum
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dynaviz.cli.console import print_json, show
from dynaviz.cli.options import METHOD, Json, method_names, takes

if TYPE_CHECKING:
    from dynaviz.contracts.registry import PluginHandle


class Listing(StrEnum):
    """The lists to choose from."""

    methods = "methods"
    datasets = "datasets"
    metrics = "metrics"
    protocols = "protocols"
    reports = "reports"
    sensors = "sensors"
    presets = "presets"
    scenes = "scenes"
    odometries = "odometries"


def _methods() -> list[str]:
    return method_names("")


def _completions(incomplete: str) -> list[str]:
    return [name for name in Listing if name.startswith(incomplete)] + method_names(incomplete)


@takes(METHOD, without=("seed", "threads"))
def list_(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="KIND|NAME",
            help=f"{', '.join(Listing)}; or a method or sensor. [default: all lists]",
            autocompletion=_completions,
        ),
    ] = None,
    json: Json = None,
    *,
    options: dict[str, Any],
) -> None:
    """List methods, data sets and sensors, or parameters of a method.

    Parameters have a meaning, a unit, a range and a value, which is a default or set by a preset, a
    file or --set.

    \b
    dynaviz list
    dynaviz list methods
    dynaviz list octomap --preset av2 --set prob_hit=0.65
    dynaviz list vlp16
    """
    from dynaviz.contracts import registry
    from dynaviz.contracts.sensors import sensor_names
    from dynaviz.errors import UsageError

    if name in _methods():
        show_parameters(name, options, json)
        return
    if any(options.values()):
        raise UsageError(
            "--preset, --config and --set: only with a method. Give the name of a method"
        )
    if name is None or name in list(Listing):
        _show_lists([Listing(name)] if name else list(Listing), json)
    elif name in sensor_names() or name.endswith(".toml"):
        show_sensor(name, json)
    else:
        near = difflib.get_close_matches(name, [*Listing, *_methods(), *sensor_names()], 1)
        hint = registry.suggest(name, near or list(Listing))
        raise UsageError(f"list: unknown kind, method or sensor '{name}'. {hint}")


def _show_lists(chosen: list[Listing], json: Path | None) -> None:
    from rich.table import Table

    names = ("name", "description", "package")
    if json is not None:
        plain = {
            each.value: [dict(zip(names, row, strict=True)) for row in _rows(each.value)]
            for each in chosen
        }
        if print_json(plain, json):
            return
    for listing in chosen:
        table = Table(
            *names,
            title=listing.value,
            title_justify="left",
            box=None,
            pad_edge=False,
            min_width=60,
        )
        for row in _rows(listing.value):
            table.add_row(*row)
        show(table, "")


def _rows(kind: str) -> Iterator[tuple[str, str, str]]:
    from rich.markup import escape

    from dynaviz.contracts import registry

    if kind == "sensors":
        from dynaviz.contracts.sensors import load_sensor, sensor_names

        yield from ((name, load_sensor(name).title, "dynaviz") for name in sensor_names())
    elif kind == "presets":
        from dynaviz.contracts.params import preset_description

        for name, files in sorted(registry.preset_files().items()):
            yield (
                name,
                escape(preset_description(files)),
                ", ".join(sorted({file.parent.parent.name for file in files})),
            )
    elif kind == "scenes":
        from dynaviz.synthetic.simulate import PRESETS

        yield from ((name, preset.title, "dynaviz") for name, preset in PRESETS.items())
    else:
        for handle in registry.handles(kind):
            yield handle.name, _description(handle), f"{handle.distribution} {handle.version}"


def _description(handle: PluginHandle) -> str:
    """One or two lines about a plug-in; the error in red if it cannot be loaded."""
    from rich.markup import escape

    from dynaviz.errors import PluginError

    try:
        plugin = handle.load()
    except PluginError as error:
        return f"[red]{escape(str(error))}[/]"
    if handle.kind == "methods":
        return escape(f"{plugin.info.title} ({plugin.info.paper})")
    summary = (plugin.__doc__ or "").strip().partition("\n")[0]
    return escape(f"{summary}\n  {plugin.layout}" if handle.kind == "datasets" else summary)


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
        table.add_row(
            row["name"], shown, row["set_by"], escape(row["meaning"]), escape(row["range"])
        )
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
