"""Cells in processes of this machine, each in one of its own: one that dies takes nothing with it."""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

from dynaviz.benchmarking import cells
from dynaviz.benchmarking.plan import BenchCell

Tell = Callable[[BenchCell, str, int, int], None]
"""Called with a cell, a phase of its run, and how many frames of how many are done."""
PATIENCE = 5.0  # seconds that a process may take to remove what it has half written


class LocalExecutor:
    """Runs cells, some at a time, with the cores divided among them.

    Args:
        out: the bench's folder.
        workers: how many cells run at a time.
        tell: hears of their progress, on threads of its own.
    """

    def __init__(self, out: Path, workers: int, tell: Tell):
        self._out, self._workers, self._tell = out, workers, tell
        self._threads = None if workers == 1 else max(1, (os.cpu_count() or 1) // workers)

    def run(self, todo: Sequence[BenchCell]) -> Iterator[BenchCell]:
        """Run cells and give each as soon as it has ended, well or not; leaving early ends all processes."""
        children = WorkerProcesses()
        pool = ThreadPoolExecutor(self._workers)
        try:
            ended = {
                pool.submit(children.attend, cell, self._out / cell.path, self._threads, self._tell): cell
                for cell in todo
            }
            for future in as_completed(ended):
                future.result()
                yield ended[future]
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            children.end()
            pool.shutdown()


class WorkerProcesses:
    """The processes that run cells, one each."""

    def __init__(self) -> None:
        self._alive: set[subprocess.Popen[bytes]] = set()
        self._lock, self._ending = threading.Lock(), False

    def attend(self, cell: BenchCell, folder: Path, threads: int | None, tell: Tell) -> None:
        """Run a cell in a process and wait for it; its folder then holds the files of a run, or ``error.json``."""
        folder.mkdir(parents=True, exist_ok=True)
        cells.clear(folder)
        with (folder / "error.log").open("wb") as log, self._child(log.fileno()) as child:
            assert child.stdin
            assert child.stdout
            with contextlib.suppress(BrokenPipeError):  # it died; its exit code tells
                child.stdin.write(pickle.dumps((cell, folder, threads)))
                child.stdin.flush()
            for line in child.stdout:
                phase, done, total = line.decode().split()
                tell(cell, phase, int(done), int(total))
            code = child.wait()
        if code == 0:
            (folder / "error.log").unlink(missing_ok=True)
        elif not self._ending and cells.error_of(folder) is None:
            cells.fail(cell, folder, death(code))

    def end(self) -> None:
        """End all processes, and begin no more."""
        with self._lock:
            self._ending = True
            alive = tuple(self._alive)
        for child in alive:
            child.terminate()
        for child in alive:
            try:
                child.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                child.kill()

    @contextlib.contextmanager
    def _child(self, log: int) -> Iterator[subprocess.Popen[bytes]]:
        with self._lock:
            if self._ending:
                raise KeyboardInterrupt
            # A session of its own: Ctrl-C on the terminal reaches the bench alone, which then ends its processes.
            child = subprocess.Popen(
                [sys.executable, "-P", "-m", "dynaviz.benchmarking.worker"],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, start_new_session=True,
            )  # fmt: skip
            self._alive.add(child)
        try:
            yield child
        finally:
            with contextlib.suppress(BrokenPipeError):
                child.communicate()
            self._alive.discard(child)


def death(code: int) -> str:
    """What an exit code without an ``error.json`` means, in words."""
    if code >= 0:
        return f"its process ended with exit code {code} and no error. error.log may tell why."
    name = signal.Signals(-code).name if -code in set(signal.Signals) else str(-code)
    hint = " Perhaps memory ran out: run fewer workers." if name == "SIGKILL" else " error.log may tell why."
    return f"its process was killed by {name}.{hint}"
