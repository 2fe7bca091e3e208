"""dynaviz explore."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynaviz.cli.options import refuse, run_in


def explore(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run's folder, or its run.rrd.")],
    others: Annotated[
        list[Path] | None,
        typer.Argument(metavar="OTHER", help="Up to eight runs on the same frames, to compare."),
    ] = None,
    case: Annotated[
        int | None,
        typer.Option(
            min=1, show_default=False, help="Open at this case. [default: the costliest one]"
        ),
    ] = None,
    port: Annotated[
        int,
        typer.Option(
            min=0,
            max=65535,
            show_default=False,
            help="Port on this machine. [default: any free one]",
        ),
    ] = 0,
    export: Annotated[
        Path | None,
        typer.Option(
            metavar="PAGE.html",
            help="Write the page as one file that opens offline and without dynaviz, and exit.",
        ),
    ] = None,
    browser: Annotated[
        bool, typer.Option(help="Open the page in a browser if there is a screen.")
    ] = True,
) -> None:
    """Explore a run in a browser: its failures and their reasons.

    The server is only reachable from this machine, with the token in the address.

    \b
    dynaviz explore recordings/demo/octomap
    dynaviz explore recordings/demo/octomap recordings/demo/octomap_gf
    dynaviz explore recordings/demo/octomap --export octomap.html
    """
    import webbrowser

    if export is not None:
        refuse({"case": case, "port": port}, "--export")
        _export(export, [run, *(others or ())])
        return
    from dynaviz.explorer import explore as start
    from dynaviz.views.viewer import has_screen

    with start(*map(run_in, (run, *(others or ()))), port=port) as server:
        url = server.url if case is None else f"{server.url}?case={case}"
        print(f"Explore at {url} until interrupted (Ctrl-C).", flush=True)
        if browser and has_screen():
            webbrowser.open(url)
        server.wait()


def _export(page: Path, runs: list[Path]) -> None:
    from dynaviz.cli.console import progress, show
    from dynaviz.explorer import export_page

    with progress("explore", unit="cases") as report:
        export_page(page, *map(run_in, runs), progress=report)
    show(f"Written to {page}. It opens in any browser, offline.")
