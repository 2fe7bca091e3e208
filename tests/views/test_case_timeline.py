"""The timeline of cases in a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.guessing_method import Guess, record_with_metrics
from helpers.viewer_client import headless, opened_at, problems
from helpers.worlds import InMemory, room
from rerun.chunk import RrdReader

from dynaviz import colours
from dynaviz.contracts.method import MethodInfo
from dynaviz.contracts.probe import RangeImage, State, Voxels
from dynaviz.contracts.scan import Outcome
from dynaviz.scores.failure_case import FailureCase
from dynaviz.scores.spans import LANES, lane
from dynaviz.views import paths
from dynaviz.views.cases import DID, listed, suspicious
from dynaviz.views.keys import title
from dynaviz.views.read.reader import RunRecording
from dynaviz.views.record import case_timeline
from dynaviz.views.record.case_timeline import see


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> RunRecording:
    """A run with failure cases."""
    return RunRecording(record_with_metrics(room(), tmp_path_factory.mktemp("cases") / "run.rrd"))


def at_cases(recording: RunRecording, path: str) -> dict[int, dict[str, Any]]:
    return dict(recording.rows(path, paths.CASE))


def failures(recording: RunRecording) -> list[FailureCase]:
    assert recording.result is not None
    return listed(recording.result)


def text(row: dict[str, Any]) -> str:
    return str(row["TextDocument:text"][0])


def test_no_legend_is_written_twice(recorded: RunRecording) -> None:
    """Viewers before 0.43.2 ignore a static legend that replaces another."""
    chunks = RrdReader(recorded.path).stream().to_chunks()
    legends = [
        chunk
        for chunk in chunks
        if any("AnnotationContext" in name for name in chunk.to_record_batch().schema.names)
    ]
    assert len(legends) > 1
    assert all(chunk.is_static and chunk.num_rows == 1 for chunk in legends)
    assert len({chunk.entity_path for chunk in legends}) == len(legends)


def test_each_case_is_shown_as_drawn_in_its_worst_frame(recorded: RunRecording) -> None:
    cases = failures(recorded)
    scans, poses = dict(recorded.rows(paths.SCAN)), dict(recorded.rows(paths.SENSOR))
    states = dict(recorded.rows("world/guess/cells"))
    assert len(cases) > 1
    for path, drawn in ((paths.SCAN, scans), (paths.SENSOR, poses), ("world/guess/cells", states)):
        shown = at_cases(recorded, path)
        assert sorted(shown) == list(range(1, len(cases) + 1))
        for case, row in zip(cases, shown.values(), strict=True):
            assert row.keys() == drawn[case.worst_frame].keys()
            for name, values in row.items():
                np.testing.assert_array_equal(values, drawn[case.worst_frame][name])


def test_the_box_of_a_case_contains_its_wrong_points(recorded: RunRecording) -> None:
    boxes, aims = at_cases(recorded, paths.CASE_BOX), at_cases(recorded, paths.CASE_AIM)
    drawn = {points.frame: points for points in recorded.drawn()}
    for number, case in enumerate(failures(recorded), 1):
        centre, half = (boxes[number][f"Boxes3D:{part}"][0] for part in ("centers", "half_sizes"))
        assert boxes[number]["Boxes3D:labels"][0] == f"{number} {DID[case.kind]} {case.what}"
        points = drawn[case.worst_frame]
        wrong = points.xyz[
            np.isin(points.outcome, (Outcome.FALSE_POSITIVE, Outcome.FALSE_NEGATIVE))
        ]
        assert (np.abs(wrong - centre) <= half + 1e-4).all(1).any()
        np.testing.assert_allclose(aims[number]["LineStrips3D:strips"][0][1], centre, atol=1e-5)


def test_the_text_says_what_happened_and_what_the_rays_say(recorded: RunRecording) -> None:
    texts, cases = at_cases(recorded, paths.CASE_TEXT), failures(recorded)
    for number, case in enumerate(cases, 1):
        said = text(texts[number])
        title = f"{DID[case.kind]} {case.what}, {case.cost:.2f} % of {case.metric}"
        assert said.startswith(f"#### {number} of {len(cases)}: {title}")
        assert case.sentence in said
        assert "**Evidence**" in said
        assert "**State**: the tab" in said


def test_hits_end_in_the_case_and_crossings_beyond(recorded: RunRecording) -> None:
    boxes, rays = at_cases(recorded, paths.CASE_BOX), at_cases(recorded, paths.CASE_RAYS)
    for number, row in rays.items():
        centre, half = (boxes[number][f"Boxes3D:{part}"][0] for part in ("centers", "half_sizes"))
        ends = np.array([strip[-1] for strip in row["LineStrips3D:strips"]])
        hits = row["LineStrips3D:class_ids"] == colours.HIT
        inside = (np.abs(ends - centre) <= half + 0.011).all(1)
        assert hits.any()
        assert inside[hits].all()


def test_objects_over_time_follow_from_the_result_and_the_ledgers(recorded: RunRecording) -> None:
    case = recorded.result.failures[0]
    (root,) = {
        path.rsplit("/", 1)[0]
        for path in recorded.entities()
        if path.startswith(f"{paths.OBJECTS}/moving_object_1")
    }
    spans = case.spans
    assert {"hit", "through"} & spans.keys()
    for name in LANES:
        at, found = {}, ""
        for frame, row in recorded.rows(f"{root}/{name}"):
            at[frame] = row["StateChange:state"][0]
        for frame in range(recorded.frames):
            found = at.get(frame, found)
            expected = [
                state for state, (first, last) in lane(spans, name) if first <= frame <= last
            ]
            assert [found] * bool(found) == expected


def test_each_frame_shows_its_costliest_case(recorded: RunRecording) -> None:
    shown = dict(recorded.rows(paths.CASE_BOX))
    cases = failures(recorded)
    for frame, row in shown.items():
        present = [
            n for n, case in enumerate(cases, 1) if case.first_frame <= frame <= case.last_frame
        ]
        assert int(row["Boxes3D:labels"][0].split()[0]) in present
    assert set(shown) == set(range(6))


def test_the_curves_of_cases_are_their_costs(recorded: RunRecording) -> None:
    for metric in ("SA", "DA"):
        costs = [
            row["Scalars:scalars"][0]
            for row in at_cases(recorded, f"{paths.CASE_COST}/{metric}").values()
        ]
        expected = [case.cost if case.metric == metric else np.nan for case in failures(recorded)]
        np.testing.assert_allclose(costs, expected)
        *_, last = at_cases(recorded, f"{paths.CASE_SCORE}/{metric}").values()
        assert last["Scalars:scalars"][0] == pytest.approx(100.0, abs=0.5)


def test_without_coordinates_there_are_texts_alone(tmp_path: Path) -> None:
    recording = RunRecording(record_with_metrics(room(3, 1500), tmp_path / "run.rrd", "scores"))
    assert len(at_cases(recording, paths.CASE_TEXT)) == len(failures(recording)) > 0
    assert not at_cases(recording, paths.CASE_BOX)


def test_without_ground_truth_nothing_is_called_right(tmp_path: Path) -> None:
    bare = InMemory([scan.without_truth() for scan in room(4, 1500).scans])
    recording = RunRecording(record_with_metrics(bare, tmp_path / "run.rrd"))
    removed = int(sum(answers.dynamic.sum() for answers in recording.answers()))
    assert f"{removed:,} of" in text(recording.static(paths.REMOVED_TEXT))
    assert "No ground truth" in text(recording.static(paths.REMOVED_TEXT))
    everything = text(recording.static(paths.FAILURE_LIST)) + text(recording.static(paths.REPORT))
    assert "wrong point" not in everything.lower()
    frames, values = recording.curve(f"{paths.REMOVED_POINTS}/removed")
    assert frames.tolist() == [0, 1, 2, 3]
    assert values.sum() == removed
    assert recording.result is not None
    sizes = [
        row["Scalars:scalars"][0]
        for row in at_cases(recording, f"{paths.CASE_COST}/points").values()
    ]
    assert sizes == [cluster.points for cluster in suspicious(recording.result)] != []


def test_recordings_open_at_the_first_case(recorded: RunRecording) -> None:
    with headless((1200, 800)) as client:
        shown = problems(recorded.path, client)
        opened = opened_at(client, (paths.CASE, 1))
    assert opened == (paths.CASE, 1)
    assert {"case", "frame", "what and why", "failures"} <= set(shown)
    assert {name: reports for name, reports in shown.items() if reports} == {}
    assert set(shown) >= {
        title(state) for state in Guess.info.emits if state.name not in ("remark", "count")
    }


def test_no_picture_of_an_earlier_case_remains(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(case_timeline, "PICTURES", 1)
    recording = RunRecording(record_with_metrics(room(), tmp_path / "run.rrd"))
    shown = at_cases(recording, "guess/ranges")
    assert "EncodedDepthImage:blob" in shown[1]
    assert shown[2].keys() == {"Clear:is_recursive"}
    assert list(shown) == [1, 2]
    assert len(at_cases(recording, "world/guess/cells")) == len(failures(recording)) > 2


def test_a_case_refers_to_pictures_where_nothing_else_shows_it() -> None:
    states = (
        State("hits", Voxels, "Voxels that were hit"),
        State("scan", RangeImage, "Nearest returns"),
    )
    both, voxels, none = (MethodInfo("m", "M", "", (), emits) for emits in (states, states[:1], ()))
    assert "the tab *hits* shows this place: Voxels that were hit." in see(both, "hits")
    assert "pictures of what the method saw" in see(both, None)
    assert "none was recorded here" in see(voxels, None)
    assert see(none, None) == ""
