"""Runs that are killed: a warm process forks one after the other and kills each at its moment.

Reads lines ``FOLDER STEPS SECONDS``: a run into that folder is killed so many seconds after so many steps, of which
each frame has three: surveyed, observed, labelled. Answers with a line of JSON: how many frames the run had said were
labelled, and how it ended.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from pathlib import Path

from dynaviz.api import _run_into
from dynaviz.engine.loop import execute
from dynaviz.spatial.extent import Extent
from dynaviz.viz import recorder  # noqa: F401  imported once, before all forks
from dynaviz.viz.layout import layout
from helpers.guessing_method import guess_run
from helpers.worlds import room

FRAMES = 10


def live(folder: Path, said: int) -> None:
    """Be a run that says each frame once it was flushed."""

    def tell(phase: str, done: int, total: int) -> None:
        os.write(said, b"." if phase == "label" else b"-")

    _run_into(folder, folder / "run.rrd", "errors", guess_run(room(FRAMES, 1000), threads=1), False, tell)


def raised(folder: Path, steps: int, seconds: float) -> dict[str, int]:
    """Fork a run, and kill it at its moment."""
    heard, said = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            live(folder, said)
            os._exit(0)
        finally:
            os._exit(1)
    os.close(said)
    words = b""
    while len(words) < steps and (more := os.read(heard, 1)):
        words += more
    time.sleep(seconds)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    while more := os.read(heard, 4096):
        words += more
    os.close(heard)
    return {"frames": words.count(b"."), "status": os.waitstatus_to_exitcode(status)}


def main() -> None:
    """Load what a run needs, without any thread that a fork would lose."""
    run = guess_run(room(2, 300), threads=1)
    execute(run)
    layout(run.labeller.info, Extent.of(run.sequence[0]), geometry=True)
    for line in sys.stdin:
        folder, steps, seconds = line.split()
        print(json.dumps(raised(Path(folder), int(steps), float(seconds))), flush=True)


if __name__ == "__main__":
    main()
