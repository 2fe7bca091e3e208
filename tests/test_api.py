"""The functions that scripts call."""

from __future__ import annotations

from pathlib import Path

import pytest
from worlds import InMemory

import dynaviz as dv
from dynaviz.errors import UsageError


def test_a_recording_alone(little_room: InMemory, tmp_path: Path) -> None:
    from dynaviz.viz.reader import Recording

    result = dv.run("octomap", little_room, record=tmp_path / "here.rrd")
    assert [file.name for file in tmp_path.iterdir()] == ["here.rrd"]
    assert Recording(tmp_path / "here.rrd").result.metrics == result.metrics


def test_nothing_is_written_unasked(little_room: InMemory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    recorded = dv.run("octomap", little_room, out="kept", record="scores")
    assert dv.run("octomap", little_room).labels_sha256 == recorded.labels_sha256
    assert [file.name for file in tmp_path.iterdir()] == ["kept"]


def test_a_way_to_record_that_is_none(little_room: InMemory) -> None:
    with pytest.raises(UsageError, match=r"record = all: give full, errors, scores, none, or the path of an \.rrd"):
        dv.run("octomap", little_room, record="all")
