"""Budgets of recordings: states are spread over the run and left out first.

Labels are always stored.
"""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from helpers.worlds import room

import dynaviz as dv
from dynaviz.errors import UsageError
from dynaviz.views.read.reader import RunRecording
from dynaviz.views.record.quota import ANSWER, DRAWN, Quota, fixed, parse_bytes


@pytest.mark.parametrize(
    ("text", "size"),
    [("2GB", 2 * 10**9), ("1.5 tb", 15 * 10**11), ("500k", 500_000), ("7", 7), ("3MB", 3 * 10**6)],
)
def test_sizes(text: str, size: int) -> None:
    assert parse_bytes(text) == size


@pytest.mark.parametrize("text", ["", "2 giga", "-1MB", "1e9"])
def test_other_texts_are_refused(text: str) -> None:
    with pytest.raises(UsageError, match="such as 500MB or 2GB"):
        parse_bytes(text)


@pytest.mark.parametrize("two_passes", [True, False])
def test_states_are_spread_over_the_run_within_the_budget(two_passes: bool) -> None:
    frames, points, state = 100, 1000, 50_000
    rest = fixed(frames * points, frames)
    budget = round(rest + (ANSWER + DRAWN) * frames * points + 40 * state)
    quota, size, drawn = Quota(budget, frames * points, frames, two_passes), 0, []
    for frame in range(frames):
        if quota.states(size, frame, labels=not two_passes):
            size += state
            drawn.append(frame)
    for _ in range(frames):
        size += round(points * (ANSWER + DRAWN))
        quota.answered(points)
    assert len(drawn) == (20 if two_passes else 40)
    assert min(drawn) < 5
    assert max(drawn) > 90
    assert size + rest <= budget + state


def test_a_small_budget_leaves_out_states_and_points_but_no_label(tmp_path: Path) -> None:
    sequence = room(frames=4, rays=1500)
    sizes = {}
    for budget in (None, "1kB"):
        with (
            pytest.warns(UserWarning, match="more than the budget of")
            if budget
            else contextlib.nullcontext()
        ):
            dv.run("octomap", sequence, out=tmp_path, record_budget=budget, maps=False)
        recording = RunRecording(tmp_path / "run.rrd")
        sizes[budget] = sum(
            1 for path in ("world/octomap/log_odds", "world/scan") for _ in recording.rows(path)
        )
        assert [len(each) for each in recording.answers()] == [len(scan) for scan in sequence.scans]
    assert sizes["1kB"] < sizes[None]


def test_a_recording_without_drawn_points_can_be_compared(tmp_path: Path) -> None:
    sequence = room(frames=4, rays=1500)
    dv.run("octomap", sequence, out=tmp_path / "all", maps=False)
    with pytest.warns(UserWarning, match="more than the budget of"):
        dv.run("dufomap", sequence, out=tmp_path / "few", record_budget="1kB", maps=False)
    recordings = [tmp_path / "all/run.rrd", tmp_path / "few/run.rrd"]
    assert [len(points.xyz) for points in RunRecording(recordings[1]).drawn()] == [0] * 4
    pair = dv.compare(*recordings, out=tmp_path / "compare.rrd").pairs[0]
    assert pair.differ is not None
