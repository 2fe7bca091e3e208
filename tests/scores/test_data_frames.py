"""Results as data frames: the rows and numbers of the sections."""

from __future__ import annotations

import sys

import pytest
from helpers.worlds import InMemory

import dynaviz as dv
from dynaviz.errors import UsageError
from dynaviz.scores.result import Result


@pytest.fixture
def scored(little_room: InMemory) -> Result:
    return dv.run("octomap", little_room)


def test_cases_are_rows_in_their_order(scored: Result) -> None:
    frame = scored.to_pandas()
    assert list(frame["case"]) == list(range(1, len(scored.failures) + 1))
    for row, case in zip(frame.to_dict("records"), scored.failures, strict=True):
        assert (row["kind"], row["points"], row["cost"]) == (case.kind, case.points, case.cost)
        assert (row["low_x"], row["high_z"]) == (case.low[0], case.high[2])
        assert row["range_mean"] == case.range.mean
        assert row["class"] == case.class_
        if case.looks is not None:
            assert row["looks_through"] == case.looks.through


@pytest.mark.parametrize("table", ["objects", "frames", "ranges", "heights"])
def test_counts_of_a_table_add_up_to_those_of_the_run(scored: Result, table: str) -> None:
    frame = scored.to_pandas(table)  # type: ignore[arg-type]
    parts = ("dynamic_removed", "dynamic_kept")
    if table != "objects":  # static points belong to no object
        parts += ("static_kept", "static_removed")
    for part in parts:
        assert frame[part].sum() == scored.counts[part]


def test_reasons_are_rows_with_their_meaning(scored: Result) -> None:
    frame = scored.to_pandas("reasons")
    assert frame["dynamic_removed"].sum() == scored.counts["dynamic_removed"]
    assert frame["false_positive"].sum() == scored.counts["static_removed"]
    assert frame["meaning"].str.len().min() > 0


def test_a_run_without_ground_truth_lists_its_clusters(little_room: InMemory) -> None:
    scans = [(scan.points, scan.T_world_sensor) for scan in little_room]
    blind = dv.run("octomap", scans, points_in="world")
    frame = blind.to_pandas()
    assert len(frame) == len(blind.clusters)
    removals = blind.sections.removals
    assert removals is not None
    assert blind.to_pandas("frames")["removed"].sum() == removals.removed
    assert blind.to_pandas("objects").empty


def test_an_unknown_table_is_rejected(scored: Result) -> None:
    with pytest.raises(UsageError, match="table = boxes: give one of cases, objects"):
        scored.to_pandas("boxes")  # type: ignore[arg-type]


def test_what_to_install_is_said(scored: Result, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(UsageError, match="pip install pandas"):
        scored.to_pandas()
