"""What the recording of a comparison contains."""

from __future__ import annotations

import json
import re
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.colour_vision import EYES, contrast, smallest_difference
from helpers.compared_recordings import dynamic_labels, odd_room, pair

import dynaviz as dv
from dynaviz.errors import DataError
from dynaviz.scores.comparison.counts import BOTH, FIRST, NEITHER, SECOND
from dynaviz.views import paths
from dynaviz.views.compare import compare_layout, merge
from dynaviz.views.compare.agreement import EVERYBODY, NOBODY
from dynaviz.views.read.reader import RunRecording, read

README = (Path(__file__).resolve().parents[2] / "recordings/README.md").read_text()


def test_entities_curves_and_properties(runs: dict[str, Path], merged: dict[str, Path]) -> None:
    recorded = read(merged["two"])
    comparison = dv.compare(*pair(runs, "errors"))
    assert (recorded.kind, recorded.frames) == ("comparison", 6)
    assert json.loads(recorded.properties["comparison_json"]) == json.loads(
        json.dumps(comparison.to_dict())
    )
    entities = set(recorded.entities())
    for side, path in zip("ab", pair(runs, "errors"), strict=True):
        original = RunRecording(path)
        assert {
            p.removeprefix(f"{side}/") for p in entities if p.startswith(f"{side}/world/scan")
        } == {paths.SCAN}
        for name in ("scores/SA/so_far", "scores/wrong_points/false_negatives"):
            np.testing.assert_array_equal(
                recorded.curve(f"{side}/{name}")[1], original.curve(name)[1]
            )
        assert recorded.static(f"__properties/{side}")["digest"][0] == original.properties["digest"]
        assert recorded.static(f"{side}/scores/SA/so_far")["SeriesLines:names"][0].startswith(
            side.upper() + " octomap"
        )
        assert "AnnotationContext:context" in {
            c.split(":", 1)[0] + ":context" for c in [str(x) for x in _components(recorded, side)]
        }
    gain = recorded.curve("compare/gain/a")[1] + recorded.curve("compare/gain/b")[1]
    found = comparison.pairs[0]
    assert found.scores.SA.delta is not None
    assert found.scores.DA.delta is not None
    assert gain.sum() == pytest.approx(found.scores.SA.delta + found.scores.DA.delta)
    assert sorted(recorded.curve("compare/changed_frames")[0]) == sorted(
        row.frame for row in found.frames
    )
    assert recorded.static("compare/report")["TextDocument:text"][0].startswith(
        "## A octomap resolution=0.15"
    )
    assert len(recorded.static("compare/places")["Boxes3D:half_sizes"]) == 10
    assert not any("answers" in path or "octomap" in path for path in entities)
    with pytest.raises(DataError, match="contains a comparison, not a run"):
        RunRecording(merged["two"])


def _components(recorded: Any, side: str) -> list[str]:
    return [
        name
        for chunk in recorded.store.stream().filter(content=f"/{side}", is_static=True)
        for name in chunk.to_record_batch().schema.names
    ]


@pytest.mark.parametrize("mode", ["two", "full"])
def test_points_are_coloured_by_agreement(
    runs: dict[str, Path], merged: dict[str, Path], mode: str
) -> None:
    first = dynamic_labels(runs["errors/fine"])
    second = dynamic_labels(runs["errors/coarse"])
    compared = read(merged[mode])
    rows, right_of = dict(compared.rows(compare_layout.SCAN)), agreement_of_ids(compared)
    for frame, scan in enumerate(odd_room().scans):
        assert scan.labels is not None
        xyz = rows[frame]["Points3D:positions"]
        classes = np.array(
            [right_of[number] for number in rows[frame]["Points3D:class_ids"].tolist()]
        )
        right = (first[frame] == scan.labels) + 2 * (second[frame] == scan.labels)
        labelled = scan.labels != 255
        by_place: dict[Any, set[int]] = {}
        for point, code in zip(scan.points[labelled], right[labelled], strict=True):
            by_place.setdefault(point.tobytes(), set()).add(int(code))
        assert all(
            int(code) in by_place[point.tobytes()] for point, code in zip(xyz, classes, strict=True)
        )
        dynamic = labelled & (scan.labels == 1)
        expected = Counter(right[labelled if mode == "full" else dynamic].tolist())
        drawn = Counter(classes.tolist())
        assert all(drawn[code] >= n for code, n in expected.items())
        if mode == "full":
            assert len(classes) == labelled.sum()


def legend_of(compared: Any) -> dict[int, tuple[str, int]]:
    """Label and colour of each class id of a comparison."""
    return {
        entry["class_id"]: (
            entry["class_description"]["info"]["label"],
            entry["class_description"]["info"]["color"],
        )
        for entry in compared.static(compare_layout.COMPARE)["AnnotationContext:context"][0]
    }


def agreement_of_ids(compared: Any) -> dict[int, int]:
    """Agreement by class id: ids share the colour of their agreement, which is an id itself."""
    legend = legend_of(compared)
    by_colour = {legend[right][1]: right for right in range(BOTH + 1)}
    return {number: by_colour[colour] for number, (_, colour) in legend.items()}


def test_points_are_labelled_with_both_answers(
    runs: dict[str, Path], merged: dict[str, Path]
) -> None:
    compared = read(merged["two"])
    drawn = {
        int(number)
        for _, row in compared.rows(compare_layout.SCAN)
        for number in row["Points3D:class_ids"]
    }
    legend, right = legend_of(compared), agreement_of_ids(compared)
    assert drawn <= set(legend)
    for number in drawn:
        first, second = legend[number][0].split("\n")
        assert re.match(r"A (ghost|hole|kept|removed): [a-z ]+$", first)
        assert re.match(r"B (ghost|hole|kept|removed): [a-z ]+$", second)
        assert bool(right[number] & FIRST) == ("ghost" not in first and "hole" not in first)
        assert bool(right[number] & SECOND) == ("ghost" not in second and "hole" not in second)


@pytest.mark.parametrize("eye", EYES)
def test_colours_differ_to_every_eye(eye: str) -> None:
    on_dark = [merge.RUNS[0], merge.RUNS[1], NOBODY, EVERYBODY, merge.DARK]
    assert smallest_difference(on_dark, eye) > 18
    assert (
        min(
            contrast(run, page, eye)
            for run in merge.RUNS
            for page in ((255, 255, 255), (16, 18, 20))
        )
        > 2.5
    )
    assert (NEITHER, BOTH) == (0, 3)  # the order of the sizes and of the legend


def test_facts_of_a_comparison(merged: dict[str, Path]) -> None:
    facts = read(merged["many"]).facts()
    assert facts["C"].startswith("octomap")
    assert facts["frames"] == "6"


def test_the_page_lists_every_entity_and_property(merged: dict[str, Path]) -> None:
    page = re.sub("```.*?```", "", README[README.index("## Comparing runs") :], flags=re.DOTALL)
    listed = set(re.findall(r"`([^`]+)`", page))
    for name in (
        "COMPARE",
        "GROUND",
        "SCAN",
        "WHERE",
        "PLACES",
        "GAIN",
        "CHANGED",
        "DISTANCE",
        "REPORT",
    ):
        assert any(getattr(compare_layout, name) in words for words in listed), name
    assert set(read(merged["two"]).properties) <= listed
