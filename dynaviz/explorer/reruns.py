"""Runs with other parameters that the page starts.

One at a time, each with an explorer that compares it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

from dynaviz.errors import DynavizError, UsageError
from dynaviz.explorer.run import ExploredRun
from dynaviz.runs.execution import run_method
from dynaviz.runs.options import RunOptions


class Rerun:
    """A run with other parameters, in a thread; its folder is next to the files of the first run.

    Args:
        run: the first run.
        settings: the parameters that differ.
        opened: called with the new run; returns the address of the page that compares it with the
            first one.

    Raises:
        UsageError: for parameters that the method does not have.
    """

    def __init__(
        self, run: ExploredRun, settings: Mapping[str, Any], opened: Callable[[ExploredRun], str]
    ) -> None:
        if unknown := settings.keys() - run.result.parameters.keys():
            raise UsageError(f"{run.result.method} has no parameter {', '.join(sorted(unknown))}")
        self._run = run
        self._settings = settings
        self._opened = opened
        self._closed = threading.Event()
        self._state: dict[str, Any] = {"phase": "starting", "done": 0, "total": 0}
        threading.Thread(target=self._work, name="rerun", daemon=True).start()

    @property
    def state(self) -> dict[str, Any]:
        """``url`` of the comparison, or ``error``, or the ``phase`` with the frames ``done`` of
        ``total``.
        """
        return self._state

    def close(self) -> None:
        """End the run."""
        self._closed.set()

    def _work(self) -> None:
        first = self._run.result
        settings = {**first.parameters, **self._settings}
        name = ",".join(f"{key}={value}" for key, value in self._settings.items())
        folder = self._run.path.parent / f"with_{name}"
        options = RunOptions(settings=settings, seed=first.seed, online=first.online, variant=name)
        try:
            sequence = self._run.run.sequence()
            run_method(first.method, sequence, options, out=folder, progress=self._progress)
            self._state = {"url": self._opened(ExploredRun(folder))}
        except DynavizError as error:
            self._state = {"error": str(error)}

    def _progress(self, phase: str, done: int, total: int) -> None:
        if self._closed.is_set():
            raise UsageError("the explorer was closed")
        self._state = {"phase": phase, "done": done, "total": total}
