"""Downloads from a well-behaved server and from faulty ones."""

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

import pytest
from helpers.worlds import room

import dynaviz as dv
from dynaviz.errors import DataError, UsageError
from dynaviz.sources.datasets import fetch
from dynaviz.sources.datasets.convert import convert
from dynaviz.sources.datasets.download import SEQUENCES, download
from dynaviz.sources.summary import summarize

PATH = "/records/10886629/files"


class Server(ThreadingHTTPServer):
    """Serves ``/records/10886629/files/00.zip``, and the record if there is one.

    Other paths are 404.
    """

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.archive = b""
        self.record: dict | bytes | None = None
        self.ranges = True  # whether range requests are supported
        self.cuts: list[int] = []  # number of bytes after which to disconnect, per request
        self.extra_length = 0  # bytes by which the stated length exceeds the real one
        self.failures: list[int] = []  # status codes to send first
        self.kind = "application/octet-stream"
        self.requested_ranges: list[str | None] = []  # Range header of each request

    @property
    def root(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}"

    @property
    def base(self) -> str:
        return self.root + PATH


class Handler(BaseHTTPRequestHandler):
    server: Server

    def do_GET(self) -> None:
        if self.path == "/api/records/10886629" and self.server.record is not None:
            record = self.server.record
            return self.reply(
                200, record if isinstance(record, bytes) else json.dumps(record).encode()
            )
        if self.path != f"{PATH}/00.zip":
            return self.reply(404, b"no such file")
        server, requested = self.server, self.headers["Range"]
        server.requested_ranges.append(requested)
        if server.failures:
            return self.reply(server.failures.pop(0), b"")
        whole = server.archive
        start = (
            int(requested.removeprefix("bytes=").rstrip("-")) if requested and server.ranges else 0
        )
        total = len(whole) + server.extra_length
        if requested and server.ranges and start >= total:
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

    def reply(self, code: int, content: bytes) -> None:
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
    """Like the benchmark's archives: a folder with the name of the sequence, and macOS metadata."""
    files = {
        f"00/{path.relative_to(sequence)}": path.read_bytes() for path in sequence.rglob("*.pcd")
    }
    return zipped(
        {"__MACOSX/00/pcd/._000010.pcd": b"junk", "00/pcd/._000011.pcd": b"junk", **files}
    )


