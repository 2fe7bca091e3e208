"""dynaviz demo as a user types it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path

import pytest

from dynaviz import api, precompile
from dynaviz.scores.result import Result
from dynaviz.scores.sections import SequenceInfo
from dynaviz.synthetic import simulate


def test_a_broken_method_is_left_out(
    broken_plugins: None,
    run_command: Callable[..., tuple[int, str, str]],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    for module, name in ((simulate, "simulate"), (api, "open"), (api, "compare")):
        monkeypatch.setattr(module, name, lambda *given, **how: None)
    monkeypatch.setattr(precompile, "compiling", contextlib.nullcontext)
    monkeypatch.setattr(
        api, "run", lambda name, *given, **how: Result(name, {}, SequenceInfo("street"))
    )
    code, out, err = run_command("demo", "-o", tmp_path, "--no-view")
    assert code == 0, err
    assert "dynaviz: warning: method 'a_broken_one'" in err
    assert "octomap" in out
    assert "a_broken_one" not in out
