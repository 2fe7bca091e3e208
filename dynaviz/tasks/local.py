"""Runs tasks on this machine in other processes, so that a crash affects no other task."""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from functools import partial
from pathlib import Path
from typing import Generic

from dynaviz.tasks.task import AnyTask, TaskProgress, clear, error_of, fail, sentence
from dynaviz.tasks.worker import END

END_TIMEOUT = 5.0  # seconds for a process to remove partial files before it is killed


# A separate session (on Windows a process group): Ctrl-C reaches only this process, which then ends
# the others.
if sys.platform == "win32":
    DETACHED = subprocess.CREATE_NEW_PROCESS_GROUP
else:
    DETACHED = 0


class InThisProcess(Generic[AnyTask]):
    """Runs tasks one by one in this process: nothing to start, and nothing to send.

    Args:
        out: folder of the whole work.
        report: called with the progress of the tasks.
    """

    def __init__(self, out: Path, report: TaskProgress[AnyTask]):
        self._out = out
        self._report = report

    def run(self, todo: Sequence[AnyTask]) -> Iterator[AnyTask]:
        """Run tasks and yield each when it has ended, also if it failed."""
        for task in todo:
            folder = self._out / task.path
            folder.mkdir(parents=True, exist_ok=True)
            clear(task, folder)
            try:
                task.run(folder, None, partial(self._report, task))
            except Exception as error:
                fail(task, folder, sentence(error))
            yield task


class LocalExecutor(Generic[AnyTask]):
    """Runs several tasks at a time and divides the cores among them.

    Args:
        out: folder of the whole work.
        workers: number of tasks that run at a time.
        report: called with the progress of the tasks, from other threads.
        reuse: run several tasks in a process, one after another, which saves its start; else each
            has its own, whose memory and time are those of the task.
    """

    def __init__(self, out: Path, workers: int, report: TaskProgress[AnyTask], reuse: bool = False):
        self._out = out
        self._workers = workers
        self._report = report
        self._reuse = reuse
        self._threads = None if workers == 1 else max(1, (os.cpu_count() or 1) // workers)

    def run(self, todo: Sequence[AnyTask]) -> Iterator[AnyTask]:
        """Run tasks and yield each when it has ended, also if it failed.

        Closing the iterator ends all processes.
        """
        processes = WorkerProcesses(self._reuse)
        pool = ThreadPoolExecutor(self._workers)
        try:
            ended = {
                pool.submit(
                    processes.run, task, self._out / task.path, self._threads, self._report
                ): task
                for task in todo
            }
            for future in as_completed(ended):
                future.result()
                yield ended[future]
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            processes.end()
            pool.shutdown()


class WorkerProcesses:
    """The processes that run tasks.

    Args:
        reuse: keep a process whose task has ended for the next one.
    """

    def __init__(self, reuse: bool = False) -> None:
        self._alive: set[subprocess.Popen[bytes]] = set()
        self._idle: list[subprocess.Popen[bytes]] = []
        self._lock = threading.Lock()
        self._ending = False
        self._reuse = reuse

    def run(
        self, task: AnyTask, folder: Path, threads: int | None, report: TaskProgress[AnyTask]
    ) -> None:
        """Run a task in a process and wait for it.

        Its folder then contains its files, or ``error.json``.
        """
        folder.mkdir(parents=True, exist_ok=True)
        clear(task, folder)
        child = self._take(folder / "error.log")
        ended = False
        try:
            assert child.stdin
            assert child.stdout
            content = pickle.dumps((task, folder, threads))
            with contextlib.suppress(
                BrokenPipeError
            ):  # the process died; its exit code is checked below
                child.stdin.write(len(content).to_bytes(8, "little") + content)
                child.stdin.flush()
            for line in child.stdout:
                if ended := line == END:
                    break
                phase, done, total = line.decode().rsplit(maxsplit=2)
                report(task, phase, int(done), int(total))
        finally:
            self._give_back(child, ended)
        if ended and error_of(folder) is None:
            (folder / "error.log").unlink(missing_ok=True)
        elif not ended and not self._ending and error_of(folder) is None:
            fail(task, folder, death(child.returncode))

    def end(self) -> None:
        """End all processes, and start no more."""
        with self._lock:
            self._ending = True
            alive = self._alive - set(self._idle)
            idle = self._idle
        for child in idle:
            child.communicate()
        for child in alive:
            child.terminate()
        for child in alive:
            try:
                child.wait(END_TIMEOUT)
            except subprocess.TimeoutExpired:
                child.kill()

    def _take(self, log: Path) -> subprocess.Popen[bytes]:
        """A process that waits for a task; a new one writes to the log until then."""
        with self._lock, log.open("wb") as file:
            if self._ending:
                raise KeyboardInterrupt
            if self._idle:
                return self._idle.pop()
            child = subprocess.Popen(
                [sys.executable, "-P", "-m", "dynaviz.tasks.worker"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=file,
                start_new_session=sys.platform != "win32",
                creationflags=DETACHED,
            )
            self._alive.add(child)
            return child

    def _give_back(self, child: subprocess.Popen[bytes], ended: bool) -> None:
        """Keep a process whose task has ended for the next task, or end it."""
        with self._lock:
            if keep := self._reuse and ended and not self._ending:
                self._idle.append(child)
        if not keep:
            with contextlib.suppress(BrokenPipeError):
                child.communicate()
            self._alive.discard(child)


def death(code: int) -> str:
    """The error message for a process that ended without ``error.json``."""
    if code >= 0:
        return f"the process ended with exit code {code}. Look into error.log for the reason."
    name = signal.Signals(-code).name if -code in set(signal.Signals) else str(-code)
    hint = (
        "Memory may have run out: use fewer workers."
        if name == "SIGKILL"
        else "Look into error.log for the reason."
    )
    return f"the process was killed by {name}. {hint}"
