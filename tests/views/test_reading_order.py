"""The order of what a finished recording contains."""

from __future__ import annotations

import errno
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun.blueprint as rrb
from helpers.guessing_method import record_with_metrics
from helpers.viewer_client import headless, opened_at, problems
from helpers.worlds import room
from rerun.chunk import Chunk, RrdReader

from dynaviz.views import paths, reading_order
from dynaviz.views.read.chunks import chunks_in
from dynaviz.views.read.reader import RunRecording
from dynaviz.views.read.repair import repaired

BY_FRAME = (f"/{paths.SCAN}", f"/{paths.ANSWERS}")
STATIC, CASES, CURVES, FRAMES, END = range(5)


@pytest.fixture(scope="module")
def ordered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_with_metrics(room(6, 1500), tmp_path_factory.mktemp("ordered") / "run.rrd")


@pytest.fixture(scope="module")
def as_written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reading_order, "rewrite", lambda *_: None)
        path = tmp_path_factory.mktemp("written") / "run.rrd"
        return record_with_metrics(room(6, 1500), path)


def place(chunk: Chunk) -> int:
    if "complete" in chunk.to_record_batch().schema.names:
        return END if chunk.to_record_batch()["complete"].to_pylist()[-1][0] else STATIC
    if chunk.is_static:
        return STATIC
    if paths.CASE in chunk.timeline_names:
        return CASES
    return FRAMES if str(chunk.entity_path) in BY_FRAME else CURVES


def test_what_the_first_screen_needs_arrives_before_the_first_frame(
    ordered: Path, as_written: Path
) -> None:
    """Counted in bytes of the file, as they arrive over a network."""
    first = {}
    for path in (ordered, as_written):
        found = list(chunks_in(path))
        starts = [at for at, _, entity, on in found if entity in BY_FRAME and paths.FRAME in on]
        cases = [end for _, end, _, on in found if paths.CASE in on]
        first[path] = min(starts), max(cases)
    assert first[ordered][1] <= first[ordered][0] < ordered.stat().st_size
    assert first[as_written][1] > first[as_written][0]  # which the other order improves


def test_the_layout_texts_and_cases_come_before_frames(ordered: Path) -> None:
    reader = RrdReader(ordered)
    assert len(reader.recordings()) == len(reader.blueprints()) == 1
    places = [place(chunk) for chunk in reader.stream().to_chunks()]
    first = {kind: places.index(kind) for kind in (STATIC, CASES, CURVES, FRAMES, END)}
    assert list(first.values()) == sorted(first.values())
    assert places[-1] == END
    frames = [
        frame
        for chunk in reader.stream().filter(content=BY_FRAME[0]).to_chunks()
        if paths.FRAME in chunk.timeline_names
        for frame in chunk.to_record_batch()[paths.FRAME].to_pylist()
    ]
    assert frames == list(range(6))


def test_nothing_is_lost(ordered: Path, as_written: Path) -> None:
    assert len(RrdReader(as_written).blueprints()) == 2
    assert times(as_written) == times(ordered)
    before = RunRecording(as_written)
    after = RunRecording(ordered)
    for one, other in zip(before.answers(), after.answers(), strict=True):
        np.testing.assert_array_equal(one.outcome, other.outcome)
    for path in (paths.MAP, paths.FAILURE_LIST):
        np.testing.assert_equal(before.static(path), after.static(path))
    assert before.result is not None
    assert after.complete


def times(path: Path) -> dict[tuple[str, str], set[str]]:
    """The times of all rows by entity and timeline; of static content none."""
    found: defaultdict[tuple[str, str], set[str]] = defaultdict(set)
    for chunk in RrdReader(path).stream().to_chunks():
        entity = str(chunk.entity_path)
        for name in chunk.timeline_names or [""]:
            rows = chunk.to_record_batch()[name].to_pylist() if name else []
            found[entity, name].update(map(str, rows))
    return found


def test_a_file_shows_the_cases_when_half_of_the_frames_have_arrived(
    ordered: Path, tmp_path: Path
) -> None:
    """What a viewer has received of a file that is still arriving."""
    frames = [at for at, _, entity, _ in chunks_in(ordered) if entity in BY_FRAME]
    part = tmp_path / "part.rrd"
    part.write_bytes(ordered.read_bytes()[: frames[len(frames) // 2]])
    with pytest.warns(UserWarning, match="incomplete"):
        recording = RunRecording(repaired(part))
    assert not recording.complete
    assert "did not finish" not in recording.static(paths.REPORT)["TextDocument:text"][0]
    assert len(dict(recording.rows(paths.CASE_TEXT, paths.CASE))) == len(
        dict(RunRecording(ordered).rows(paths.CASE_TEXT, paths.CASE))
    )


def test_the_viewer_opens_it_at_the_first_case(ordered: Path) -> None:
    with headless((1200, 800)) as client:
        shown = problems(ordered, client)
        opened = opened_at(client, (paths.CASE, 1))
    assert opened == (paths.CASE, 1)
    assert {name: reports for name, reports in shown.items() if reports} == {}


def test_a_full_disk_leaves_the_recording_as_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(reading_order, "open_writer", full)
    path = record_with_metrics(room(4, 500), tmp_path / "run.rrd")
    assert RunRecording(path).complete
    assert not list(tmp_path.glob("*.ordered"))


def test_states_of_cases_alone_are_in_no_frame(
    ordered: Path, as_written: Path, tmp_path: Path
) -> None:
    state = f"{paths.WORLD}/guess/cells"
    path = tmp_path / "run.rrd"
    path.write_bytes(as_written.read_bytes())
    reading_order.rewrite(path, rrb.Blueprint(), [paths.SCAN, state], [state])
    assert ("/" + state, paths.FRAME) in times(ordered)
    assert ("/" + state, paths.FRAME) not in times(path)
    assert ("/" + state, paths.CASE) in times(path)
    assert ("/" + paths.SCAN, paths.FRAME) in times(path)
