"""A method from another package, installed for real."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).resolve().parents[1] / "examples/dufomap_wheel"
Python = Callable[..., str]


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Python:
    """Run code with the example installed beside everything else."""
    pytest.importorskip("hatchling")
    site = tmp_path_factory.mktemp("site")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps"]
    subprocess.run([*pip, "--no-build-isolation", "--target", site, EXAMPLE], check=True, capture_output=True)

    def run(code: str, *arguments: str) -> str:
        environment = {**os.environ, "PYTHONPATH": str(site), "COLUMNS": "160"}
        done = subprocess.run(
            [sys.executable, "-c", code, *arguments], capture_output=True, text=True, env=environment, check=False
        )
        assert not done.returncode, done.stderr
        return done.stdout

    return run


def test_it_is_listed_and_configured_as_any_other(python: Python) -> None:
    main = "from dynaviz.cli import main; main()"
    assert "dynaviz-dufomap-wheel 0.1.0" in python(main, "list", "methods")
    row = next(
        line for line in python(main, "config", "dufomap_wheel", "--set", "d_s=0.3").splitlines() if "d_s" in line
    )
    assert "0.3" in row
    assert "--set" in row


def test_it_conforms(python: Python) -> None:
    pytest.importorskip("dufomap", reason="needs the public program: pip install dufomap")
    python("from dynaviz import registry, testing; testing.check_method(registry.load('methods', 'dufomap_wheel'))")
