"""The timeline of cases of a comparison."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from helpers.compared_recordings import pair
from helpers.worlds import room

import dynaviz as dv
from dynaviz.contracts.scan import Label
from dynaviz.views import paths
from dynaviz.views.compare import compare_layout, compared_cases
from dynaviz.views.read.reader import RunRecording, read


def test_each_case_shows_where_only_one_run_is_wrong(
    runs: dict[str, Path], merged: dict[str, Path]
) -> None:
    recorded, recordings = (
        read(merged["two"]),
        [RunRecording(path) for path in pair(runs, "errors")],
    )
    drawn = [list(recording.drawn()) for recording in recordings]
    answers = [list(recording.answers()) for recording in recordings]
    boxes = dict(recorded.rows(compare_layout.CASE_BOX, paths.CASE))
    texts = dict(recorded.rows(compare_layout.CASE_TEXT, paths.CASE))
    assert list(boxes) == list(texts) == list(range(1, len(boxes) + 1))
    assert boxes
    costs = []
    for number, row in texts.items():
        text = row["TextDocument:text"][0]
        title = (
            rf"#### {number} of {len(boxes)}: only (.) (removed|kept) .*, ([\d.]+) % of (SA|DA)\n"
        )
        letter, did, cost, _ = re.match(title, text).groups()
        frame = int(re.search(r"\*\*Worst frame\*\*: (\d+) of", text)[1])
        wrong = "AB".index(letter)
        assert f"**{letter} wrong**" in text
        assert f"**{'BA'[wrong]} right**" in text
        points, mine, others = drawn[wrong][frame], answers[wrong][frame], answers[1 - wrong][frame]
        of_kind = mine.truth == (Label.STATIC if did == "removed" else Label.DYNAMIC)
        alone = of_kind & (mine.dynamic == (did == "removed")) & (others.dynamic != mine.dynamic)
        box = boxes[number]
        inside = np.abs(points.xyz - box["Boxes3D:centers"]) <= box["Boxes3D:half_sizes"] + 1e-3
        assert alone[points.point[inside.all(1)]].any()
        costs.append(float(cost))
    assert costs == sorted(costs, reverse=True)
    gains = [
        [
            row["Scalars:scalars"][0]
            for _, row in recorded.rows(f"{compare_layout.GAIN}/{side}", paths.CASE)
        ]
        for side in "ab"
    ]
    np.testing.assert_allclose(np.abs(gains).sum(0), costs, atol=0.005)
    for side in "ab":
        assert [number for number, _ in recorded.rows(f"{side}/{paths.SCAN}", paths.CASE)] == list(
            boxes
        )
    states = [path for path in recorded.entities() if f"/{compare_layout.CASE_STATES}/" in path]
    assert {path[0] for path in states} == {"a", "b"}


def test_a_comparison_without_coordinates_has_no_cases(merged: dict[str, Path]) -> None:
    assert not [path for path in read(merged["scores"]).entities() if "case" in path]


def test_an_object_keeps_its_name_number_and_behaviour(tmp_path: Path) -> None:
    """Two kept boxes that cross: each difference has the name of the case that it is of."""
    for name, miss in (("a", 0.45), ("b", 0.49)):
        dv.run("octomap", room(8, 3000), out=tmp_path / name, settings={"prob_miss": miss})
    recordings = tuple(RunRecording(tmp_path / name / "run.rrd") for name in "ab")
    found = compared_cases.find((recordings[0], recordings[1]))
    objects = [each for each in found if each.case.kind == "false_negative"]
    assert objects
    for each in objects:
        own = recordings[each.wrong].result
        assert own is not None
        (same,) = (case for case in own.failures if case.instance == each.case.instance)
        assert each.case.instance == 1
        assert each.case.behaviour == same.behaviour
        assert each.title.endswith(" 1")


def test_the_difference_is_drawn_at_its_case(merged: dict[str, Path]) -> None:
    recorded = read(merged["two"])
    boxes = dict(recorded.rows(compare_layout.CASE_BOX, paths.CASE))
    drawn = dict(recorded.rows(compare_layout.SCAN, paths.CASE))
    frames = dict(recorded.rows(compare_layout.SCAN))
    assert list(drawn) == list(boxes)
    for row in drawn.values():
        assert any(
            np.array_equal(row["Points3D:positions"], other["Points3D:positions"], equal_nan=True)
            for other in frames.values()
        )
