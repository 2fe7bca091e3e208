"""Open recordings in the viewer, in a window or in a browser on this machine."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import tempfile
import webbrowser
from collections.abc import Iterable, Iterator
from pathlib import Path

from dynaviz.errors import UsageError
from dynaviz.views import viewer
from dynaviz.views.read.reader import viewable


def view(
    recordings: Iterable[str | os.PathLike[str]], web: bool = False, port: int | None = None
) -> None:
    """Open recordings.

    Args:
        recordings: the files.
        web: serve them to a browser on this machine until interrupted, instead of opening a window.
        port: of the page on this machine; the recordings are served at the port after it. None for
            any free ones.

    Raises:
        DataError: for a file that cannot be opened.
        UsageError: if a window is requested and there is no screen, for a port without ``web``, or
            one that is in use.
        DynavizError: if the viewer ends before it is ready.
    """
    if port is not None and not web:
        raise UsageError(f"--port {port}: is the port of a page. Add --web")
    files = [Path(recording) for recording in recordings]
    for file in files:
        viewable(file)
    if web:
        with serving(port, *files) as (_, lines, server):
            print(*lines, "Press Ctrl-C to end it.", sep="\n", flush=True)
            server.wait()
    else:
        viewer.open_window(*files)


def tunnel(page: int, recordings: int) -> str:
    """The command that forwards both ports to the machine in front of the user."""
    forwards = " ".join(f"-L {port}:{viewer.HOME}:{port}" for port in (page, recordings))
    user = os.environ.get("USER", "USER")
    return f"ssh {forwards} {user}@{socket.gethostname()}"


def ports(page: int | None) -> tuple[int, int]:
    """The port of the page, and that of the recordings: the next one. Any free ports if None.

    Raises:
        UsageError: if another program uses one of them.
    """
    if page is None:
        return viewer.free_port(), viewer.free_port()
    for port in (page, page + 1):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((viewer.HOME, port))
            except (OSError, OverflowError) as error:
                raise UsageError(
                    f"--port {page}: port {port} cannot be used ({error}). Give another one"
                ) from None
    return page, page + 1


@contextlib.contextmanager
def serving(
    port: int | None, *recordings: Path
) -> Iterator[tuple[int, tuple[str, str], subprocess.Popen[bytes]]]:
    """A viewer in a browser on this machine.

    Yields the port for recordings, what to announce, and the process.

    Args:
        port: of the page; that for recordings is the next one. None for any free ones.
        recordings: what it shows; without any, it drops what is older than 1 GB.

    Raises:
        UsageError: if another program uses one of the ports.
        DynavizError: if the viewer ends before it is ready.
    """
    page, inlet = ports(port)
    address = viewer.page_url(page, inlet)
    command = [
        viewer.program(), *map(str, recordings), "--serve-web", f"--bind={viewer.HOME}",
        f"--port={inlet}",
        f"--web-viewer-port={page}", *([] if recordings else ["--server-memory-limit=1GB"]),
    ]  # fmt: skip
    with contextlib.ExitStack() as stack:
        output = stack.enter_context(tempfile.TemporaryFile())
        server = stack.enter_context(
            # Without recordings in a session of its own: Ctrl-C ends the live recording first, and
            # then the viewer.
            subprocess.Popen(
                command, stdout=output, stderr=output, start_new_session=not recordings
            )
        )
        try:
            for each in (inlet, page):
                viewer.wait_until_ready(server, each, output)
            if viewer.has_screen():
                webbrowser.open(address)
            yield inlet, (
                f"Watch it in a browser on this machine at {address}",
                f"From another machine, run '{tunnel(page, inlet)}' there and open the same "
                "address.",
            ), server  # fmt: skip
        finally:
            server.terminate()
