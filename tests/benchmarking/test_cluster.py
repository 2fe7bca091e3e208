"""Benches on a Dask cluster: a real one of several processes, one of which is killed."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers.toy_method import has_ended, waiting_process

from dynaviz.benchmarking.bench import bench
from dynaviz.benchmarking.plan import BenchCell
from dynaviz.benchmarking.runner import BenchCallbacks
from dynaviz.errors import UsageError

distributed = pytest.importorskip("distributed", reason="needs Dask: pip install distributed")


@pytest.fixture(scope="module")
def cluster(toy: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[object]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DASK_TEMPORARY_DIRECTORY", str(tmp_path_factory.mktemp("dask")))
        with distributed.LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            dashboard_address=None,
            silence_logs=50,
            protocol="tcp",
        ) as local:
            yield local


@pytest.mark.slow
def test_a_killed_worker_loses_nothing(cluster, rooms: list[Path], tmp_path: Path) -> None:
    gate, out = tmp_path / "gate", tmp_path / "out"
    reported: set[str] = set()

    class Recorder(BenchCallbacks):
        def running(self, cell: BenchCell, phase: str, done: int, total: int) -> None:
            reported.add(cell.path.name)

    def kill_the_worker() -> None:
        """Once the cell that waits for the gate runs, kill the worker whose child it is.

        Then open the gate.
        """
        child, worker = waiting_process(gate)
        os.kill(worker, signal.SIGKILL)
        assert has_ended(child), "the process of the cell outlived its worker"
        killed.append(child)
        gate.touch()

    killed: list[int] = []
    thread = threading.Thread(target=kill_the_worker, daemon=True)
    thread.start()
    table = {"methods": ["toy"], "sequences": [str(rooms[0])], "record": "scores"}
    grid = {"toy": {"act": [f"wait:{gate}", "raise"]}}
    board = bench(
        {**table, "grid": grid}, out, scheduler=cluster.scheduler_address, callbacks=Recorder()
    )
    thread.join(20)
    assert killed
    assert waiting_process(gate)[0] != killed[0], "another process has done the cell again"
    assert ["failed" if row.error else "done" for row in board.rows] == ["done", "done", "failed"]
    assert "on worker tcp://" in board.failed[0].error
    assert "this method cannot" in board.failed[0].error
    assert reported
    assert {path.name for path in (out / "one/toy").iterdir()} == {
        "run.rrd", "result.json", "labels.npz", "static_map.pcd", "dynamic_points.pcd",
        "config.toml",
    }  # fmt: skip
    again = bench({**table, "workers": 2}, out)
    assert [row.kept for row in again.rows] == [True], "what the cluster did is done here too"


def test_an_absent_scheduler_is_an_error(
    rooms: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dynaviz.tasks.cluster.CONNECT_TIMEOUT", 1)
    with pytest.raises(UsageError, match="no Dask scheduler answers"):
        bench(
            {"methods": ["octomap"], "sequences": [str(rooms[0])]},
            tmp_path,
            scheduler="tcp://127.0.0.1:9",
        )
    with pytest.raises(UsageError, match="Leave out scheduler"):
        bench(
            {"sequences": [str(rooms[0])], "timing": True}, tmp_path, scheduler="tcp://127.0.0.1:9"
        )
    with pytest.raises(UsageError, match="the cluster sets the number of workers"):
        bench({"sequences": [str(rooms[0])], "workers": 1}, tmp_path, scheduler="tcp://127.0.0.1:9")
