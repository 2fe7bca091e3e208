"""Recordings with damaged chunks are refused in one line, and repair keeps every other chunk."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import rerun as rr
from helpers.damage import messages, recording_of
from helpers.guessing_method import record
from helpers.worlds import room
from rerun.chunk import RrdReader

from dynaviz.errors import DataError
from dynaviz.explorer.run import ExploredRun
from dynaviz.views import drawn
from dynaviz.views.read import chunks
from dynaviz.views.read.focus import CASE
from dynaviz.views.read.reader import RunRecording, read
from dynaviz.views.read.repair import salvage

Command = Callable[..., tuple[int, str, str]]
Damage = Callable[[bytes], bytes]
FRAMES = 4


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(room(FRAMES, 200), tmp_path_factory.mktemp("whole") / "run.rrd")


def garbled(chunk: bytes) -> bytes:
    """Compressed data that cannot be decompressed."""
    middle = len(chunk) // 2
    return chunk[:middle] + b"\xff" * 40 + chunk[middle + 40 :]


def out_of_bounds(chunk: bytes) -> bytes:
    """A table that refers to bytes beyond its end; rerun ends the process when it reads one."""
    fields, table = dict(chunks._fields(chunk)), _table(chunk)
    store = b"\x0a" + varint(len(fields[1])) + bytes(fields[1])
    for at in range(0, len(table), 8):
        patched = table[:at] + struct.pack("<q", 1 << 50) + table[at + 8 :]
        content = (
            store
            + b"\x10\x01\x18"
            + varint(len(table))
            + b"\x20\x01\x2a"
            + varint(len(table))
            + patched
        )
        if "out of bounds" in (chunks._problem(content) or ""):
            return content
    raise AssertionError("the table has no buffers")


def varint(number: int) -> bytes:
    return bytes([number]) if number < 128 else bytes([number & 127 | 128]) + varint(number >> 7)


def damaged(whole: Path, out: Path, damage: Damage, frame: int = 1) -> Path:
    """The recording with a damaged chunk: the answers of a frame."""
    parts = messages(whole.read_bytes())
    answers = [
        k for k, (kind, content) in enumerate(parts) if kind == 2 and b"/answers" in _table(content)
    ]
    parts[answers[frame]] = 2, damage(parts[answers[frame]][1])
    out.write_bytes(recording_of(whole.read_bytes(), parts))
    return out


def _table(content: bytes) -> bytes:
    fields = dict(chunks._fields(content))
    return pa.decompress(fields[5], fields[3], "lz4_raw").to_pybytes()


@pytest.mark.parametrize("damage", [garbled, out_of_bounds])
def test_a_damaged_chunk(whole: Path, tmp_path: Path, run_command: Command, damage: Damage) -> None:
    broken = damaged(whole, tmp_path / "run.rrd", damage)
    content = broken.read_bytes()
    for words in (
        ("info", broken),
        ("info", tmp_path, "--failures"),
        ("compare", whole, broken, "-o", tmp_path / "both.rrd"),
        ("why", broken, "--frame", 0, "--point", 0),
    ):
        _, _, err = run_command(*words)
        assert err.startswith(f"dynaviz: warning: {broken}: contains a damaged chunk"), err
        if words[0] == "info" and len(words) == 2:
            saved = f"Saved {FRAMES - 1} of {FRAMES} frames, without 1 damaged chunk in"
        else:
            saved = "Reading"
        assert f"{saved} {tmp_path / 'run-repaired.rrd'}" in err
    assert broken.read_bytes() == content
    salvaged = RunRecording(tmp_path / "run-repaired.rrd")
    assert [answers.frame for answers in salvaged.answers()] == [0, 2, 3]
    assert [points.frame for points in salvaged.drawn()] == [0, 1, 2, 3]
    assert set(salvaged.entities()) == set(RunRecording(whole).entities())
    assert len(RrdReader(salvaged.path).blueprints()) == len(RrdReader(whole).blueprints())


def test_every_other_chunk_is_kept_where_a_size_is_wrong(whole: Path, tmp_path: Path) -> None:
    """Without its size the next message is found by its content."""
    broken, content = tmp_path / "run.rrd", whole.read_bytes()
    parts = messages(content)
    ordinary = next(
        k for k, (kind, part) in enumerate(parts) if kind == 2 and b"/answers" in _table(part)
    )
    at = 12 + sum(16 + len(part) for _, part in parts[:ordinary])
    broken.write_bytes(content[: at + 8] + struct.pack("<Q", 1 << 40) + content[at + 16 :])
    after = at + 16 + len(parts[ordinary][1])
    assert [(found.at, found.end, found.truncated) for found in chunks.damages(broken)] == [
        (at, after, False)
    ]
    with pytest.raises(DataError, match=rf"byte {at}: contains a damaged chunk .*dynaviz info"):
        read(broken)
    found = salvage(broken, tmp_path / "saved.rrd")
    assert (found.answered, found.damaged) == (FRAMES - 1, 1)
    assert RunRecording(tmp_path / "saved.rrd").complete


def test_properties_that_are_not_valid(tmp_path: Path) -> None:
    properties = RunRecording(record(room(2, 50), tmp_path / "run.rrd", "scores")).properties
    original = {
        name: value.item() if isinstance(value, np.generic) else value
        for name, value in properties.items()
    }
    for k, (name, value) in enumerate(
        {"params_json": "{", "result_json": "[", "reasons_json": '[{"name": 1'}.items()
    ):
        path = tmp_path / f"{k}.rrd"
        with rr.RecordingStream("test", send_properties=False) as stream:
            stream.save(path)
            stream.send_property("run", rr.AnyValues(**{**original, name: value}))
        with pytest.raises(DataError, match=r"contains damaged data .*dynaviz info"):
            read(path)


def test_points_without_answers_are_not_explored(
    whole: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(RunRecording, "answers", lambda self: iter(()))
    with pytest.raises(
        DataError, match=r"frame 0: contains points without an answer.*dynaviz info"
    ):
        ExploredRun(whole)


def test_runs_on_other_points_are_not_explored_together(whole: Path, tmp_path: Path) -> None:
    other = ExploredRun(record(room(FRAMES, 190), tmp_path / "run.rrd"))
    with pytest.raises(DataError, match=r"run.rrd, frame \d: has other points than"):
        ExploredRun(whole).wrong_too(other)


def test_a_chunk_that_only_rerun_cannot_read(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Arrow does not check the text of a table's metadata, which rerun reads when the chunk is
    used.
    """

    def rows_of(*_: object) -> None:
        raise RuntimeError("Failed to load chunks: Utf8Error")

    monkeypatch.setattr(drawn, "rows_of", rows_of)
    with pytest.raises(DataError, match=r"contains damaged data .*Utf8Error.*dynaviz info"):
        ExploredRun(whole).focus.layout(CASE, "case", 3, np.full(3, -9.0), np.full(3, 9.0), None)
