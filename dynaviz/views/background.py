"""Work beside the run: one call at a time on a thread of its own."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any


class Background:
    """Runs calls in order, the next one after the previous one, so that at most one is pending.

    Args:
        inline: run calls at once instead, on the caller's thread.
    """

    def __init__(self, inline: bool = False) -> None:
        self._pool = None if inline else ThreadPoolExecutor(1, "recording")
        self._pending: Future[None] | None = None

    def run(self, call: Callable[..., None], *arguments: Any) -> None:
        """Wait for the previous call, then start this one; raises the error of the previous one."""
        self.wait()
        if self._pool is None:
            call(*arguments)
        else:
            self._pending = self._pool.submit(call, *arguments)

    def wait(self) -> None:
        """Wait for the pending call, and raise its error."""
        pending = self._pending
        self._pending = None
        if pending is not None:
            pending.result()

    def close(self) -> None:
        """Wait for the pending call, drop its error, and end the thread."""
        if self._pool is not None:
            self._pool.shutdown()
        self._pending = None
