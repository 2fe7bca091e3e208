"""Fixtures for benches."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers.toy_method import TOY, InProcessExecutor, write_room

from dynaviz.benchmarking import bench as bench_module
from dynaviz.contracts import registry


@pytest.fixture(scope="session")
def rooms(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two sequences. Tests must not change them."""
    folder = tmp_path_factory.mktemp("rooms")
    return [
        write_room(folder / name, frames=2, rays=800, seed=seed)
        for seed, name in enumerate(["one", "two"])
    ]


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Install the method ``toy`` for this process and all processes that it starts."""
    site = tmp_path_factory.mktemp("site")
    (site / "toy_methods.py").write_text(TOY)
    facts = site / "toy_methods-1.0.dist-info"
    facts.mkdir()
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: toy-methods\nVersion: 1.0\n")
    (facts / "entry_points.txt").write_text("[dynaviz.methods]\ntoy = toy_methods:Toy\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(site)
        patch.setenv("PYTHONPATH", str(site))
        yield


@pytest.fixture
def in_process(toy: None, monkeypatch: pytest.MonkeyPatch) -> type[InProcessExecutor]:
    """Run cells in this process, with the counts as the only metric: fast."""
    all_handles = registry.handles

    def handles(kind: str) -> list[registry.PluginHandle]:
        return [
            handle
            for handle in all_handles(kind)
            if kind != "metrics" or handle.name == "confusion"
        ]

    monkeypatch.setattr(registry, "handles", handles)
    monkeypatch.setattr(bench_module, "LocalExecutor", InProcessExecutor)
    return InProcessExecutor
