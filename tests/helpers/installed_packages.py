"""Packages installed for real, beside everything else."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

Python = Callable[..., subprocess.CompletedProcess[str]]


def python_with(package: Path, site: Path) -> Python:
    """Install a package into an empty folder; returns a call of Python that finds it there."""
    pytest.importorskip("hatchling")
    pip = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
        "--no-deps",
    ]
    subprocess.run(
        [*pip, "--no-build-isolation", "--target", site, package], check=True, capture_output=True
    )
    environment = {**os.environ, "PYTHONPATH": str(site), "COLUMNS": "160"}

    def call(*words: str | Path) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, *words], capture_output=True, text=True, env=environment, check=False
        )

    return call
