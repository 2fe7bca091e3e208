"""Runs tasks on a Dask cluster.

Workers send the files of a task back, so they only need to read the sequences.
"""

from __future__ import annotations

import itertools
import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Generic

from dynaviz.errors import MissingDependency, UsageError
from dynaviz.io.atomic import write_atomic
from dynaviz.tasks.local import WorkerProcesses
from dynaviz.tasks.task import ERRORS, AnyTask, Task, TaskProgress, clear, error_of, fail, sentence

TOPIC = "dynaviz-tasks"
# bytes of one task's files, which pass through the memory of worker, scheduler and client
LARGEST = 2_000_000_000
SPARE = 4  # tasks that wait at the scheduler, in addition to one per thread
CONNECT_TIMEOUT = 15  # seconds to wait for the scheduler


class DaskExecutor(Generic[AnyTask]):
    """Runs tasks on the workers of a Dask scheduler, one per thread of each worker.

    Args:
        out: local folder of the whole work.
        address: address of the scheduler, such as ``tcp://host:8786``.
        report: called with the progress of the tasks, from other threads.

    Raises:
        MissingDependency: if Dask is not installed.
        UsageError: if no scheduler answers at the address.
    """

    def __init__(self, out: Path, address: str, report: TaskProgress[AnyTask]):
        try:
            from distributed import Client
        except ImportError:
            raise MissingDependency(
                "--scheduler needs Dask. Install it with: pip install distributed"
            ) from None
        try:
            self._client = Client(address, timeout=CONNECT_TIMEOUT, set_as_default=False)
        except (OSError, ValueError) as error:
            raise UsageError(
                f"--scheduler {address}: no Dask scheduler answers at this address ({error}). "
                "Start one with 'dask scheduler', and workers with 'dask worker ADDRESS --nthreads "
                "1'"
            ) from None
        self._out = out
        self._report = report

    def run(self, todo: Sequence[AnyTask]) -> Iterator[AnyTask]:
        """Run tasks and yield each when it has ended, also if it failed.

        Closing the iterator cancels the others.

        If a worker dies, another one runs its tasks again. Dask gives up on a task whose workers
        die repeatedly.
        """
        from distributed import as_completed

        by_key: dict[str, AnyTask] = {}
        running: dict[str, Any] = {}
        self._client.subscribe_topic(TOPIC, lambda event: self._on_event(by_key, event[1]))
        ended = as_completed(loop=self._client.loop)
        waiting = iter(todo)

        def submit() -> None:
            # A few at a time: tasks contain the list of all scans, and the scheduler would keep
            # thousands of them.
            room = 2 * sum(self._client.nthreads().values()) + SPARE - len(running)
            for task in itertools.islice(waiting, max(room, 0)):
                key = f"{task.path.as_posix()}-{time.time_ns()}"
                by_key[key] = task
                running[key] = self._client.submit(remote, task, key, key=key, pure=False)
                ended.add(running[key])

        try:
            submit()
            for future in ended:
                task = by_key[future.key]
                self._fetch(task, running.pop(future.key))
                future.release()
                submit()
                yield task
        finally:
            self._client.unsubscribe_topic(TOPIC)
            self._client.cancel(list(running.values()))

    def close(self) -> None:
        """Disconnect from the cluster, which keeps running."""
        self._client.close()

    def _fetch(self, task: AnyTask, future: Any) -> None:
        """Write the files from a worker, the last one last, because its presence marks the others
        as complete.
        """
        folder = self._out / task.path
        clear(task, folder)
        try:
            files: dict[str, bytes] = future.result()
        except Exception as error:  # the worker died too often, or its answer cannot be unpickled
            return fail(
                task, folder, f"the cluster could not run this {task.kind}: {sentence(error)}"
            )
        last = task.files[-1]
        for name in sorted(files, key=lambda name: name == last):
            write_atomic(folder / name, files[name])
        if last in files and not task.finished(folder):
            problem = (
                "the package versions on the worker differ from those on this machine. Install the "
                "same versions."
            )
            fail(task, folder, problem)

    def _on_event(self, by_key: dict[str, AnyTask], event: Any) -> None:
        key, phase, done, total = event
        if key in by_key:
            self._report(by_key[key], phase, done, total)


def remote(task: Task, key: str) -> dict[str, bytes]:
    """Run a task on the worker that calls this, in a separate process; return its files by name."""
    from distributed import get_worker

    worker = get_worker()

    def report(task: Task, phase: str, done: int, total: int) -> None:
        worker.log_event(TOPIC, (key, phase, done, total))

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / task.path
        # One kernel thread, because the worker runs one task per thread. A process, because kernels
        # need a main thread.
        WorkerProcesses().run(task, folder, 1, report)
        if error := error_of(folder):
            fail(task, folder, f"on worker {worker.address}: {error}")
        size = sum(path.stat().st_size for path in folder.iterdir())
        if size > LARGEST:
            shutil.rmtree(folder)
            problem = (
                f"the files of this {task.kind} have {size / 1e9:.1f} GB, too much to send back "
                "from a worker. "
                f"{task.smaller}"
            )
            fail(task, folder, problem)
        return {
            path.name: path.read_bytes()
            for path in folder.iterdir()
            if path.name in (*task.files, *ERRORS)
        }
