"""Ledgers of clicked points: the run is repeated in a thread, one replay at a time, and each ledger is kept."""

from __future__ import annotations

import threading
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np

from dynaviz.arrays import F32, F64
from dynaviz.errors import UsageError
from dynaviz.explorer.run import ExploredRun
from dynaviz.runs.explanation import Why, why
from dynaviz.views.read.focus import CROSSED, HIT

MOST = 64  # ledgers that are kept
BEYOND = 40.0  # metres behind a point at which drawn rays end at the latest

Key = tuple[str, int, int]


class Job:
    """A ledger that is being computed.

    Args:
        closed: set when the explorer closes, which ends the replay.

    Attributes:
        phase, done, total: progress.
    """

    def __init__(self, closed: threading.Event) -> None:
        self._closed = closed
        self.phase, self.done, self.total = "waiting", 0, 0
        self.future: Future[Why] | None = None

    def progress(self, phase: str, done: int, total: int) -> None:
        """Keep the progress of the replay.

        Raises:
            UsageError: if the explorer was closed meanwhile.
        """
        if self._closed.is_set():
            raise UsageError("the explorer was closed")
        self.phase, self.done, self.total = phase, done, total


class Ledgers:
    """Computes and keeps ledgers.

    Args:
        runs: by letter.
    """

    def __init__(self, runs: dict[str, ExploredRun]) -> None:
        self._runs, self._jobs, self._lock = runs, dict[Key, Job](), threading.Lock()
        self._closed = threading.Event()
        self._worker = ThreadPoolExecutor(1, "ledger")

    def ask(self, letter: str, frame: int, point: int) -> dict[str, Any]:
        """The ledger of a point, or how far it is; the first question starts the replay.

        Returns:
            ``why`` (as ``Why.to_dict``), or ``error``, or the progress as ``phase``, ``done`` and ``total``.
        """
        job = self._job((letter, frame, point))
        future = job.future
        assert future is not None
        if not future.done():
            return {"phase": job.phase, "done": job.done, "total": job.total}
        if (error := future.exception()) is not None:
            return {"error": str(error)}
        return {"why": future.result().to_dict()}

    def rays(self, letter: str, frame: int, point: int) -> tuple[F32, list[int]]:
        """The rays of a ledger that is known, from the sensor to the point or beyond, and their classes."""
        job = self._jobs.get((letter, frame, point))
        future = job.future if job else None
        if future is None or not future.done() or future.cancelled() or future.exception() is not None:
            return np.zeros((0, 2, 3), np.float32), []
        ledger = future.result().ledger
        strips: list[list[F64]] = []
        kinds: list[int] = []
        for entry in ledger.entries:
            start, end = np.array(entry.sensor), np.array(ledger.position)
            if entry.hits:
                strips.append([start, end])
                kinds.append(HIT)
            if entry.crossed:
                behind = min(entry.behind_m or 0.0, BEYOND)
                strips.append([start, end + (end - start) * (behind / max(entry.range_m, 1e-6))])
                kinds.append(CROSSED)
        return np.array(strips, np.float32).reshape(-1, 2, 3), kinds

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
                        other.future.cancel()  # if it still waits: the user has clicked elsewhere since
                job = self._jobs[key] = Job(self._closed)
                run = self._runs[key[0]].run
                job.future = self._worker.submit(why, run, key[1], key[2], progress=job.progress)
                while len(self._jobs) > MOST:
                    self._jobs.pop(next(iter(self._jobs)))
            return job
