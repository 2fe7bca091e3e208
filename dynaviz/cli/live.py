"""dynaviz live."""

from __future__ import annotations

import contextlib
import functools
import shlex
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dynaviz.cli.console import print_json, program, progress, show
from dynaviz.cli.options import METHOD, SEQUENCE, Json, Quiet, method_names, takes
from dynaviz.contracts.registry import BEST

if TYPE_CHECKING:
    from dynaviz.online.player import PlayReport


@takes(SEQUENCE, METHOD)
def live(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE", help="Bag, MCAP file, folder of scans or sequence to play."
        ),
    ],
    method: Annotated[
        str,
        typer.Option(
            "-m", "--method", metavar="METHOD", help="Method.", autocompletion=method_names
        ),
    ] = BEST,
    rate: Annotated[
        float,
        typer.Option(metavar="X", help="Speed; 0 labels every scan as fast as possible."),
    ] = 1.0,
    reach: Annotated[
        float,
        typer.Option(
            metavar="METRES",
            help="Label points, and keep the map, up to this distance from the sensor.",
        ),
    ] = 60.0,
    view: Annotated[bool, typer.Option("--view", help="Show the scans in the viewer.")] = False,
    serve: Annotated[
        bool, typer.Option("--serve", help="Show the scans in a browser on this machine.")
    ] = False,
    port: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=65534,
            metavar="PORT",
            help="Port of the page, with --serve. The next port is also used.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o", "--out", metavar="FOLDER", help="Record the last minutes into this folder."
        ),
    ] = None,
    minutes: Annotated[
        float, typer.Option(metavar="N", help="Length of that recording in minutes.")
    ] = 5.0,
    json: Json = None,
    quiet: Quiet = False,
    *,
    options: dict[str, Any],
) -> None:
    """Feed a recording to a method scan by scan, as a sensor would.

    Memory is bounded. A scan is dropped if the next one arrives before the method is ready. The
    report shows how many scans were dropped, and the latency of the others.

    \b
    dynaviz live drive.mcap --view
    dynaviz live drive.bag -m dufomap --serve --port 9090
    dynaviz live simulate:demo --rate 0 -o recordings/live --minutes 2
    """
    from dynaviz import api
    from dynaviz.runs.options import MethodOptions
    from dynaviz.runs.playback import play_live

    method_options = {name: options.pop(name) for name in METHOD}
    sequence = api.open(source, **options)
    with contextlib.ExitStack() as bar:

        def finished(played: PlayReport) -> None:
            bar.close()
            _report(played, json, out)
            if serve and sys.stdin.isatty():
                print("The page stays until you press Ctrl-C.", file=sys.stderr)
                _wait()

        play_live(
            sequence,
            method,
            rate=rate,
            reach=reach,
            options=MethodOptions(**method_options),
            view=view,
            serve=serve,
            port=port,
            out=out,
            minutes=minutes,
            progress=bar.enter_context(progress(f"live {source}")),
            announce=functools.partial(
                print, file=sys.stderr if str(json) == "-" else sys.stdout, flush=True
            ),
            finished=finished,
        )


def _report(played: PlayReport, json: Path | None, out: Path | None) -> None:
    if print_json(played.to_dict(), json):
        return
    show(str(played))
    if out is not None:
        show(
            f"Open the last minutes with: rerun {shlex.quote(str(out))}/live-*.rrd, or {program()} "
            "view FILE"
        )


def _wait() -> None:
    """Wait for Ctrl-C."""
    with contextlib.suppress(KeyboardInterrupt):
        threading.Event().wait()
