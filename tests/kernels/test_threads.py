"""Runs in several threads of one process give the labels that they give one after the other."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import json
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from helpers.worlds import room

from dynaviz import api, kernels
from dynaviz.contracts import plugin_code, registry

METHODS = ("octomap", "dufomap")  # both have parallel kernels
THREADS = 8

IN_THREADS = """
import json
from kernels.test_threads import labels_in_threads
import numba
print(json.dumps([labels_in_threads(), numba.threading_layer()]))
"""

LAYER = "from kernels.test_threads import layer; print(layer(), end='')"
OPEN3D = """
try:
    import open3d
except ImportError:  # has loaded its TBB before it fails
    pass
"""


def labels(method: str) -> str:
    return api.run(method, room(3, 300), threads=2).labels_sha256


def labels_in_threads() -> list[str]:
    """Digests of the labels of eight runs at once."""
    with ThreadPoolExecutor(THREADS) as pool:
        return list(pool.map(labels, METHODS * (THREADS // len(METHODS))))


def python(code: str, **variables: str) -> str:
    """Standard output of a process in which warnings are errors."""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1]), **variables}
    command = [sys.executable, "-W", "error", "-c", code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def has_openmp() -> bool:
    with contextlib.suppress(ImportError):
        import numba.np.ufunc.omppool  # noqa: F401

        return True
    return False


def layer() -> str | None:
    """The threading layer that the result of a run states."""
    return api.run("octomap", room(3, 300), threads=2).environment.threading_layer


@pytest.fixture(scope="module")
def serial() -> list[str]:
    return [labels(method) for method in METHODS] * (THREADS // len(METHODS))


def test_runs_in_threads(serial: list[str]) -> None:
    assert labels_in_threads() == serial


def test_runs_in_threads_of_an_event_loop(serial: list[str]) -> None:
    async def every() -> list[str]:
        return await asyncio.gather(*(asyncio.to_thread(labels, method) for method in METHODS))

    assert asyncio.run(every()) == serial[: len(METHODS)]


@pytest.mark.slow
def test_runs_in_threads_where_only_workqueue_is_installed(serial: list[str]) -> None:
    """This threading layer of numba ends the process if two threads use it at once."""
    assert json.loads(python(IN_THREADS, NUMBA_THREADING_LAYER="workqueue")) == [
        serial,
        "workqueue",
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    "code", [LAYER, OPEN3D + LAYER, LAYER + OPEN3D], ids=["alone", "open3d first", "open3d last"]
)
def test_the_threading_layer_does_not_depend_on_the_order_of_imports(code: str) -> None:
    assert python(code) == ("omp" if has_openmp() else "workqueue")


@pytest.mark.slow
def test_the_user_may_select_the_threading_layer() -> None:
    assert python(LAYER, NUMBA_THREADING_LAYER_PRIORITY="workqueue omp tbb") == "workqueue"


def test_code_of_methods_is_read_in_threads() -> None:
    """In Python 3.11, threads that parse at once fail if one of them waits while it builds the
    tree.
    """
    names = [handle.name for handle in registry.handles("methods")]

    def wait(*_: object) -> None:
        time.sleep(0)

    before = gc.get_threshold()
    gc.callbacks.append(wait)
    gc.set_threshold(50)
    try:
        with ThreadPoolExecutor(THREADS) as pool:
            found = list(
                pool.map(lambda name: plugin_code.plugin.__wrapped__("methods", name), names)
            )
    finally:
        gc.set_threshold(*before)
        gc.callbacks.remove(wait)
    assert found == [plugin_code.plugin("methods", name) for name in names]


def test_recordings_in_threads(tmp_path: Path) -> None:
    """Files of runs at once, in different folders, are those of a single run."""
    from dynaviz.views.read.reader import RunRecording  # not needed by the child process above

    with ThreadPoolExecutor(3) as pool:
        results = list(
            pool.map(lambda k: api.run("octomap", room(3, 300), out=tmp_path / str(k)), range(3))
        )
    clouds = [(tmp_path / str(k) / "static_map.pcd").read_bytes() for k in range(3)]
    assert len(set(clouds)) == 1
    for k, result in enumerate(results):
        recording = RunRecording(tmp_path / str(k) / "run.rrd")
        assert recording.result is not None
        assert recording.result.labels_sha256 == result.labels_sha256
        assert [answers.frame for answers in recording.answers()] == [0, 1, 2]


@pytest.mark.parametrize("threads", [1, 2])
def test_threads_share_items_and_the_results_keep_their_order(threads: int) -> None:
    def call(item: int) -> tuple[int, int]:
        return item * item, kernels.threads_in_use()

    def fail(item: int) -> None:
        if item == 3:
            raise ValueError("three")

    try:
        used = kernels.set_threads(threads)
        assert kernels.each(call, range(100)) == [(item * item, 1) for item in range(100)]
        assert kernels.each(call, []) == []
        with pytest.raises(ValueError, match="three"):
            kernels.each(fail, range(100))
        assert kernels.threads_in_use() == used
    finally:
        kernels.set_threads(None)
