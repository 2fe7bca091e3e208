"""Cells on a Dask cluster. Workers send the files of a cell back, so only the sequences must be readable there."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from dynaviz.benchmarking import cells
from dynaviz.benchmarking.local import Tell, WorkerProcesses
from dynaviz.benchmarking.plan import BenchCell
from dynaviz.errors import MissingDependency, UsageError
from dynaviz.io.atomic import write_atomic

TOPIC = "dynaviz-bench"
LARGEST = 2_000_000_000  # bytes of one cell's files; they pass through the memory of worker, scheduler and client
PATIENCE = 15  # seconds until a scheduler must have answered


class DaskExecutor:
    """Runs cells on the workers of a Dask scheduler, on each as many at a time as it has threads.

    Args:
        out: the bench's folder, here.
        address: of the scheduler, as ``tcp://host:8786``.
        tell: hears of their progress, on threads of its own.

    Raises:
        MissingDependency: without Dask.
        UsageError: where no scheduler answers.
    """

    def __init__(self, out: Path, address: str, tell: Tell):
        try:
            from distributed import Client
        except ImportError:
            raise MissingDependency("--scheduler needs Dask. Install it with: pip install 'dynaviz[cluster]'") from None
        try:
            self._client = Client(address, timeout=PATIENCE, set_as_default=False)
        except (OSError, ValueError) as error:
            raise UsageError(
                f"--scheduler {address}: no Dask scheduler answers ({error}). "
                "Start one with 'dask scheduler', and workers with 'dask worker ADDRESS --nthreads 1'"
            ) from None
        self._out, self._tell = out, tell

    def run(self, todo: Sequence[BenchCell]) -> Iterator[BenchCell]:
        """Run cells and give each as soon as it has ended, well or not; leaving early forgets the others.

        Cells of a worker that dies are run again by another; one whose workers die again and again is given up.
        """
        from distributed import as_completed

        by_key = {f"{cell.path.as_posix()}-{time.time_ns()}": cell for cell in todo}
        self._client.subscribe_topic(TOPIC, lambda event: self._heard(by_key, event[1]))
        futures = [self._client.submit(remote, cell, key, key=key, pure=False) for key, cell in by_key.items()]
        try:
            for future in as_completed(futures, loop=self._client.loop):
                cell = by_key[future.key]
                self._fetch(cell, future)
                future.release()
                yield cell
        finally:
            self._client.unsubscribe_topic(TOPIC)
            self._client.cancel(futures)

    def close(self) -> None:
        """Leave the cluster; it goes on without us."""
        self._client.close()

    def _fetch(self, cell: BenchCell, future: Any) -> None:
        """Write what a worker sent; ``result.json`` last, so that its presence says the others are whole."""
        folder = self._out / cell.path
        cells.clear(folder)
        try:
            files: dict[str, bytes] = future.result()
        except Exception as error:  # the worker died too often, or sent what cannot be read
            return cells.fail(cell, folder, f"the cluster gave up on it: {cells.sentence(error)}")
        for name in sorted(files, key=lambda name: name == "result.json"):
            write_atomic(folder / name, files[name])
        if "result.json" in files and cells.finished(cell, folder) is None:
            cells.fail(cell, folder, "the worker has other versions of packages than this machine. Install the same.")

    def _heard(self, by_key: dict[str, BenchCell], event: Any) -> None:
        key, phase, done, total = event
        if key in by_key:
            self._tell(by_key[key], phase, done, total)


def remote(cell: BenchCell, key: str) -> dict[str, bytes]:
    """Run a cell where this is called, in a process of its own; give its files by name."""
    from distributed import get_worker

    worker = get_worker()

    def tell(cell: BenchCell, phase: str, done: int, total: int) -> None:
        worker.log_event(TOPIC, (key, phase, done, total))

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / cell.path
        # One thread: the worker runs as many cells at a time as it has threads. Kernels need a process's main thread.
        WorkerProcesses().attend(cell, folder, 1, tell)
        if error := cells.error_of(folder):
            cells.fail(cell, folder, f"on worker {worker.address}: {error}")
        size = sum(path.stat().st_size for path in folder.iterdir())
        if size > LARGEST:
            shutil.rmtree(folder)
            cells.fail(cell, folder, f"its files have {size / 1e9:.1f} GB, too much to send back from a worker. "
                                     "Record errors or scores only, or run it without --scheduler.")  # fmt: skip
        return {path.name: path.read_bytes() for path in folder.iterdir() if path.name in cells.ALL_FILES}
