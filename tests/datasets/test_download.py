"""Downloads from a server that behaves, and from servers that do not."""

from __future__ import annotations

import hashlib
import io
import json
import threading
import zipfile
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.worlds import room

import dynaviz as dv
from dynaviz.datasets import fetch
from dynaviz.datasets.convert import convert
from dynaviz.datasets.download import SEQUENCES, download
from dynaviz.engine.summary import summarize
from dynaviz.errors import DataError, UsageError

PLACE = "/records/10886629/files"


class Server(ThreadingHTTPServer):
    """Serves ``/records/10886629/files/00.zip``, and the record if there is one; all else is 404."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.archive = b""
        self.record: dict | bytes | None = None
        self.ranges = True  # whether it can begin in the middle
        self.cuts: list[int] = []  # after how many bytes to hang up, request by request
        self.longer = 0  # how many bytes more than there are it promises
        self.failures: list[int] = []  # codes to answer first
        self.kind = "application/octet-stream"
        self.asked: list[str | None] = []  # what Range was asked for

    @property
    def root(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}"

    @property
    def base(self) -> str:
        return self.root + PLACE


class Handler(BaseHTTPRequestHandler):
    server: Server

    def do_GET(self) -> None:
        if self.path == "/api/records/10886629" and self.server.record is not None:
            record = self.server.record
            return self.say(200, record if isinstance(record, bytes) else json.dumps(record).encode())
        if self.path != f"{PLACE}/00.zip":
            return self.say(404, b"no such file")
        server, asked = self.server, self.headers["Range"]
        server.asked.append(asked)
        if server.failures:
            return self.say(server.failures.pop(0), b"")
        whole = server.archive
        start = int(asked.removeprefix("bytes=").rstrip("-")) if asked and server.ranges else 0
        total = len(whole) + server.longer
        if asked and server.ranges and start >= total:
            self.send_response(416)
            self.send_header("Content-Range", f"bytes */{total}")
            self.send_header("Content-Length", "0")
            return self.end_headers()
        self.send_response(206 if start else 200)
        if start:
            self.send_header("Content-Range", f"bytes {start}-{total - 1}/{total}")
        self.send_header("Content-Type", server.kind)
        self.send_header("Content-Length", str(total - start))
        self.end_headers()
        self.wfile.write(whole[start:][: server.cuts.pop(0) if server.cuts else None])

    def say(self, code: int, content: bytes) -> None:
        self.send_response(code)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *args: object) -> None:
        """Be quiet."""


@pytest.fixture(scope="module")
def sequence(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made") / "00"
    convert(room(frames=3), folder)
    (folder / "sequence.toml").unlink()  # the benchmark has none
    return folder


def zipped(files: dict[str, bytes]) -> bytes:
    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return memory.getvalue()


@pytest.fixture(scope="module")
def archive(sequence: Path) -> bytes:
    """As the benchmark's: a folder with the name of the sequence, and what a Mac adds."""
    files = {f"00/{path.relative_to(sequence)}": path.read_bytes() for path in sequence.rglob("*.pcd")}
    return zipped({"__MACOSX/00/pcd/._000010.pcd": b"junk", "00/pcd/._000011.pcd": b"junk", **files})


