"""The timeline of cases of a comparison."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from helpers.compared_recordings import pair

from dynaviz.contracts.scan import Label
from dynaviz.views import paths
from dynaviz.views.compare import compare_layout
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
