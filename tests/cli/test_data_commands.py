"""``dynaviz convert`` of sequences, labels and downloads, as a user types it."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from helpers.worlds import room

from dynaviz.sources.datasets import fetch
from dynaviz.sources.datasets.convert import convert

Command = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The little room in the public benchmark's layout."""
    path = tmp_path_factory.mktemp("data") / "room"
    convert(room(frames=4, rays=1000), path)
    return path


@pytest.fixture
def mirror(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A server with ``05.zip``, which knows no Range."""
    served = tmp_path / "served"
    shutil.make_archive(str(served / "05"), "zip", folder)
    handler = type("Quiet", (SimpleHTTPRequestHandler,), {"log_message": lambda *words: None})
    for name in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(fetch, "RETRY_DELAY", 0.0)
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(handler, directory=served)) as server:
        thread = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}"
        server.shutdown()
        thread.join()


def one_line(err: str) -> str:
    assert err.count("\n") == 1, err
    return err


def test_convert_takes_frames_and_sensor(
    run_command: Command, folder: Path, tmp_path: Path
) -> None:
    code, out, err = run_command(
        "convert", folder, tmp_path / "x", "--frames", "1:", "--stride", 2, "--sensor", "vlp16"
    )
    assert code == 0, err
    assert "2 frames, 2,000 points, poses bit for bit" in out
    assert "write 2/2 frames" in err
    assert sorted(path.name for path in (tmp_path / "x/pcd").iterdir()) == [
        "000011.pcd",
        "000013.pcd",
    ]
    assert 'sensor = "vlp16"' in (tmp_path / "x/sequence.toml").read_text()
    code, _, err = run_command("convert", folder, tmp_path / "x")
    assert (code, "already exists" in one_line(err)) == (2, True)


def test_convert_takes_poses_and_warns(run_command: Command, tmp_path: Path) -> None:
    scans = room(frames=2, rays=50).scans
    for scan in scans:
        local = scan.points - scan.position.astype(np.float32)
        path = tmp_path / f"scans/{scan.index:06d}.bin"
        path.parent.mkdir(exist_ok=True)
        np.column_stack([local, np.zeros(50)]).astype("<f4").tofile(path)
    (tmp_path / "scans/labels").mkdir()
    np.save(tmp_path / "scans/labels/000010.npy", np.full(50, 1))
    rows = [" ".join(map(str, scan.T_world_sensor[:3].ravel())) for scan in scans]
    (tmp_path / "track.txt").write_text("\n".join(rows) + "\n")
    code, out, err = run_command(
        "convert", tmp_path / "scans", tmp_path / "out", "--poses", tmp_path / "track.txt"
    )
    assert code == 0, err
    assert "2 frames, 100 points" in out
    assert "warning: 50 of 100 points are unlabelled" in err
    code, out, _ = run_command("info", tmp_path / "out")
    assert code == 0
    assert "benchmark" in out


def test_convert_labels(run_command: Command, folder: Path, tmp_path: Path) -> None:
    assert (
        run_command(
            "run", "octomap", folder, "-o", tmp_path / "run", "--record", "none", "--frames", "1:3"
        )[0]
        == 0
    )
    code, out, err = run_command("convert", tmp_path / "run", tmp_path / "labels", "--labels")
    assert code == 0, err
    assert "2 frames" in out
    assert sorted(path.name for path in (tmp_path / "labels").iterdir()) == [
        "000011.label",
        "000012.label",
        "boxes.csv",
    ]


def test_download(
    run_command: Command, mirror: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DYNAVIZ_DOWNLOAD_URL", mirror)
    code, out, err = run_command("convert", "download:05", tmp_path / "data")
    assert code == 0, err
    assert "KITTI 05" in out
    assert "unpack 6/6 files" in err
    code, out, _ = run_command("info", tmp_path / "data/05")
    assert (code, "4,000" in out) == (0, True)
    code, _, err = run_command("convert", "download:00", tmp_path / "data")
    assert (code, "00.zip: download failed (404" in one_line(err)) == (2, True)
    code, _, err = run_command("convert", "download:moon", tmp_path / "data")
    assert (code, "Available: 00 (385 MB)" in one_line(err)) == (2, True)


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (("download:05", "--frames", "1:2"), "--frames: not with download:NAME"),
        (("run", "--labels", "--stride", "2"), "--stride: not with --labels"),
        (("scans", "--sequence", "moved"), "--sequence: only with --labels"),
    ],
)
def test_options_without_effect_are_refused(
    run_command: Command, tmp_path: Path, words: tuple[str, ...], option: str
) -> None:
    source, *options = words
    assert run_command("convert", source, tmp_path / "x", *options) == (
        2,
        "",
        f"dynaviz: {option}\n",
    )
