"""A folder has one writer at a time, and locks of processes that ended have no effect."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from pathlib import Path

import pytest
from helpers.worlds import InMemory

from dynaviz import api, bench
from dynaviz.errors import DataError
from dynaviz.io import lock
from dynaviz.io.lock import NAME, Owner, locked

HOLDER = """
import sys, time
from pathlib import Path
from dynaviz.io.lock import locked
with locked(Path(sys.argv[1])):
    print("locked", flush=True)
    time.sleep(60)
"""


def hold(folder: Path) -> subprocess.Popen[str]:
    """A process that holds the lock of a folder."""
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, folder], stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout
    assert holder.stdout.readline() == "locked\n"
    return holder


def test_another_process_is_named_and_its_lock_ends_with_it(
    tmp_path: Path, little_room: InMemory
) -> None:
    with hold(tmp_path) as holder:
        try:
            for write in (
                lambda: api.run("octomap", little_room, out=tmp_path, record="none"),
                lambda: bench({"methods": ["octomap"], "sequences": ["simulate:demo:2"]}, tmp_path),
            ):
                with pytest.raises(
                    DataError,
                    match=rf"process {holder.pid} on .* is writing into this folder\. Wait",
                ):
                    write()
            assert os.listdir(tmp_path) == [NAME]
        finally:
            holder.send_signal(signal.SIGKILL)
        holder.wait()
        with locked(tmp_path):
            assert Owner.of(tmp_path / NAME) == Owner.here()
    assert os.listdir(tmp_path) == []


def test_locks_that_have_no_effect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lock, "_PATIENCE", 0)
    here, path = Owner.here(), tmp_path / NAME
    earlier = json.dumps(
        asdict(replace(here, started=here.started - 1000))
    )  # another process had the same number
    for content in (earlier, "", "{", "[]", '{"pid": "x"}'):
        path.write_text(content)
        with locked(tmp_path):
            assert Owner.of(path) == here
        assert os.listdir(tmp_path) == []


def test_a_lock_of_another_machine_is_respected(tmp_path: Path) -> None:
    owner = Owner(1, "elsewhere", 0.0, "dynaviz run")
    (tmp_path / NAME).write_text(json.dumps(asdict(owner)))
    with (
        pytest.raises(
            DataError, match=r"process 1 on elsewhere .* if it was killed, remove .*\.lock"
        ),
        locked(tmp_path),
    ):
        pass
    assert Owner.of(tmp_path / NAME) == owner


def test_one_of_many_threads_gets_the_lock(tmp_path: Path) -> None:
    (tmp_path / NAME).write_text(
        json.dumps(asdict(Owner(os.getpid(), Owner.here().host, 0.0, "")))
    )  # an old lock
    ready, done = threading.Barrier(8), threading.Barrier(8)

    def attempt(_: int) -> bool:
        ready.wait()
        try:
            with locked(tmp_path):
                done.wait()
                return True
        except DataError:
            done.wait()
            return False

    with ThreadPoolExecutor(8) as pool:
        assert sum(pool.map(attempt, range(8))) == 1
    assert os.listdir(tmp_path) == []


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with (
        pytest.raises(DataError, match=r"file/out: cannot be written .* choose another folder"),
        locked(tmp_path / "file/out"),
    ):
        pass


def test_the_folder_of_a_killed_run_says_how_to_finish_it(
    tmp_path: Path, little_room: InMemory, run_command: Callable[..., tuple[int, str, str]]
) -> None:
    folder = tmp_path / "runs/octomap"
    command = f"dynaviz run octomap somewhere -o {folder}"

    def remember(*_: object) -> None:
        copies.append((folder / NAME).read_bytes())

    copies: list[bytes] = []
    api.run("octomap", little_room, out=folder, record="none", command=command, progress=remember)
    (folder / "result.json").unlink()
    owner = json.loads(copies[0])
    (folder / NAME).write_text(json.dumps({**owner, "started": 0}))  # a process that ended
    for words in (("info", folder), ("report", tmp_path)):
        code, _, err = run_command(*words)
        assert (code, err) == (
            2,
            f"dynaviz: {folder}: contains an unfinished run. To finish it, run again: {command}.\n",
        )
    (folder / NAME).write_bytes(copies[0])
    assert "is writing into this folder. Wait" in run_command("info", folder)[2]
