"""The process that runs one task: ``python -m dynaviz.tasks.worker``, started by ``dynaviz.tasks.local``.

It reads a pickled (task, folder, threads) from standard input, writes lines ``PHASE DONE TOTAL`` to standard output,
and exits with 0, or with 1 and ``error.json`` in the folder. It exits at once if its parent dies, so that it never
writes into a folder that another program uses.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
import time
import traceback
from typing import IO

INTERVAL = 0.2  # seconds between two lines of a phase


def main() -> int:
    """Run the task."""
    progress_lines = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # a method's own output goes to the log
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    task, folder, threads = pickle.load(sys.stdin.buffer)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    from dynaviz.tasks.task import fail, sentence

    try:
        task.run(folder, threads, _ProgressReporter(progress_lines))
    except Exception as error:
        traceback.print_exc()
        fail(task, folder, sentence(error))
        return 1
    return 0


class _ProgressReporter:
    def __init__(self, out: IO[str]):
        self._out, self._phase, self._last = out, "", 0.0

    def __call__(self, phase: str, done: int, total: int) -> None:
        now = time.monotonic()
        if phase != self._phase or done == total or now - self._last > INTERVAL:
            self._phase, self._last = phase, now
            print(phase, done, total, file=self._out, flush=True)


def _end_with_parent() -> None:
    while os.read(0, 4096):  # not sys.stdin: a thread must not hold its lock when Python exits
        pass
    os._exit(1)


if __name__ == "__main__":
    sys.exit(main())