@pytest.fixture
def server(archive: bytes, monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    monkeypatch.setattr(fetch, "PAUSE", 0.0)
    monkeypatch.setattr(fetch, "PATIENCE", 5.0)
    for name in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    with Server() as server:
        server.archive = archive
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def told(content: bytes, **other: object) -> dict:
    """The record as Zenodo's API tells it."""
    file = {"key": "00.zip", "size": len(content), "checksum": f"md5:{hashlib.md5(content).hexdigest()}"} | other
    return {"id": 10886629, "files": [{"key": "05.zip", "size": 1, "checksum": "md5:0"}, file]}


def left(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("has_record", [True, False])
def test_a_sequence_arrives_whole(
    server: Server, archive: bytes, sequence: Path, tmp_path: Path, has_record: bool
) -> None:
    server.record = told(archive) if has_record else None
    seen: list[tuple[str, int, int]] = []
    folder = download("00", tmp_path / "data", server.base, lambda *what: seen.append(what))
    assert summarize(dv.open(folder)).digest == summarize(dv.open(sequence)).digest
    assert dv.open(folder).sensor.name == "hdl64e"
    assert left(folder) == ["gt_cloud.pcd", "pcd", "sequence.toml"]
    assert left(tmp_path / "data") == ["00", "00.download.json"]
    facts = json.loads((tmp_path / "data/00.download.json").read_text())
    assert facts["sha256"] == hashlib.sha256(archive).hexdigest()
    assert facts["size"] == len(archive)
    assert bool(facts["told"]) == has_record
    assert seen[-1] == ("unpacking, files", 4, 4)
    assert server.asked == [None]


def test_a_cut_connection_goes_on_where_it_stopped(server: Server, archive: bytes, tmp_path: Path) -> None:
    server.cuts = [1000, 1, 500]
    download("00", tmp_path, server.base)
    assert server.asked == [None, "bytes=1000-", "bytes=1001-", "bytes=1501-"]
    facts = json.loads((tmp_path / "00.download.json").read_text())
    assert facts["sha256"] == hashlib.sha256(archive).hexdigest()


def test_a_server_that_cannot_resume_begins_anew(server: Server, archive: bytes, tmp_path: Path) -> None:
    server.ranges, server.cuts = False, [len(archive) - 7, 30]
    download("00", tmp_path, server.base)
    assert [bool(asked) for asked in server.asked] == [False, True, True]
    assert json.loads((tmp_path / "00.download.json").read_text())["size"] == len(archive)


def test_a_later_command_goes_on(server: Server, archive: bytes, tmp_path: Path) -> None:
    server.cuts = [4000] + [0] * 10
    with pytest.raises(DataError, match=r"00\.zip: breaks off after 0\.0 MB, which are kept \(4,000 of .* came\)"):
        download("00", tmp_path, server.base)
    assert left(tmp_path) == [".00.zip.part"]
    assert server.asked == [None] + ["bytes=4000-"] * (fetch.TRIES - 1)
    server.cuts, server.asked = [], []
    download("00", tmp_path, server.base)
    assert server.asked == ["bytes=4000-"]
    assert left(tmp_path) == ["00", "00.download.json"]


def test_what_is_there_already_is_not_asked_for_again(server: Server, archive: bytes, tmp_path: Path) -> None:
    (tmp_path / ".00.zip.part").write_bytes(archive)
    download("00", tmp_path, server.base)
    assert server.asked == [f"bytes={len(archive)}-"]


def test_a_piece_that_is_too_long_is_thrown_away(server: Server, archive: bytes, tmp_path: Path) -> None:
    (tmp_path / ".00.zip.part").write_bytes(archive + b"more")
    download("00", tmp_path, server.base)
    assert server.asked == [f"bytes={len(archive) + 4}-", None]


def test_a_server_that_promises_too_much(server: Server, archive: bytes, tmp_path: Path) -> None:
    server.longer = 50
    with pytest.raises(DataError, match=r"breaks off after .* came\)\. Run the same command again"):
        download("00", tmp_path, server.base)
    assert len(server.asked) == fetch.TRIES + 0
    assert left(tmp_path) == [".00.zip.part"]


def test_a_server_that_promises_too_little(server: Server, archive: bytes, tmp_path: Path) -> None:
    server.longer = -50
    with pytest.raises(DataError, match=r"00\.zip: is no whole zip archive .*It was removed"):
        download("00", tmp_path, server.base)
    assert left(tmp_path) == []


def test_a_busy_server_is_asked_again(server: Server, tmp_path: Path) -> None:
    server.failures = [503, 429, 500]
    download("00", tmp_path, server.base)
    assert len(server.asked) == 4


def test_another_archive_than_the_record_tells(server: Server, archive: bytes, tmp_path: Path) -> None:
    server.record = told(archive, checksum="md5:" + "0" * 32)
    with pytest.raises(DataError, match=r"has md5 [0-9a-f]{32}, where the record at .* tells 0{32}\. It was removed"):
        download("00", tmp_path, server.base)
    server.record = told(archive, size=7)
    with pytest.raises(DataError, match=rf"has size {len(archive)}, where .* tells 7"):
        download("00", tmp_path, server.base)
    assert left(tmp_path) == []


def test_a_record_that_cannot_be_read_is_none(server: Server, tmp_path: Path) -> None:
    server.record = b"<html>"
    download("00", tmp_path, server.base)
    assert json.loads((tmp_path / "00.download.json").read_text())["told"] == {}


def test_the_next_download_must_be_the_same(server: Server, archive: bytes, tmp_path: Path) -> None:
    folder = download("00", tmp_path, server.base)
    for path in sorted(folder.rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    folder.rmdir()
    download("00", tmp_path, server.base)  # the same again
    for path in sorted(folder.rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    folder.rmdir()
    scan = (tmp_path / "x.pcd", np.zeros(3))
    server.archive = zipped({"00/pcd/000000.pcd": repr(scan).encode()})
    with pytest.raises(DataError, match=r"where 00\.download\.json tells .*Remove .* if you trust the new one"):
        download("00", tmp_path, server.base)
    (tmp_path / "00.download.json").unlink()
    download("00", tmp_path, server.base)
    assert left(tmp_path / "00/pcd") == ["000000.pcd"]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"Sorry, try tomorrow", r"is no whole zip archive \(File is not a zip file; it begins with 'Sorry, try tom"),
        (zipped({"readme.txt": b"hello"}), r"holds no pcd/\*\.pcd"),
        (zipped({"00/pcd/0.pcd": b"x", "../../evil": b"y"}), r"holds '\.\./\.\./evil', which leaves its folder"),
        (zipped({"00/pcd/0.pcd": b"x", "/evil": b"y"}), r"holds '/evil', which leaves its folder"),
        (zipped({"00/pcd/0.pcd": b"x", "00\\..\\..\\evil": b"y"}), "which leaves its folder"),
    ],
)
def test_archives_that_are_none(server: Server, tmp_path: Path, content: bytes, says: str) -> None:
    server.archive = content
    with pytest.raises(DataError, match=says):
        download("00", tmp_path / "in", server.base)
    assert not (tmp_path / "in/00").exists()
    assert not list(tmp_path.rglob("evil"))


def test_a_damaged_archive_leaves_nothing(server: Server, archive: bytes, tmp_path: Path) -> None:
    middle = len(archive) // 2
    server.archive = (
        archive[:middle] + bytes(byte ^ 0xFF for byte in archive[middle : middle + 40]) + archive[middle + 40 :]
    )
    with pytest.raises(DataError, match=r"is no whole zip archive \((Bad CRC|Error -3)"):
        download("00", tmp_path, server.base)
    assert left(tmp_path) == []
    server.archive = archive
    download("00", tmp_path, server.base)


def test_a_page_is_no_file_and_does_not_harm_what_was_fetched(server: Server, archive: bytes, tmp_path: Path) -> None:
    (tmp_path / ".00.zip.part").write_bytes(archive[:500])
    server.kind, server.ranges = "text/html; charset=utf-8", False
    with pytest.raises(DataError, match="is a web page, not a file"):
        download("00", tmp_path, server.base)
    assert (tmp_path / ".00.zip.part").read_bytes() == archive[:500]


def test_places_without_the_file(server: Server, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"/nowhere/00\.zip: cannot be fetched \(404 Not Found\)\. Look there"):
        download("00", tmp_path, f"{server.root}/nowhere/")
    with pytest.raises(DataError, match=r"breaks off before its first byte \(Connection refused\)"):
        download("00", tmp_path, "http://127.0.0.1:9")
    with pytest.raises(DataError, match=r"cannot be reached"):
        download("00", tmp_path, "http://no.such.host.invalid")
    for base in ("ftp://somewhere", "file:///etc", "somewhere", "http:///"):
        with pytest.raises(UsageError, match="give the address of a folder"):
            download("00", tmp_path, base)
    with pytest.raises(UsageError, match=r"no sequence 'moon' to download\. Known: 00 \(385 MB\)"):
        download("moon", tmp_path, server.base)
    assert left(tmp_path) == []


def test_what_is_there_is_not_touched(server: Server, tmp_path: Path) -> None:
    (tmp_path / "00").mkdir()
    with pytest.raises(DataError, match=r"00: exists already"):
        download("00", tmp_path, server.base)
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match=r"file: cannot be written"):
        download("00", tmp_path / "file", server.base)
    (tmp_path / "other").mkdir()
    (tmp_path / "other/00.download.json").write_text("[]")
    with pytest.raises(DataError, match=r"00\.download\.json: is no record of a download"):
        download("00", tmp_path / "other", server.base)
    assert server.asked == []


def test_interrupting_keeps_what_came(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(seconds: float) -> None:
        raise KeyboardInterrupt

    server.cuts = [600]
    monkeypatch.setattr(fetch.time, "sleep", interrupted)
    with pytest.raises(KeyboardInterrupt) as end:
        download("00", tmp_path, server.base)
    assert "the same command goes on from there" in end.value.__notes__[0]
    assert (tmp_path / ".00.zip.part").stat().st_size == 600


def test_sensors_are_known() -> None:
    from dynaviz.sensors import sensor_names

    assert {remote.sensor for remote in SEQUENCES.values()} - {None} <= set(sensor_names())


def test_too_little_space_is_told_before_unpacking(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda path: SimpleNamespace(free=40))
    with pytest.raises(DataError, match=r"needs 0\.0 GB unpacked, but 0\.0 GB are free.*the archive is kept"):
        download("00", tmp_path, server.base)
    assert left(tmp_path) == [".00.zip.part"]
