"""The viewer's program, which comes with rerun-sdk: start it on this machine only, and stop it."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import rerun_cli
from rerun.experimental import ViewerClient

from dynaviz.errors import DynavizError, MissingDependency, UsageError

HOME = "127.0.0.1"
SECONDS_TO_START = 30.0


def program() -> str:
    """The viewer itself; the ``rerun`` command is a script around it, and stopping that leaves the viewer running."""
    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    path = Path(rerun_cli.__file__).with_name(name)
    if not path.is_file():
        raise MissingDependency(
            f"the viewer is missing at {path}. Install it again: pip install --force-reinstall rerun-sdk"
        )
    return str(path)


def free_port() -> int:
    """A port that nobody uses at the moment."""
    with socket.socket() as probe:
        probe.bind((HOME, 0))
        port: int = probe.getsockname()[1]
    return port


def url(port: int) -> str:
    """Where a viewer on this machine listens for recordings."""
    return f"rerun+http://{HOME}:{port}/proxy"


def listens(port: int) -> bool:
    """Whether somebody listens on a port of this machine; answers at once."""
    with contextlib.suppress(OSError), socket.create_connection((HOME, port), timeout=0.2):
        return True
    return False


def has_screen() -> bool:
    """Whether a window could be shown."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def open_window(*recordings: Path) -> int:
    """Open a viewer that outlives this process; returns the port where it listens for more.

    Raises:
        UsageError: where there is no screen.
    """
    if not has_screen():
        raise UsageError("there is no screen to open a viewer on. Use dynaviz view --web, or dynaviz shot for pictures")
    port = free_port()
    process = subprocess.Popen(
        [program(), *map(str, recordings), f"--bind={HOME}", f"--port={port}", "--hide-welcome-screen"],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    end = time.monotonic() + SECONDS_TO_START
    while process.poll() is None and not listens(port) and time.monotonic() < end:
        time.sleep(0.05)
    return port


@contextlib.contextmanager
def headless(size: tuple[int, int]) -> Iterator[ViewerClient]:
    """A viewer without a window, for pictures; it ends with the block.

    Raises:
        MissingDependency: where there is nothing to draw with.
        DynavizError: where it does not start for another reason.
    """
    port = free_port()
    command = [
        program(), "--headless", "--hide-welcome-screen", f"--window-size={size[0]}x{size[1]}",
        f"--bind={HOME}", f"--port={port}", "--server-memory-limit=4GB",
    ]  # fmt: skip
    with tempfile.TemporaryFile() as said:
        quiet = {**os.environ, "RUST_LOG": "error"}  # messages would be drawn over the picture
        process = subprocess.Popen(command, stdout=said, stderr=said, stdin=subprocess.DEVNULL, env=quiet)
        try:
            yield _answering(process, port, said)
        finally:
            process.terminate()
            process.wait()


def _answering(process: subprocess.Popen[bytes], port: int, said: IO[bytes]) -> ViewerClient:
    """Wait until the viewer answers, or say why it does not."""
    end = time.monotonic() + SECONDS_TO_START
    while process.poll() is None and time.monotonic() < end:
        if listens(port):
            client = ViewerClient.connect(url(port))
            with contextlib.suppress(Exception):  # it listens before it knows whether it can draw
                client.take_screenshot()
                return client
        time.sleep(0.05)
    said.seek(0)
    words = said.read().decode(errors="replace")
    if "graphics adapter" in words or "render context" in words:
        raise MissingDependency(
            "pictures need a graphics adapter, and this machine has none for Vulkan. "
            "Install a software one: apt-get install mesa-vulkan-drivers"
        )
    raise DynavizError(f"the viewer did not start: {words.strip()[-500:] or 'it said nothing'}")
