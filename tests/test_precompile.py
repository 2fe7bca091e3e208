"""Kernels that are compiled in the background."""

from __future__ import annotations

import multiprocessing

import pytest

from dynaviz import kernels, precompile
from dynaviz.errors import UsageError


def test_the_process_in_the_background_ends_with_the_command(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(kernels, "compiled", lambda: False)
    before, during = multiprocessing.active_children(), []

    def failing_command() -> None:
        with precompile.compiling_the_rest("seethrough"):
            during.extend(multiprocessing.active_children())
            raise UsageError("the command fails")

    with pytest.raises(UsageError):
        failing_command()
    assert len(during) == len(before) + 1
    assert multiprocessing.active_children() == before
