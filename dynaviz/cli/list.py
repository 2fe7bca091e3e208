"""dynaviz list."""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import show


class Listing(StrEnum):
    """What can be listed."""

    methods = "methods"
    datasets = "datasets"
    metrics = "metrics"
    reports = "reports"
    sensors = "sensors"
    presets = "presets"
    scenes = "scenes"


def add_to(app: typer.Typer) -> None:
    """Register the verb."""
    app.command("list")(list_)


def list_(what: Annotated[Listing | None, typer.Argument(help="Only these. [default: everything]")] = None) -> None:
    """List methods, datasets, metrics, formats of reports, sensors, parameter presets and simulated scenes.

    \b
    dynaviz list
    dynaviz list methods
    """
    from rich.table import Table

    for kind in [what] if what else list(Listing):
        table = Table(
            "name", "what", "from", title=kind.value, title_justify="left", box=None, pad_edge=False, min_width=60
        )
        for row in _rows(kind.value):
            table.add_row(*row)
        show(table, "")


def _rows(kind: str) -> Iterator[tuple[str, str, str]]:
    from rich.markup import escape

    from dynaviz import registry
    from dynaviz.errors import PluginError

    if kind == "sensors":
        from dynaviz.sensors import load_sensor, sensor_names

        yield from ((name, load_sensor(name).title, "dynaviz") for name in sensor_names())
    elif kind == "presets":
        for name, files in sorted(registry.preset_files().items()):
            yield name, _remark(files[0]), ", ".join(sorted({file.parent.parent.name for file in files}))
    elif kind == "scenes":
        from dynaviz.simulate import PRESETS

        yield from ((name, preset.title, "dynaviz") for name, preset in PRESETS.items())
    else:
        for handle in registry.handles(kind):
            try:
                text = _title(handle.load())
            except PluginError as error:
                text = f"[red]{escape(str(error))}[/]"
            yield handle.name, text, f"{handle.distribution} {handle.version}"


def _remark(preset: Path) -> str:
    """The first remark in a file of parameters, to its first colon."""
    return preset.read_text("utf-8").partition("\n")[0].lstrip("# ").partition(":")[0]


def _title(plugin: object) -> str:
    info = getattr(plugin, "info", None)
    if info:
        return f"{info.title} ({info.paper})"
    first, layout = (plugin.__doc__ or "").strip().splitlines()[0], getattr(plugin, "layout", None)
    return f"{first}\n  {layout}" if layout else first
