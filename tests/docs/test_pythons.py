"""What the project says about versions of Python agrees."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
TESTED = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["project"]["classifiers"]))


def test_the_oldest_version_is_the_same_everywhere() -> None:
    oldest = TESTED[0]
    assert PROJECT["project"]["requires-python"] == f">={oldest}"
    assert PROJECT["tool"]["ruff"]["target-version"] == f"py{oldest.replace('.', '')}"
    assert f"sys.version_info < ({oldest.replace('.', ', ')})" in (ROOT / "Makefile").read_text()
    for page in ("Makefile", "README.md", "docs/index.md"):
        assert f"Python {oldest} or newer" in (ROOT / page).read_text()


def test_each_tested_version_runs_in_ci() -> None:
    workflow = (ROOT / ".github/workflows/ci.yml").read_text()
    assert set(re.findall(r'"(3\.\d+)"', workflow)) == set(TESTED)
    assert (
        f"tested with Python {', '.join(TESTED[:-1])} and {TESTED[-1]}"
        in (ROOT / "README.md").read_text()
    )
