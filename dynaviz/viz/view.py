"""Open recordings in the viewer, in a window or in a browser on this machine."""

from __future__ import annotations

import os
import subprocess
import webbrowser
from collections.abc import Iterable
from pathlib import Path
from urllib.parse import quote

from dynaviz.viz import viewer
from dynaviz.viz.reader import viewable


def view(recordings: Iterable[str | os.PathLike[str]], web: bool = False) -> None:
    """Open recordings.

    Args:
        recordings: the files.
        web: serve them to a browser on this machine until interrupted, instead of opening a window.

    Raises:
        DataError: for a file that cannot be opened.
        UsageError: if a window is requested and there is no screen.
    """
    files = [Path(recording) for recording in recordings]
    for file in files:
        viewable(file)
    if web:
        _serve(files)
    else:
        viewer.open_window(*files)


def _serve(files: list[Path]) -> None:
    port, page = viewer.free_port(), viewer.free_port()
    address = f"http://{viewer.HOME}:{page}/?url={quote(viewer.url(port), safe='')}"
    command = [
        viewer.program(), *map(str, files), "--serve-web", f"--bind={viewer.HOME}", f"--port={port}",
        f"--web-viewer-port={page}",
    ]  # fmt: skip
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as server:
        print(f"Serving to browsers on this machine at {address} until interrupted (Ctrl-C).", flush=True)
        if viewer.has_screen():
            webbrowser.open(address)
        try:
            server.wait()
        finally:
            server.terminate()
