"""Fixtures for benches."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers.toy_method import TOY, Here, write_room

from dynaviz import registry
from dynaviz.benchmarking import bench as benches


@pytest.fixture(scope="session")
def rooms(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two sequences; only to be read."""
    folder = tmp_path_factory.mktemp("rooms")
    return [write_room(folder / name, frames=2, rays=800, seed=seed) for seed, name in enumerate(["one", "two"])]


@pytest.fixture(scope="session")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The method ``toy``, installed beside everything else, here and in all processes begun from here."""
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
def here(toy: None, monkeypatch: pytest.MonkeyPatch) -> type[Here]:
    """Have cells run in this process and count points only: quick, where nothing else is tested."""
    every = registry.handles

    def handles(kind: str) -> list[registry.PluginHandle]:
        return [handle for handle in every(kind) if kind != "metrics" or handle.name == "confusion"]

    monkeypatch.setattr(registry, "handles", handles)
    monkeypatch.setattr(benches, "Local", Here)
    return Here
