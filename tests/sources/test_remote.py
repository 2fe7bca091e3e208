"""Sequences at URLs: the same scans as from the folder, fetched when they are read."""

from __future__ import annotations

import functools
import http.server
import pickle
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import fsspec
import numpy as np
import pytest
from helpers.toy_method import write_room

import dynaviz as dv
from dynaviz.errors import DataError, MissingDependency

FRAMES = 3


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("DYNAVIZ_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_room(tmp_path / "room", frames=FRAMES)


@pytest.fixture
def server(folder: Path) -> Iterator[str]:
    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *args: object) -> None:
            pass

    handler = functools.partial(Quiet, directory=str(folder.parent))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as running:
        threading.Thread(target=running.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{running.server_port}/room"
        running.shutdown()


def in_memory(folder: Path, name: str) -> str:
    files = fsspec.filesystem("memory")
    for path in folder.rglob("*"):
        if path.is_file():
            files.pipe_file(f"/{name}/{path.relative_to(folder).as_posix()}", path.read_bytes())
    return f"memory://{name}"


def test_http_gives_the_scans_of_the_folder_with_their_truth(folder: Path, server: str) -> None:
    local, remote = dv.open(folder), dv.open(server)
    assert (remote.name, len(remote), remote.has_labels) == (local.name, FRAMES, local.has_labels)
    for position in range(FRAMES):
        assert (remote[position].points == local[position].points).all()
        assert (remote[position].labels == local[position].labels).all()
    assert (pickle.loads(pickle.dumps(remote))[1].points == local[1].points).all()


def test_without_truth_a_scan_is_fetched_when_it_is_read(folder: Path, cache: Path) -> None:
    (folder / "gt_cloud.pcd").unlink()
    remote = dv.open(in_memory(folder, "lazy"))
    assert len(remote) == FRAMES
    assert len(list(cache.rglob("*.pcd"))) == 1
    assert np.isfinite(remote[2].points).all()
    assert len(list(cache.rglob("*.pcd"))) == 2


def test_a_url_without_scans_and_an_unknown_kind_of_url_are_refused() -> None:
    with pytest.raises(DataError, match=r"has no pcd/\*\.pcd. Give the URL"):
        dv.open("memory://nothing")
    with pytest.raises(DataError, match="is not a URL that can be read"):
        dv.open("carrier-pigeon://loft")


def test_without_fsspec_one_line_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fsspec", None)
    with pytest.raises(MissingDependency, match=r"pip install 'fsspec\[http\]'"):
        dv.open("https://example.org/drive")
