"""The process that runs tasks.

``python -m dynaviz.tasks.worker``, started by ``dynaviz.tasks.local``.

It reads pickled (task, folder, threads) from standard input, each after its length in 8 bytes. It
runs one task after another and writes lines ``PHASE DONE TOTAL`` to standard output, and ``END``
after each task, whose errors are then in ``error.json`` in its folder. It exits when standard input
ends, at once even in the middle of a task: the parent has died, and another program may use the
folder.
"""

from __future__ import annotations

import os
import pickle
import queue
import signal
import sys
import threading
import time
import traceback
from pathlib import Path
from typing import IO, Any

from dynaviz.tasks.memory import forget_peak

INTERVAL = 0.2  # seconds between two lines of a phase
END = b"END\n"


def main() -> int:
    """Run the tasks."""
    progress_lines = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # a method's own output goes to the log
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    received: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    busy = threading.Event()
    threading.Thread(target=_receive, args=(received, busy), daemon=True).start()
    while content := received.get():
        task, folder, threads = pickle.loads(content)
        _run(task, folder, threads, _ProgressReporter(progress_lines))
        forget_peak()
        busy.clear()
        progress_lines.write(END)
        progress_lines.flush()
    return 0


def _run(task: Any, folder: Path, threads: int | None, progress: _ProgressReporter) -> None:
    from dynaviz.tasks.task import fail, sentence

    _log_to(folder / "error.log")
    try:
        task.run(folder, threads, progress)
    except Exception as error:
        traceback.print_exc()
        fail(task, folder, sentence(error))
    _log_to(os.devnull)  # so that the parent can remove the log


def _log_to(path: str | os.PathLike[str]) -> None:
    """Append standard output and error to a file."""
    sys.stdout.flush()
    sys.stderr.flush()
    log = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(log, 1)
    os.dup2(log, 2)
    os.close(log)


def _receive(received: queue.SimpleQueue[bytes], busy: threading.Event) -> None:
    """Put the bytes of each task into a queue, and none at the end of standard input."""
    with os.fdopen(
        os.dup(0), "rb"
    ) as stdin:  # not sys.stdin: a thread must not hold its lock when Python exits
        while length := stdin.read(8):
            busy.set()
            received.put(stdin.read(int.from_bytes(length, "little")))
    if busy.is_set():
        os._exit(1)
    received.put(b"")


class _ProgressReporter:
    def __init__(self, out: IO[bytes]):
        self._out = out
        self._phase = ""
        self._last = 0.0

    def __call__(self, phase: str, done: int, total: int) -> None:
        now = time.monotonic()
        if phase != self._phase or done == total or now - self._last > INTERVAL:
            self._phase = phase
            self._last = now
            self._out.write(f"{phase} {done} {total}\n".encode())
            self._out.flush()


if __name__ == "__main__":
    sys.exit(main())
