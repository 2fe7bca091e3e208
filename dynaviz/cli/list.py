"""dynaviz list."""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from dynaviz.cli.console import print_json, show
from dynaviz.cli.options import Json

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


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command("list")(list_)


def list_(
    kind: Annotated[Listing | None, typer.Argument(metavar="KIND", help="What to list. [default: all]")] = None,
    json: Json = None,
) -> None:
    """List methods, datasets, sensors, presets and scenes.

    Also lists the installed metrics, protocols and report formats.

    \b
    dynaviz list
    dynaviz list methods
    """
    from rich.table import Table

    chosen = [kind] if kind else list(Listing)
    if json is not None:
        names = ("name", "description", "package")
        plain = {each.value: [dict(zip(names, row, strict=True)) for row in _rows(each.value)] for each in chosen}
        if print_json(plain, json):
            return
    for listing in chosen:
        table = Table(
            "name",
            "description",
            "package",
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
