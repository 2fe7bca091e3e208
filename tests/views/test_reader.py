"""Files that are not readable recordings, and recordings of other versions."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import rerun as rr
from helpers.guessing_method import record
from helpers.worlds import InMemory, room

from dynaviz.errors import DataError
from dynaviz.views import paths
from dynaviz.views.read.reader import RunRecording, read

Command = Callable[..., tuple[int, str, str]]


def foreign(path: Path) -> None:
    stream = rr.RecordingStream("other")
    stream.save(path)
    stream.log("a", rr.Points3D([[0, 0, 0]]), static=True)
    stream.disconnect()


def cut(path: Path) -> None:
    whole = record(room(2, 200), path)
    path.write_bytes(whole.read_bytes()[:-1000])


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (lambda path: None, "No such file"),
        (lambda path: path.mkdir(), "Is a directory"),
        (lambda path: path.write_bytes(b""), "is not a recording"),
        (lambda path: path.write_bytes(b"# .PCD v0.7"), "byte 0: is not a recording"),
        (foreign, "not from dynaviz"),
        (cut, r"is incomplete.*dynaviz info"),
    ],
    ids=["missing", "folder", "empty", "cloud", "foreign", "cut"],
)
def test_files_that_are_not_readable_recordings(tmp_path: Path, make: Any, problem: str) -> None:
    path = tmp_path / "run.rrd"
    make(path)
    with pytest.raises(DataError, match=problem) as caught:
        RunRecording(path)
    assert str(caught.value).startswith(str(path))


def test_recordings_of_other_versions(
    little_room: InMemory, tmp_path: Path, run_command: Command
) -> None:
    path, whole = (
        tmp_path / "x.rrd",
        record(little_room, tmp_path / "run.rrd", "scores").read_bytes(),
    )
    says = {
        b"RRF1" + whole[4:]: "before 0.23",  # of such a rerun; its files cannot be made here
        whole[:5] + b"\xfe" + whole[6:-100]: "rerun 0.254",
        older(tmp_path): "older dynaviz and lacks title",
    }
    for content, word in says.items():
        path.write_bytes(content)
        for verb in ("info", "view"):
            if verb == "view" and "older" in word:
                continue  # the viewer needs no properties
            code, _, err = run_command(verb, path)
            assert (code, err.count("\n"), word in err) == (2, 1, True), err


def older(folder: Path) -> bytes:
    """A recording with fewer properties."""
    with rr.RecordingStream("old", send_properties=False) as stream:
        stream.save(folder / "old.rrd")
        stream.send_property(paths.PROPERTIES, rr.AnyValues(schema=0, method="octomap", frames=2))
        stream.disconnect()
    return (folder / "old.rrd").read_bytes()


def test_the_part_of_a_killed_run_is_read(tmp_path: Path, run_command: Command) -> None:
    shutil.copy(record(room(3, 200), tmp_path / "whole.rrd", "scores"), tmp_path / ".run.rrd.part")
    with pytest.raises(DataError, match=f"dynaviz info {tmp_path / '.run.rrd.part'}"):
        read(tmp_path / "run.rrd")
    for name in ("run.rrd", ".run.rrd.part"):
        code, _, err = run_command("info", tmp_path / name)
        assert (code, err.count("\n")) == (0, 1)
        assert (
            f"{tmp_path / '.run.rrd.part'}: is the recording of a run that did not finish." in err
        )