@pytest.fixture
def server(archive: bytes, monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    monkeypatch.setattr(fetch, "RETRY_DELAY", 0.0)
    monkeypatch.setattr(fetch, "TIMEOUT", 5.0)
    for name in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    with Server() as server:
        server.archive = archive
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def zenodo_record(content: bytes, **other: object) -> dict:
    """The record in the format of the Zenodo API."""
    file = {
        "key": "00.zip",
        "size": len(content),
        "checksum": f"md5:{hashlib.md5(content).hexdigest()}",
    } | other
    return {"id": 10886629, "files": [{"key": "05.zip", "size": 1, "checksum": "md5:0"}, file]}


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("has_record", [True, False])
def test_a_sequence_is_downloaded(
    server: Server, archive: bytes, sequence: Path, tmp_path: Path, has_record: bool
) -> None:
    server.record = zenodo_record(archive) if has_record else None
    seen: list[tuple[str, int, int]] = []
    folder = download("00", tmp_path / "data", server.base, lambda *what: seen.append(what))
    assert summarize(dv.open(folder)).digest == summarize(dv.open(sequence)).digest
    assert dv.open(folder).sensor.name == "hdl64e"
    assert names_in(folder) == ["gt_cloud.pcd", "pcd", "sequence.toml"]
    assert names_in(tmp_path / "data") == ["00"]
    assert seen[-1] == ("unpack", 4, 4)
    assert server.requested_ranges == [None]


def test_a_broken_connection_is_resumed(server: Server, archive: bytes, tmp_path: Path) -> None:
    server.cuts = [1000, 1, 500]
    download("00", tmp_path, server.base)
    assert server.requested_ranges == [None, "bytes=1000-", "bytes=1001-", "bytes=1501-"]


def test_a_server_without_ranges_restarts(server: Server, archive: bytes, tmp_path: Path) -> None:
    server.ranges, server.cuts = False, [len(archive) - 7, 30]
    download("00", tmp_path, server.base)
    assert [bool(requested) for requested in server.requested_ranges] == [False, True, True]


def test_a_later_command_resumes(server: Server, archive: bytes, tmp_path: Path) -> None:
    server.cuts = [4000] + [0] * 10
    with pytest.raises(
        DataError,
        match=r"00\.zip: download stopped after 0\.0 MB, which are kept \(received 4,000 of .* "
        r"bytes\)",
    ):
        download("00", tmp_path, server.base)
    assert names_in(tmp_path) == [".00.zip.part"]
    assert server.requested_ranges == [None] + ["bytes=4000-"] * (fetch.MAX_ATTEMPTS - 1)
    server.cuts, server.requested_ranges = [], []
    download("00", tmp_path, server.base)
    assert server.requested_ranges == ["bytes=4000-"]
    assert names_in(tmp_path) == ["00"]


def test_a_complete_part_is_not_downloaded_again(
    server: Server, archive: bytes, tmp_path: Path
) -> None:
    (tmp_path / ".00.zip.part").write_bytes(archive)
    download("00", tmp_path, server.base)
    assert server.requested_ranges == [f"bytes={len(archive)}-"]


def test_a_part_that_is_too_long_is_discarded(
    server: Server, archive: bytes, tmp_path: Path
) -> None:
    (tmp_path / ".00.zip.part").write_bytes(archive + b"more")
    download("00", tmp_path, server.base)
    assert server.requested_ranges == [f"bytes={len(archive) + 4}-", None]


def test_a_server_that_states_too_large_a_size(
    server: Server, archive: bytes, tmp_path: Path
) -> None:
    server.extra_length = 50
    with pytest.raises(
        DataError, match=r"download stopped after .* bytes\)\. Run the same command again"
    ):
        download("00", tmp_path, server.base)
    assert len(server.requested_ranges) == fetch.MAX_ATTEMPTS
    assert names_in(tmp_path) == [".00.zip.part"]


def test_a_server_that_states_too_small_a_size(
    server: Server, archive: bytes, tmp_path: Path
) -> None:
    server.extra_length = -50
    with pytest.raises(
        DataError, match=r"00\.zip: truncated or corrupt zip archive .*The file was removed"
    ):
        download("00", tmp_path, server.base)
    assert names_in(tmp_path) == []


def test_a_busy_server_is_tried_again(server: Server, tmp_path: Path) -> None:
    server.failures = [503, 429, 500]
    download("00", tmp_path, server.base)
    assert len(server.requested_ranges) == 4


def test_an_archive_that_differs_from_the_record_is_refused(
    server: Server, archive: bytes, tmp_path: Path
) -> None:
    server.record = zenodo_record(archive, checksum="md5:" + "0" * 32)
    with pytest.raises(
        DataError,
        match=r"md5 mismatch: got [0-9a-f]{32}, but the record at .* has 0{32}\. The file was "
        r"removed",
    ):
        download("00", tmp_path, server.base)
    server.record = zenodo_record(archive, size=7)
    with pytest.raises(DataError, match=rf"size mismatch: got {len(archive)}, but .* has 7"):
        download("00", tmp_path, server.base)
    assert names_in(tmp_path) == []


def test_an_unreadable_record_is_ignored(server: Server, tmp_path: Path) -> None:
    server.record = b"<html>"
    download("00", tmp_path, server.base)
    assert names_in(tmp_path) == ["00"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            b"Sorry, try tomorrow",
            r"truncated or corrupt zip archive \(File is not a zip file; it starts with 'Sorry, "
            r"try tom",
        ),
        (zipped({"readme.txt": b"hello"}), r"the archive contains no pcd/\*\.pcd"),
        (
            zipped({"00/pcd/0.pcd": b"x", "../../evil": b"y"}),
            r"unsafe path '\.\./\.\./evil' in the archive",
        ),
        (zipped({"00/pcd/0.pcd": b"x", "/evil": b"y"}), r"unsafe path '/evil' in the archive"),
        (zipped({"00/pcd/0.pcd": b"x", "00\\..\\..\\evil": b"y"}), "unsafe path"),
    ],
)
def test_invalid_archives_are_refused(
    server: Server, tmp_path: Path, content: bytes, message: str
) -> None:
    server.archive = content
    with pytest.raises(DataError, match=message):
        download("00", tmp_path / "in", server.base)
    assert not (tmp_path / "in/00").exists()
    assert not list(tmp_path.rglob("evil"))


