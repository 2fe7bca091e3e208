"""Runs cells on this machine, each in its own process, so that a crash affects no other cell."""

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

CellProgress = Callable[[BenchCell, str, int, int], None]
"""Called with a cell, a phase of its run, the number of frames done and their total."""
END_TIMEOUT = 5.0  # seconds for a process to remove partial files before it is killed


# A separate session (on Windows a process group): Ctrl-C reaches only the bench, which then ends its processes.
if sys.platform == "win32":
    DETACHED = subprocess.CREATE_NEW_PROCESS_GROUP
else:
    DETACHED = 0


class LocalExecutor:
    """Runs several cells at a time and divides the cores among them.

    Args:
        out: folder of the bench.
        workers: number of cells that run at a time.
        report: called with the progress of the cells, from other threads.
    """

    def __init__(self, out: Path, workers: int, report: CellProgress):
        self._out, self._workers, self._report = out, workers, report
        self._threads = None if workers == 1 else max(1, (os.cpu_count() or 1) // workers)

    def run(self, todo: Sequence[BenchCell]) -> Iterator[BenchCell]:
        """Run cells and yield each when it has ended, also if it failed; closing the iterator ends all processes."""
        processes = WorkerProcesses()
        pool = ThreadPoolExecutor(self._workers)
        try:
            ended = {
                pool.submit(processes.run, cell, self._out / cell.path, self._threads, self._report): cell
                for cell in todo
            }
            for future in as_completed(ended):
                future.result()
                yield ended[future]
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            processes.end()
            pool.shutdown()


class WorkerProcesses:
    """The processes that run cells, one process per cell."""

    def __init__(self) -> None:
        self._alive: set[subprocess.Popen[bytes]] = set()
        self._lock, self._ending = threading.Lock(), False

    def run(self, cell: BenchCell, folder: Path, threads: int | None, report: CellProgress) -> None:
        """Run a cell in a process and wait for it; its folder then contains the files of a run, or ``error.json``."""
        folder.mkdir(parents=True, exist_ok=True)
        cells.clear(folder)
        with (folder / "error.log").open("wb") as log, self._child(log.fileno()) as child:
            assert child.stdin
            assert child.stdout
            with contextlib.suppress(BrokenPipeError):  # the process died; its exit code is checked below
                child.stdin.write(pickle.dumps((cell, folder, threads)))
                child.stdin.flush()
            for line in child.stdout:
                phase, done, total = line.decode().rsplit(maxsplit=2)
                report(cell, phase, int(done), int(total))
            code = child.wait()
        if code == 0:
            (folder / "error.log").unlink(missing_ok=True)
        elif not self._ending and cells.error_of(folder) is None:
            cells.fail(cell, folder, death(code))

    def end(self) -> None:
        """End all processes, and start no more."""
        with self._lock:
            self._ending = True
            alive = tuple(self._alive)
        for child in alive:
            child.terminate()
        for child in alive:
            try:
                child.wait(END_TIMEOUT)
            except subprocess.TimeoutExpired:
                child.kill()

    @contextlib.contextmanager
    def _child(self, log: int) -> Iterator[subprocess.Popen[bytes]]:
        with self._lock:
            if self._ending:
                raise KeyboardInterrupt
            child = subprocess.Popen(
                [sys.executable, "-P", "-m", "dynaviz.benchmarking.worker"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                start_new_session=sys.platform != "win32",
                creationflags=DETACHED,
            )
            self._alive.add(child)
        try:
            yield child
        finally:
            with contextlib.suppress(BrokenPipeError):
                child.communicate()
            self._alive.discard(child)


def death(code: int) -> str:
    """The error message for a process that ended without ``error.json``."""
    if code >= 0:
        return f"the process ended with exit code {code}. Look into error.log for the reason."
    name = signal.Signals(-code).name if -code in set(signal.Signals) else str(-code)
    hint = "Memory may have run out: use fewer workers." if name == "SIGKILL" else "Look into error.log for the reason."
    return f"the process was killed by {name}. {hint}"
