"""Fixtures for all tests."""

from __future__ import annotations

import gc
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import hypothesis
import pytest
from helpers.worlds import InMemory, room

from dynaviz.cli import main
from dynaviz.contracts import registry

# The threads of OpenMP must not spin while they wait: each pytest-xdist worker has as many of them
# as there are cores. Read when numba loads its threading layer, and inherited by subprocesses.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

hypothesis.settings.register_profile(
    "patient", deadline=None, max_examples=50
)  # the first call may compile a kernel
hypothesis.settings.load_profile("patient")

if (
    signal.getsignal(signal.SIGINT) is signal.SIG_IGN
):  # background jobs of a shell start like this, and their children inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_finish() -> None:
    """Exempt what the imports made from garbage collection, which would look at all of it again and
    again.
    """
    gc.collect()
    gc.freeze()


SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture
def little_room() -> InMemory:
    return room()


@pytest.fixture
def broken_plugins(monkeypatch: pytest.MonkeyPatch) -> None:
    """Add a plug-in of each kind that cannot be imported."""
    every = registry.handles

    def handles(kind: str) -> list[registry.PluginHandle]:
        return [
            registry.PluginHandle(
                kind, "a_broken_one", "no_such_module:Nothing", "somebody's", "1.0"
            ),
            *every(kind),
        ]

    monkeypatch.setattr(registry, "handles", handles)


@pytest.fixture
def run_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    """Run a command in this process; returns its exit code, standard output and standard error."""

    def run(*words: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["dynaviz", *map(str, words)])
        with pytest.raises(SystemExit) as end:
            main()
        out, err = capsys.readouterr()
        return int(end.value.code or 0), out, err

    return run


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder with real data and golden labels.

    Tests that need it are skipped if it is absent.
    """
    if not SHARED.is_dir():
        pytest.skip(f"needs the real data in {SHARED.name}/ next to the checkout")
    return SHARED


@pytest.fixture(scope="session")
def real_data(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The real data in the native layout of each data set, unpacked once for all runs.

    Tests do not write there.
    """
    base = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        base = base.parent
    unpack, lock = shared / "data/unpack.py", base / "real.lock"
    folder = Path(__file__).parents[1] / f"build/real-{unpack.stat().st_mtime_ns}"
    partial = folder.with_suffix(".partial")
    while not folder.exists():
        try:
            lock.mkdir()
        except FileExistsError:  # another worker is unpacking
            time.sleep(0.2)
            continue
        try:
            if not folder.exists():
                shutil.rmtree(partial, ignore_errors=True)
                subprocess.run([sys.executable, unpack, partial], check=True, capture_output=True)
                partial.rename(folder)
        finally:
            lock.rmdir()
    return folder
