"""Repairing recordings that are complete, truncated anywhere, or not recordings.

And the command.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.guessing_method import record
from helpers.worlds import InMemory, room
from hypothesis import given, settings
from hypothesis import strategies as st
from rerun.chunk import RrdReader

from dynaviz.errors import DataError
from dynaviz.views.read.reader import RunRecording
from dynaviz.views.read.repair import repaired, salvage
from dynaviz.views.record.sink import of_part, part_of

Command = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording of six frames, with all that is drawn."""
    return record(room(6, 400), tmp_path_factory.mktemp("whole") / "run.rrd")


def cut(whole: Path, folder: Path, size: int, name: str = "run.rrd") -> Path:
    (folder / name).write_bytes(whole.read_bytes()[:size])
    return folder / name


def test_a_complete_recording_is_not_changed(whole: Path) -> None:
    before = whole.stat().st_mtime_ns
    assert repaired(whole) == whole
    assert [path.name for path in whole.parent.iterdir()] == ["run.rrd"]
    assert whole.stat().st_mtime_ns == before


def test_the_layout_and_every_frame_before_the_cut_are_kept(
    whole: Path, tmp_path: Path, run_command: Command
) -> None:
    answers = list(RunRecording(whole).answers())
    size = whole.stat().st_size
    codes, kept = set(), []
    for share in (0.02, 0.35, 0.55, 0.6, 0.65, 0.7, 0.999):
        folder = tmp_path / str(share)
        folder.mkdir()
        part = cut(whole, folder, int(share * size), ".run.rrd.part")
        code, out, err = run_command("info", part)
        codes.add(code)
        assert err.count("\n") == 1, err
        if code == 2:
            assert "nothing of it can be saved" in err
            assert [path.name for path in folder.iterdir()] == [".run.rrd.part"]
            continue
        salvaged = RunRecording(folder / "run-repaired.rrd")
        mine = list(salvaged.answers())
        kept.append(len(mine))
        saved = f"{len(mine)} of 6 frames" if mine else "states of "
        assert f"Saved {saved}" in err
        assert f"in {folder / 'run-repaired.rrd'}" in err
        assert "octomap" in out or "method" in out
        assert "repaired before" in run_command("info", part)[2]
        assert len(RrdReader(salvaged.path).blueprints()) == 1
        for a, b in zip(mine, answers, strict=False):
            np.testing.assert_array_equal(a.outcome, b.outcome)
            np.testing.assert_array_equal(a.reasons, b.reasons)
        assert salvaged.facts()["finished"].startswith("yes" if salvaged.complete else "no")
    assert codes == {0, 2}
    assert kept == sorted(kept)


@settings(max_examples=15, deadline=None)
@given(share=st.floats(0, 1))
def test_a_recording_truncated_anywhere(
    whole: Path, tmp_path_factory: pytest.TempPathFactory, share: float
) -> None:
    folder = tmp_path_factory.mktemp("cut")
    broken = cut(whole, folder, int(share * whole.stat().st_size))
    before = broken.read_bytes()
    found, target = salvage(broken, folder / "run-repaired.rrd"), folder / "run-repaired.rrd"
    assert found.answered <= found.observed <= 6
    assert target.exists() == (found.observed > 0)
    assert not found.answered or len(list(RunRecording(target).answers())) == found.answered
    assert broken.read_bytes() == before
    assert {path.name for path in folder.iterdir()} <= {"run.rrd", "run-repaired.rrd"}


def test_existing_files_are_not_overwritten(whole: Path, tmp_path: Path) -> None:
    part = cut(whole, tmp_path, whole.stat().st_size - 5000, ".run.rrd.part")
    (tmp_path / "run.rrd").write_bytes(b"a")
    with pytest.warns(UserWarning, match="did not finish|incomplete"):
        assert repaired(part) == tmp_path / "run-repaired.rrd"
    assert (tmp_path / "run.rrd").read_bytes() == b"a"


def test_files_that_are_not_recordings(tmp_path: Path) -> None:
    for content in (b"hello", b""):
        (tmp_path / "x.rrd").write_bytes(content)
        with pytest.raises(DataError, match="not a recording"):
            repaired(tmp_path / "x.rrd")
    with pytest.raises(DataError, match="No such file"):
        repaired(tmp_path / "absent.rrd")


def test_names_of_parts() -> None:
    assert of_part(part_of(Path("a/run.rrd"))) == Path("a/run.rrd")
    assert [of_part(Path(name)) for name in ("run.rrd", "run.rrd.part", ".run.rrd")] == [None] * 3


def test_a_recording_of_scores_is_salvaged(little_room: InMemory, tmp_path: Path) -> None:
    whole = record(little_room, tmp_path / "run.rrd", "scores")
    found = salvage(
        cut(whole, tmp_path, whole.stat().st_size - 4000, "cut.rrd"), tmp_path / "saved.rrd"
    )
    assert found.answered == len(list(RunRecording(tmp_path / "saved.rrd").answers())) == 6
