"""How long work reports its progress."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""Called with a phase, the number of steps done and their total; a step is usually a frame."""


def silent(phase: str, done: int, total: int) -> None:
    """Report nothing."""
