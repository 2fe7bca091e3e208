"""Kernels of any package: loaded on first use, kept on disk until one of their sources changes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.marks import compiled_only

from dynaviz import kernels, source_files

SUMS = """
from numba import njit

from city.kernels.weights import FACTOR, weight

@njit(cache=True)
def total(values):
    found = 0.0
    for value in values:
        found += FACTOR * weight(value)
    return found
"""
WEIGHTS = """
from numba import njit

from city.facts import OFFSET

FACTOR = {factor}

@njit(cache=True, inline={inline!r})
def weight(value):
    return {weight} + OFFSET
"""
CALL = """
import json, sys
import numpy as np
from dynaviz import kernels

own = kernels.load("city.kernels")
loaded = "numba" in sys.modules
total = own.sums.total(np.arange(4.0))
compiled = sum(own.sums.total.stats.cache_misses.values())
print(json.dumps([loaded, total, compiled]))
"""


@pytest.fixture
def city(tmp_path: Path) -> Path:
    """A package with two files of kernels and one of constants."""
    folder = tmp_path / "city"
    (folder / "kernels").mkdir(parents=True)
    for empty in ("__init__.py", "kernels/__init__.py"):
        (folder / empty).touch()
    (folder / "facts.py").write_text("OFFSET = 0.0")
    (folder / "kernels/sums.py").write_text(SUMS)
    (folder / "kernels/weights.py").write_text(weights())
    return folder


def weights(factor: float = 1.0, weight: str = "value", inline: str = "never") -> str:
    return WEIGHTS.format(factor=factor, weight=weight, inline=inline)


def total(city: Path, compiles: bool) -> float:
    """The sum of 0, 1, 2 and 3 in a new process, which compiles the kernel or has it from disk."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", CALL],
        env={**os.environ, "PYTHONPATH": str(city.parent)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert not done.returncode, done.stderr
    loaded, found, compiled = json.loads(done.stdout)
    assert not loaded
    assert compiled == compiles
    assert (kernels.COMPILING in done.stderr) == compiles
    return float(found)


@compiled_only
@pytest.mark.parametrize("inline", ["never", "always"])
def test_the_cache_notices_a_change_in_any_file_of_a_kernel(
    city: Path, inline: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    other = city / "kernels/weights.py"
    other.write_text(weights(inline=inline))
    assert total(city, compiles=True) == 6.0
    assert total(city, compiles=False) == 6.0
    other.write_text(weights(factor=2.0, inline=inline))  # a constant
    assert total(city, compiles=True) == 12.0
    other.write_text(weights(factor=2.0, weight="value * value", inline=inline))  # a function
    assert total(city, compiles=True) == 28.0
    assert total(city, compiles=False) == 28.0
    (city / "facts.py").write_text("OFFSET = 1.0")  # a constant that the other file imports
    assert total(city, compiles=True) == 36.0
    (city / "unused.py").write_text("OFFSET = 2.0")
    assert total(city, compiles=False) == 36.0
    left = list((city / "kernels/__pycache__").glob("sums.*.nb?"))
    assert len(left) == 2  # the index and one kernel, instead of earlier ones


@compiled_only
def test_a_read_only_package_has_its_cache_elsewhere(
    city: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    assert total(city, compiles=True) == 6.0
    assert total(city, compiles=False) == 6.0
    assert list((tmp_path / "cache").glob("*/sums.*.nbi"))
    assert not list(city.glob("kernels/__pycache__/*.nbi"))


def test_a_package_is_loaded_once() -> None:
    assert kernels.load("dynaviz.kernels") is kernels.load("dynaviz.kernels")
    assert kernels.load("dynaviz.kernels").voxels is kernels.voxels
    with pytest.raises(ModuleNotFoundError, match=r"dynaviz\.kernels\.nothing"):
        kernels.nothing  # noqa: B018


TOWN = {
    "town/__init__.py": "raise SystemExit('executed')",
    "town/hall.py": """
from town.streets import (
    north,  # a comment
    south,
)
def later():
    import town.tower as tower, town.bell
""",
    "town/streets/__init__.py": "from . import south\nfrom ..wall import gate, \\\n    door\n",
    "town/streets/north.py": "import numpy\n'''Do not\nimport town.unused in a text.'''\n",
    "town/streets/south.py": "from dynaviz import kernels\nown = kernels.load('town.kernels')\n",
    "town/wall.py": "",
    "town/tower.py": "import town.missing\n",
    "town/bell.py": "",
    "town/unused.py": "",
    "town/kernels/__init__.py": "",
    "town/kernels/counts.py": "",
}


def test_the_source_files_of_a_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Imports in every form, and kernels that are loaded on first use. No file is executed."""
    for name, text in TOWN.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    found = source_files.closure("town.hall", lambda name: source_files.is_within(name, "town"))
    names = {str(file.relative_to(tmp_path)) for file in found.values()}
    assert names == set(TOWN) - {"town/__init__.py", "town/unused.py"}
