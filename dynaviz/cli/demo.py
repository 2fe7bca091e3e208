"""dynaviz demo."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import program, progress, show


def add_to(app: typer.Typer) -> None:
    """Register the verb."""
    app.command("demo")(demo)


def demo(
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for the sequence and the recordings.")] = Path(
        "recordings/demo"
    ),
    view: Annotated[
        bool | None,
        typer.Option("--view/--no-view", help="Open the best run in a viewer. [default: where there is a screen]"),
    ] = None,
) -> None:
    """Simulate a street, clean it with every method, score and record each run.

    \b
    dynaviz demo
    dynaviz demo -o out --no-view
    """
    from dynaviz import api, registry
    from dynaviz.params import read_toml
    from dynaviz.precompile import compiling
    from dynaviz.results.tables import result_table
    from dynaviz.simulate import simulate

    folder = out / "street"
    facts = folder / "sequence.toml"
    if facts.is_file() and "generator" in read_toml(facts):  # of an earlier demo; a user's data stays
        shutil.rmtree(folder)
    names = list(registry.loadable("methods"))
    with compiling(), progress("simulating a street") as tell:
        simulate("demo", folder, progress=lambda done, total: tell("frames", done, total))
    results = []
    for name in names:
        with progress(name) as tell:
            results.append(api.run(name, api.open(folder), out=out / name, command="dynaviz demo", progress=tell))
    best, second = sorted(results, key=lambda result: -(result.metrics.get("AA") or 0.0))[:2]
    recording, comparison = out / best.method / "run.rrd", out / "compare.rrd"
    with progress("comparing the best two") as tell:
        api.compare(out / second.method / "run.rrd", recording, out=comparison, progress=tell)
    again = program()
    show(
        result_table(results),
        f"A recording of each run is in {out}/METHOD/run.rrd. What to type next:",
        f"  {again} failures {recording}",
        f"  {again} view {recording}",
        f"  {again} shot {recording} -o {best.method}.png    (without a screen)",
        f"  {again} view {comparison}    (how {best.method} differs from {second.method})",
        f"  {again} run {best.method} PATH/TO/YOUR/SEQUENCE",
    )
    if view or (view is None and somebody_looks()):
        from dynaviz.viz.view import view as open_viewer

        open_viewer([recording])


def somebody_looks() -> bool:
    """Whether a window can open and a person sits before it."""
    from dynaviz.viz.viewer import has_screen

    return has_screen() and sys.stdout.isatty() and "CI" not in os.environ
