"""Ledgers of clicked points.

The run is repeated in a thread, one replay at a time, and each ledger is kept.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from dynaviz.errors import UsageError
from dynaviz.explain.document import Why
from dynaviz.explorer.run import ExploredRun
from dynaviz.runs.explanation import why

MOST = 64  # ledgers that are kept

Key = tuple[str, int, int]


class Job:
    """A ledger that is being computed.

    Args:
        closed: set when the explorer closes, which ends the replay.
        passes: names of the phases in which the replay passes over all scans.

    Attributes:
        share: of the work that is done, 0 to 1.
    """

    def __init__(self, closed: threading.Event, passes: Sequence[str]) -> None:
        self._closed = closed
        self._passes = passes
        self._begin: float | None = None
        self.share = 0.0
        self.future: Future[Why] | None = None

    @property
    def left(self) -> float | None:
        """Seconds until it is done, if the rest is as fast; None while nothing is done."""
        if self._begin is None or not self.share:
            return None
        return (time.monotonic() - self._begin) * (1 - self.share) / self.share

    def progress(self, phase: str, done: int, total: int) -> None:
        """Keep the progress of the replay.

        Raises:
            UsageError: if the explorer was closed meanwhile.
        """
        if self._closed.is_set():
            raise UsageError("the explorer was closed")
        self._begin = self._begin or time.monotonic()
        if phase in self._passes:
            self.share = (self._passes.index(phase) + done / max(total, 1)) / len(self._passes)


class Ledgers:
    """Computes and keeps ledgers.

    Args:
        runs: by letter.
    """

    def __init__(self, runs: dict[str, ExploredRun]) -> None:
        self._runs = runs
        self._jobs = dict[Key, Job]()
        self._lock = threading.Lock()
        self._closed = threading.Event()
        self._worker = ThreadPoolExecutor(1, "ledger")

    def ask(self, letter: str, frame: int, point: int) -> Why | dict[str, Any]:
        """The ledger of a point, or how far it is; the first question starts the replay.

        Returns:
            The ledger, or ``error``, or the ``share`` of the replay that is done and the
            ``seconds`` that are left.
        """
        job = self._job((letter, frame, point))
        future = job.future
        assert future is not None
        if not future.done():
            return {"share": job.share, "seconds": job.left}
        if (error := future.exception()) is not None:
            return {"error": str(error)}
        return future.result()

    def known(self, letter: str, frame: int, point: int) -> Why | None:
        """The ledger of a point that was computed; None if none was."""
        job = self._jobs.get((letter, frame, point))
        future = job.future if job else None
        if (
            future is None
            or not future.done()
            or future.cancelled()
            or future.exception() is not None
        ):
            return None
        return future.result()

    def close(self) -> None:
        """End the replay that is running, and start no other."""
        self._closed.set()
        self._worker.shutdown(wait=False, cancel_futures=True)

    def _job(self, key: Key) -> Job:
        with self._lock:
            job = self._jobs.get(key)
            if job is None or (job.future is not None and job.future.cancelled()):
                for (_, *asked), other in self._jobs.items():
                    if asked != [*key[1:]] and other.future is not None:
                        # if it still waits: the user has clicked elsewhere since
                        other.future.cancel()
                run = self._runs[key[0]]
                job = self._jobs[key] = Job(self._closed, run.passes)
                job.future = self._worker.submit(
                    why, run.run, key[1], key[2], progress=job.progress
                )
                while len(self._jobs) > MOST:
                    self._jobs.pop(next(iter(self._jobs)))
            return job
