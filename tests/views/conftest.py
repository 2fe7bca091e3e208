"""Fixtures of the tests of recordings."""

from __future__ import annotations

from pathlib import Path

import pytest
import rerun as rr
from helpers.compared_recordings import pair, record_runs

import dynaviz as dv


@pytest.fixture(scope="session")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Folders of a coarse and a fine run in each mode."""
    return record_runs(tmp_path_factory.mktemp("runs"))


@pytest.fixture(scope="session")
def merged(runs: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Merged recordings of two and three runs.

    In strict mode, bad data is an error instead of a warning.
    """
    rr.set_strict_mode(True)
    folder = tmp_path_factory.mktemp("merged")
    inputs = {
        "two": pair(runs, "errors"),
        "scores": pair(runs, "scores"),
        "full": pair(runs, "full", "errors"),
        "many": (*pair(runs, "errors"), pair(runs, "full")[0]),
    }
    for name, recordings in inputs.items():
        dv.compare(*recordings, out=folder / f"{name}.rrd")
    return {name: folder / f"{name}.rrd" for name in inputs}
