"""The viewer program that comes with rerun-sdk.

Start it, only reachable from this machine, and stop it.
"""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import IO, TypeVar
from urllib.parse import quote

import rerun_cli
from rerun.experimental import ViewerClient

from dynaviz.errors import DynavizError, MissingDependency, UsageError

HOME = "127.0.0.1"
SECONDS_TO_START = 30.0
ATTEMPTS = 6
# of the layout that the viewer stores: the entity and its archetype that say which view is shown
VIEWPORT = "/viewport"
ARCHETYPE = "ViewportBlueprint"

T = TypeVar("T")


def program() -> str:
    """Path of the viewer binary.

    Terminating the ``rerun`` script around it would leave the viewer running.
    """
    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    path = Path(rerun_cli.__file__).with_name(name)
    if not path.is_file():
        raise MissingDependency(
            f"the viewer is missing at {path}. Reinstall it with: pip install --force-reinstall "
            "rerun-sdk"
        )
    return str(path)


def free_port() -> int:
    """A port that is free at the moment."""
    with socket.socket() as probe:
        probe.bind((HOME, 0))
        port: int = probe.getsockname()[1]
    return port


def url(port: int) -> str:
    """The address at which a viewer on this machine receives recordings."""
    return f"rerun+http://{HOME}:{port}/proxy"


def page_url(page: int, recordings: int) -> str:
    """The address of the viewer for browsers; dark, because labels are white.

    Args:
        page: port that serves the viewer.
        recordings: port that serves the recordings.
    """
    return f"http://{HOME}:{page}/?theme=dark&url={quote(url(recordings), safe='')}"


def listens(port: int) -> bool:
    """Whether a port of this machine accepts connections; returns within 0.2 s."""
    with contextlib.suppress(OSError), socket.create_connection((HOME, port), timeout=0.2):
        return True
    return False


def has_screen() -> bool:
    """Whether a window can be shown."""
    return sys.platform in ("darwin", "win32") or bool(
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )


def open_window(*recordings: Path) -> int:
    """Open a viewer that outlives this process.

    Returns the port on which it accepts more recordings.

    Raises:
        UsageError: if there is no screen.
        DynavizError: if the viewer ends before it is ready.
    """
    if not has_screen():
        raise UsageError(
            "there is no screen to open a viewer on. Use view --web for a browser, or view -o for "
            "pictures"
        )
    port = free_port()
    with tempfile.TemporaryFile() as output:
        process = subprocess.Popen(
            [
                program(),
                *map(str, recordings),
                f"--bind={HOME}",
                f"--port={port}",
                "--hide-welcome-screen",
            ],
            stdout=output,
            stderr=output,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
        )
        wait_until_ready(process, port, output)
    return port


def wait_until_ready(process: subprocess.Popen[bytes], port: int, output: IO[bytes]) -> None:
    """Wait until a viewer listens, or the time to start is over.

    Raises:
        DynavizError: if it ends before; with what it wrote to ``output``.
    """
    end = time.monotonic() + SECONDS_TO_START
    while not listens(port) and time.monotonic() < end:
        if process.poll() is not None:
            output.seek(0)
            text = output.read().decode(errors="replace").strip()
            raise DynavizError(f"the viewer did not start: {text[-500:] or 'it printed nothing'}")
        time.sleep(0.05)


@contextlib.contextmanager
def headless(size: tuple[int, int]) -> Iterator[ViewerClient]:
    """A viewer without a window, for pictures; it stops at the end of the block.

    Raises:
        MissingDependency: without a graphics adapter.
        DynavizError: if it does not start for another reason.
    """
    port = free_port()
    command = [
        program(), "--headless", "--hide-welcome-screen", f"--window-size={size[0]}x{size[1]}",
        f"--bind={HOME}", f"--port={port}", "--server-memory-limit=4GB",
    ]  # fmt: skip
    with tempfile.TemporaryFile() as output:
        quiet = {**os.environ, "RUST_LOG": "error"}  # or messages would be drawn over the picture
        process = subprocess.Popen(
            command, stdout=output, stderr=output, stdin=subprocess.DEVNULL, env=quiet
        )
        try:
            yield _connected(process, port, output)
        finally:
            process.terminate()
            process.wait()


def patient(request: Callable[[], T]) -> T:
    """The answer of a viewer to a request, repeated while it is too busy.

    Drawing in software may take long.

    Raises:
        DynavizError: if it does not answer in time.
    """
    for _ in range(ATTEMPTS):
        with contextlib.suppress(TimeoutError):  # the client waits 15 s or less
            return request()
    raise DynavizError(
        "the viewer does not answer in time. Try a smaller --size, or one view with --view-name"
    )


def maximize(client: ViewerClient, view: str) -> None:
    """Give a view the whole window.

    rerun-sdk has no function for it, so the layout is changed as the viewer stores it.

    Args:
        client: of the viewer.
        view: number of the view.

    Raises:
        DynavizError: if this version of the viewer stores its layout differently.
    """
    layout = patient(client.get_blueprint).blueprint
    window = layout.get(VIEWPORT, {}).get(ARCHETYPE)
    if window is None:
        raise DynavizError(
            f"rerun-sdk {version('rerun-sdk')} stores its layout differently: its entity "
            f"{VIEWPORT} has no {ARCHETYPE}. Draw the whole window: leave out --view-name"
        )
    window["maximized"] = view
    patient(lambda: client.set_blueprint(layout, of="recording"))


def _connected(process: subprocess.Popen[bytes], port: int, output: IO[bytes]) -> ViewerClient:
    """Wait until the viewer answers; raise an error with its output if it does not."""
    end = time.monotonic() + SECONDS_TO_START
    while process.poll() is None and time.monotonic() < end:
        if listens(port):
            client = ViewerClient.connect(url(port))
            with contextlib.suppress(Exception):  # it accepts connections before it can draw
                client.take_screenshot()
                return client
        time.sleep(0.05)
    output.seek(0)
    text = output.read().decode(errors="replace")
    if "graphics adapter" in text or "render context" in text:
        raise MissingDependency(
            "pictures need a Vulkan graphics adapter, and none was found. "
            "Install a software renderer: apt-get install mesa-vulkan-drivers"
        )
    raise DynavizError(f"the viewer did not start: {text.strip()[-500:] or 'it printed nothing'}")
