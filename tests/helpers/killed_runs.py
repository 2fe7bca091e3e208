"""Runs that are killed: a warmed-up process forks them one after the other and kills each.

Reads lines ``FOLDER STEPS SECONDS``: the run into FOLDER is killed SECONDS after it reported STEPS
steps. Each frame has three: summarised, observed, labelled. Prints one line of JSON per run: the
number of labelled frames it reported, and its exit status.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from pathlib import Path

from dynaviz.contracts.extent import Extent
from dynaviz.engine.loop import execute
from dynaviz.views.layout import Findings, layout
from dynaviz.views.record import recorder  # noqa: F401  imported once, before all forks
from helpers.guessing_method import guess_run, run_into
from helpers.worlds import room

FRAMES = 10


def run_and_report(folder: Path, pipe: int) -> None:
    """A run that reports each step to a pipe, after it was flushed."""

    def report(phase: str, done: int, total: int) -> None:
        os.write(pipe, b"." if phase == "label" else b"-")

    run_into(folder, room(FRAMES, 1000), threads=1, progress=report)


def fork_and_kill(folder: Path, steps: int, seconds: float) -> dict[str, int]:
    """Fork a run, and kill it."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            run_and_report(folder, writer)
            os._exit(0)
        finally:
            os._exit(1)
    os.close(writer)
    steps_seen = b""
    while len(steps_seen) < steps and (more := os.read(reader, 1)):
        steps_seen += more
    time.sleep(seconds)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    while more := os.read(reader, 4096):
        steps_seen += more
    os.close(reader)
    return {"frames": steps_seen.count(b"."), "status": os.waitstatus_to_exitcode(status)}


def main() -> None:
    """Load everything a run needs, without threads, which a fork would lose."""
    run = guess_run(room(2, 300), threads=1)
    execute(run)
    layout(run.labeller.info, Extent.of(run.sequence[0]), True, Findings())
    for line in sys.stdin:
        folder, steps, seconds = line.split()
        print(json.dumps(fork_and_kill(Path(folder), int(steps), float(seconds))), flush=True)


if __name__ == "__main__":
    main()
