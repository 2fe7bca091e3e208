"""dynaviz bench as a user types it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from dynaviz import benches

Command = Callable[..., tuple[int, str, str]]


@pytest.fixture
def planned(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """The tables of the benches that are typed; none runs."""
    tables: list[dict[str, Any]] = []

    def bench(table: dict[str, Any], out: Path, **how: object) -> benches.Board:
        tables.append(table)
        return benches.Board([])

    monkeypatch.setattr(benches, "bench", bench)
    return tables


def test_a_seed_of_zero_takes_the_place_of_the_files_too(
    dynaviz: Command, planned: list[dict[str, Any]], tmp_path: Path
) -> None:
    (tmp_path / "bench.toml").write_text('[search]\nkind = "bayes"\nseed = 5\n')
    for typed, seed in (([], 5), (["--seed", 0], 0), (["--seed", 3], 3)):
        assert dynaviz("bench", tmp_path / "bench.toml", "-o", tmp_path, *typed)[0] == 0
        assert planned[-1]["search"]["seed"] == seed


def test_a_seed_below_zero_is_refused(dynaviz: Command, tmp_path: Path) -> None:
    code, _, err = dynaviz("bench", "-s", "simulate:demo", "-o", tmp_path, "--seed", -1)
    assert (code, err.count("\n"), "--seed" in err) == (2, 1, True), err
