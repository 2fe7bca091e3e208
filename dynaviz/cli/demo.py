"""dynaviz demo."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.console import program, progress, show


def demo(
    out: Annotated[
        Path, typer.Option("-o", "--out", help="Output folder for the sequence and the runs.")
    ] = Path("recordings/demo"),
    view: Annotated[
        bool | None,
        typer.Option(
            "--view/--no-view",
            help="Open the best run in the viewer. [default: if there is a display]",
        ),
    ] = None,
) -> None:
    """Simulate a street and run methods on it.

    Each run is scored and recorded, and the best two are compared.

    \b
    dynaviz demo
    dynaviz demo -o out --no-view
    """
    from dynaviz import api
    from dynaviz.contracts.params import read_toml
    from dynaviz.precompile import compiling, quick_to_compile
    from dynaviz.scores.result import result_table
    from dynaviz.synthetic.simulate import simulate

    folder = out / "street"
    facts = folder / "sequence.toml"
    if facts.is_file() and "generator" in read_toml(
        facts
    ):  # from an earlier demo; never delete a user's data
        shutil.rmtree(folder)
    names = list(quick_to_compile())
    with compiling(names), progress("street") as report:
        simulate("demo", folder, progress=lambda done, total: report("simulate", done, total))
    results = []
    for name in names:
        with progress(f"{name} on street") as report:
            results.append(
                api.run(
                    name, api.open(folder), out=out / name, command="dynaviz demo", progress=report
                )
            )
    best, second = sorted(results, key=lambda result: -(result.metrics.get("AA") or 0.0))[:2]
    recording = out / best.method / "run.rrd"
    comparison = out / "compare.rrd"
    with progress("compare the best two", unit="recordings") as report:
        api.compare(out / second.method / "run.rrd", recording, out=comparison, progress=report)
    command = program()
    show(
        result_table(results),
        f"The recording of each run is {out}/METHOD/run.rrd. Next steps:",
        f"  {command} info {recording} --failures",
        f"  {command} view {recording}",
        f"  {command} view {recording} -o {best.method}.png    (without a display)",
        f"  {command} view {comparison}    (how {best.method} differs from {second.method})",
        f"  {command} run {best.method} PATH/TO/YOUR/SEQUENCE",
        f"Click the failures, and see which scans decided a point: {command} explore "
        f"{recording.parent}",
    )
    if view or (view is None and should_open_viewer()):
        from dynaviz.views.read.view import view as open_viewer

        open_viewer([recording])


def should_open_viewer() -> bool:
    """Whether a window can open and the session is interactive."""
    from dynaviz.views.viewer import has_screen

    return has_screen() and sys.stdout.isatty() and "CI" not in os.environ