def test_a_corrupt_archive_is_removed(server: Server, archive: bytes, tmp_path: Path) -> None:
    middle = len(archive) // 2
    server.archive = (
        archive[:middle]
        + bytes(byte ^ 0xFF for byte in archive[middle : middle + 40])
        + archive[middle + 40 :]
    )
    with pytest.raises(DataError, match=r"truncated or corrupt zip archive \((Bad CRC|Error -3)"):
        download("00", tmp_path, server.base)
    assert names_in(tmp_path) == []
    server.archive = archive
    download("00", tmp_path, server.base)


def test_a_web_page_is_refused_and_the_part_is_kept(
    server: Server, archive: bytes, tmp_path: Path
) -> None:
    (tmp_path / ".00.zip.part").write_bytes(archive[:500])
    server.kind, server.ranges = "text/html; charset=utf-8", False
    with pytest.raises(DataError, match="the server sent a web page, not the file"):
        download("00", tmp_path, server.base)
    assert (tmp_path / ".00.zip.part").read_bytes() == archive[:500]


def test_servers_without_the_file_are_reported(server: Server, tmp_path: Path) -> None:
    with pytest.raises(
        DataError, match=r"/nowhere/00\.zip: download failed \(404 Not Found\)\. Open the address"
    ):
        download("00", tmp_path, f"{server.root}/nowhere/")
    with pytest.raises(
        DataError, match=r"download stopped before the first byte \(Connection refused\)"
    ):
        download("00", tmp_path, "http://127.0.0.1:9")
    with pytest.raises(DataError, match=r"cannot connect"):
        download("00", tmp_path, "http://no.such.host.invalid")
    for base in ("ftp://somewhere", "file:///etc", "somewhere", "http:///"):
        with pytest.raises(UsageError, match="give the address of a folder"):
            download("00", tmp_path, base)
    with pytest.raises(UsageError, match=r"unknown sequence 'moon'\. Available: 00 \(385 MB\)"):
        download("moon", tmp_path, server.base)
    assert names_in(tmp_path) == []


def test_existing_files_are_not_touched(server: Server, tmp_path: Path) -> None:
    (tmp_path / "00").mkdir()
    with pytest.raises(DataError, match=r"00: already exists"):
        download("00", tmp_path, server.base)
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match=r"file: cannot be written"):
        download("00", tmp_path / "file", server.base)
    assert server.requested_ranges == []


def test_an_interrupted_download_is_kept(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(seconds: float) -> None:
        raise KeyboardInterrupt

    server.cuts = [600]
    monkeypatch.setattr(fetch.time, "sleep", interrupted)
    with pytest.raises(KeyboardInterrupt) as end:
        download("00", tmp_path, server.base)
    assert "Run the same command to resume" in end.value.__notes__[0]
    assert (tmp_path / ".00.zip.part").stat().st_size == 600


def test_the_sensors_of_the_sequences_exist() -> None:
    from dynaviz.contracts.sensors import sensor_names

    assert {remote.sensor for remote in SEQUENCES.values()} - {None} <= set(sensor_names())


def test_too_little_disk_space_is_reported_before_unpacking(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda path: SimpleNamespace(free=40))
    with pytest.raises(
        DataError, match=r"needs 0\.0 GB unpacked, but 0\.0 GB are free.*the archive is kept"
    ):
        download("00", tmp_path, server.base)
    assert names_in(tmp_path) == [".00.zip.part"]
