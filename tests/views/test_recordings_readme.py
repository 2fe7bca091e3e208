"""The page on recordings matches the code."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from helpers.guessing_method import record
from helpers.worlds import InMemory

from dynaviz.views import paths
from dynaviz.views.read.reader import RunRecording

PAGE = (Path(__file__).resolve().parents[2] / "recordings/README.md").read_text()


def test_the_example_works(
    little_room: InMemory,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    record(little_room, tmp_path / "run.rrd")
    monkeypatch.chdir(tmp_path)
    example = re.search(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert example
    exec(example[1], {})
    assert "{'outside'}" in capsys.readouterr().out


def test_every_constant_path_and_every_property_is_described(
    little_room: InMemory, tmp_path: Path
) -> None:
    named = set(re.findall(r"`([^`]+)`", PAGE))
    for name in (
        "SCAN",
        "MAP",
        "MAP_WRONG",
        "REMOVED",
        "REMOVED_WRONG",
        "TRAJECTORY",
        "SENSOR",
        "RINGS",
    ):
        assert getattr(paths, name) in named
    for name in ("FAILURES", "CASES", "ANSWERS", "WORST", "REPORT", "FAILURE_LIST", "LOG"):
        assert getattr(paths, name) in named
    assert (
        set(RunRecording(record(little_room, tmp_path / "run.rrd", command="typed")).properties)
        <= named
    )
