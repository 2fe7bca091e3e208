"""dynaviz imports and runs where Unix-only modules are missing, as on Windows."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

UNIX_ONLY = ("fcntl", "termios", "resource", "pwd", "grp", "pty", "tty", "posix")
WITHOUT = f"""
import builtins, sys

real_import = builtins.__import__

def without_unix(name, globals=None, *rest):  # other packages have their own builds for other systems
    if name in {UNIX_ONLY!r} and (globals or {{}}).get("__name__", "").startswith("dynaviz"):
        raise ImportError(f"{{name}} does not exist on this system")
    return real_import(name, globals, *rest)

builtins.__import__ = without_unix
"""


def python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", WITHOUT + code], capture_output=True, text=True, check=False)


def dynaviz(*words: object) -> subprocess.CompletedProcess[str]:
    arguments = ["dynaviz", *map(str, words)]
    return python(f"sys.argv = {arguments!r}\nfrom dynaviz.cli import main\nmain()")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scene") / "square"
    done = dynaviz("simulate", "square_mid360", folder, "--frames", 3)
    assert done.returncode == 0, done.stderr
    return folder


def test_a_run_is_scored_recorded_and_read_again(scene: Path, tmp_path: Path) -> None:
    done = dynaviz("run", "octomap", scene, "-o", tmp_path)
    assert done.returncode == 0, done.stderr
    result = json.loads((tmp_path / "result.json").read_text())
    assert result["runtime"]["peak_rss_mb"] is None
    assert result["metrics"]["SA"] > 50
    for words in (("info",), ("failures",), ("compare", tmp_path / "run.rrd")):
        done = dynaviz(words[0], tmp_path / "run.rrd", *words[1:])
        assert done.returncode == 0, done.stderr


def test_every_module_imports() -> None:
    done = python("""
import importlib, pkgutil
for package in ("dynaviz", "dynaviz_methods", "dynaviz_eval"):
    for module in pkgutil.walk_packages(importlib.import_module(package).__path__, package + "."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
""")
    assert done.returncode == 0, done.stderr
