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

# Other packages have their own builds for other systems.
def without_unix(name, globals=None, *rest, **named):
    if name in {UNIX_ONLY!r} and (globals or {{}}).get("__name__", "").startswith("dynaviz"):
        raise ImportError(f"{{name}} does not exist on this system")
    return real_import(name, globals, *rest, **named)

builtins.__import__ = without_unix
"""


def python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", WITHOUT + code], capture_output=True, text=True, check=False
    )


def commands(*lines: tuple[object, ...]) -> subprocess.CompletedProcess[str]:
    """Run commands one after another, until one fails."""
    typed = [["dynaviz", *map(str, words)] for words in lines]
    return python(f"""
from dynaviz.cli import main
for sys.argv in {typed!r}:
    try:
        main()
    except SystemExit as end:
        if end.code:
            raise
""")


@pytest.mark.slow
def test_a_run_is_scored_recorded_and_read_again(tmp_path: Path) -> None:
    scene, out = tmp_path / "square", tmp_path / "out"
    recording = out / "run.rrd"
    done = commands(
        ("simulate", "square_mid360", scene, "--frames", 3),
        ("run", "octomap", scene, "-o", out),
        ("info", recording),
        ("info", recording, "--failures"),
        ("compare", recording, recording),
    )
    assert done.returncode == 0, done.stderr
    result = json.loads((out / "result.json").read_text())
    assert result["runtime"]["peak_rss_mb"] is None
    assert result["metrics"]["SA"] > 50


def test_every_module_imports() -> None:
    done = python("""
import importlib, pkgutil
for package in ("dynaviz", "dynaviz_methods", "dynaviz_eval"):
    for module in pkgutil.walk_packages(importlib.import_module(package).__path__, package + "."):
        # the latter imports ROS, which few machines have
        if not module.name.endswith(("__main__", "dynaviz.ros2.node")):
            importlib.import_module(module.name)
""")
    assert done.returncode == 0, done.stderr
