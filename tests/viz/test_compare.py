"""Comparing recordings: against raw labels, refusals, and what the merged recording holds."""

from __future__ import annotations

import itertools
import json
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from helpers.guessing_method import record, settled
from helpers.worlds import InMemory, room
from test_drawing import EYES, lab, linear

import dynaviz as dv
from dynaviz.comparison.counts import BOTH, NEITHER
from dynaviz.comparison.summary import Comparison, differences, names, runtimes
from dynaviz.errors import DataError, MissingDependency, UsageError
from dynaviz.results.result import Result
from dynaviz.scan import Scan
from dynaviz.viz import compare_layout, merge, paths, viewer
from dynaviz.viz.reader import RunRecording, read
from dynaviz.viz.shot import push, shot

MODES = ("full", "errors", "scores")
README = (Path(__file__).resolve().parents[2] / "recordings/README.md").read_text()


def world() -> InMemory:
    """The room, some of it unlabelled, some of it not finite, and one scan empty."""
    scans = list(room(6, 2500).scans)
    for i, scan in enumerate(scans):
        labels, points = scan.labels.copy(), scan.points.copy()  # type: ignore[union-attr]
        labels[:: 5 + i] = 255
        points[7::40] = np.nan
        scans[i] = replace(scan, labels=labels, points=points)
    empty = np.empty((0, 3), np.float32)
    scans[2] = replace(scans[2], points=empty, labels=np.empty(0, np.uint8), instances=None)
    return InMemory(scans, "room")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Folders of a coarse and a fine run in each mode."""
    folder, sequence = tmp_path_factory.mktemp("runs"), world()
    for mode, (name, size) in itertools.product(MODES, (("fine", 0.15), ("coarse", 0.6))):
        dv.run("octomap", sequence, out=folder / mode / name, record=mode, settings=(f"resolution={size}",), threads=1)  # type: ignore[arg-type]
    return {f"{mode}/{name}": folder / mode / name for mode in MODES for name in ("fine", "coarse")}


def pair(runs: dict[str, Path], mode: str, other: str | None = None) -> tuple[Path, Path]:
    return runs[f"{mode}/fine"] / "run.rrd", runs[f"{other or mode}/coarse"] / "run.rrd"


def labels(folder: Path) -> list[np.ndarray]:
    with np.load(folder / "labels.npz") as z:
        dynamic = np.unpackbits(z["dynamic"])[: z["points"].sum()].astype(bool)
        return np.split(dynamic, np.cumsum(z["points"])[:-1])


@pytest.mark.parametrize(("mode", "other"), [(m, None) for m in MODES] + [("full", "errors"), ("errors", "scores")])
def test_against_raw_labels(runs: dict[str, Path], mode: str, other: str | None) -> None:
    comparison = dv.compare(*pair(runs, mode, other))
    found = comparison.pairs[0]
    right, wrong = Counter[Any](), dict[Any, list[int]]()
    for scan, a, b in zip(world().scans, labels(runs[f"{mode}/fine"]), labels(runs[f"{mode}/coarse"]), strict=True):
        assert scan.labels is not None
        for truth, first, second, xyz in zip(scan.labels, a == scan.labels, b == scan.labels, scan.points, strict=True):
            if truth == 255:
                continue
            who = ("both" if first else "only_second") if second else ("only_first" if first else "neither")
            right["static" if truth == 0 else "dynamic", who] += 1
            if np.isfinite(xyz).all():
                row = wrong.setdefault(tuple(np.floor(xyz[:2] / 5) * 5), [0, 0, 0, 0])
                row[truth] += not first
                row[2 + truth] += not second
    assert right == +Counter({(t, w): n for t, row in found["right"].items() for w, n in row.items()})
    assert found["right"]["dynamic"]["only_first"] > 0
    results = [Result.load(runs[f"{mode}/{name}"] / "result.json") for name in ("fine", "coarse")]
    for name in ("SA", "DA", "AA", "HA"):
        a, b = (result.metrics[name] for result in results)
        assert a is not None
        assert b is not None
        assert found["scores"][name]["delta"] == pytest.approx(b - a, abs=1e-9)
        assert comparison.runs[1]["scores"][name] == pytest.approx(b)
    if "scores" in (mode, other):
        assert found["places"] is None
        assert "holds no coordinates" in found["places_note"]
        return
    assert len(found["places"]) == 10
    for place in found["places"]:
        assert [place[s][n] for s in ("first", "second") for n in ("FP", "FN")] == wrong[tuple(place["low"])]


def test_all_modes_say_the_same(runs: dict[str, Path]) -> None:
    full, errors, scores = (dv.compare(*pair(runs, mode)).pairs[0] for mode in MODES)
    for key in ("scores", "right", "by_range", "by_reason", "frames"):
        assert full[key] == errors[key] == scores[key]
    for a, b in zip(full["places"], errors["places"], strict=True):
        assert a.pop("height") == pytest.approx(b.pop("height"), abs=0.2)
        assert a == b


def test_settings_that_differ_and_names(runs: dict[str, Path]) -> None:
    comparison = dv.compare(*pair(runs, "errors"))
    assert comparison.pairs[0]["differ"] == [{"name": "resolution", "first": 0.15, "second": 0.6}]
    assert [run["name"] for run in comparison.runs] == ["octomap resolution=0.15", "octomap resolution=0.6"]
    assert comparison.title == "A octomap resolution=0.15 | B octomap resolution=0.6 on room"
    told = str(comparison)
    assert all(word in told for word in ("only A", "crossed_by_rays", "95 % interval", "30-50 m", "resolution"))
    again = dv.compare(*pair(runs, "errors")[:1] * 2)
    assert [run["name"] for run in again.runs] == ["octomap fine"] * 2
    assert "are even" in again.verdicts()[0]


BASE = Result("octomap", {"resolution": 0.1}, {"name": "s"}, runtime={"mean_s": 0.2, "threads": 2})


@pytest.mark.parametrize(
    ("change", "ratio", "note"),
    [
        ({}, 1.0, ""),
        ({"runtime": {"mean_s": 0.5, "threads": 2}}, 2.5, ""),
        ({"runtime": {"mean_s": 0.4, "threads": 1}}, 2.0, "threads differ: 2, 1"),
        ({"environment": {"machine": {"arch": "arm64", "cores": 4}}}, 1.0, "machines differ: , arm64 4"),
        ({"instrumented": True}, None, "no ratio of runtimes: only dufomap's states were recorded"),
        ({"runtime": {}}, None, "one was not measured"),
        ({"sections": {"source": {}}}, None, "was read from a file"),
    ],
)
def test_runtimes(change: dict[str, Any], ratio: float | None, note: str) -> None:
    found = runtimes(BASE, replace(BASE, **{"method": "dufomap", **change}))
    assert found["ratio"] == (None if ratio is None else pytest.approx(ratio))
    assert note in ". ".join(found["notes"])
    assert bool(found["notes"]) == bool(note)


def test_runtimes_that_were_both_watched() -> None:
    watched = replace(BASE, instrumented=True)
    assert runtimes(watched, watched)["notes"] == ["both while their states were recorded"]


def test_all_kinds_of_settings() -> None:
    other = replace(
        BASE, method="dufomap", parameters={"d": 1}, online=True, seed=4, scoring="nn", command="run --preset av2 x"
    )
    found = {row["name"]: (row["first"], row["second"]) for row in differences(BASE, other)}
    assert found == {
        "method": ("octomap", "dufomap"), "scoring": ("mask", "nn"), "preset": (None, "av2"), "online": (False, True),
        "seed": (0, 4), "resolution": (0.1, None), "d": (None, 1),
    }  # fmt: skip
    assert names([BASE, other], [Path("a.rrd"), Path("b.rrd")]) == ["octomap", "dufomap"]
    assert names([BASE, replace(BASE, seed=1)], [Path(), Path()]) == ["octomap seed=0", "octomap seed=1"]


@pytest.fixture(scope="module")
def merged(runs: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Merged recordings of two and three runs; bad data is an error, not a warning."""
    rr.set_strict_mode(True)
    folder = tmp_path_factory.mktemp("merged")
    made = {"two": pair(runs, "errors"), "scores": pair(runs, "scores"), "full": pair(runs, "full", "errors"),
            "many": (*pair(runs, "errors"), pair(runs, "full")[0])}  # fmt: skip
    for name, recordings in made.items():
        dv.compare(*recordings, out=folder / f"{name}.rrd")
    return {name: folder / f"{name}.rrd" for name in made}


def test_the_merged_recording(runs: dict[str, Path], merged: dict[str, Path]) -> None:
    recorded = read(merged["two"])
    comparison = dv.compare(*pair(runs, "errors"))
    assert (recorded.kind, recorded.frames) == ("comparison", 6)
    assert json.loads(recorded.properties["comparison_json"]) == json.loads(json.dumps(comparison.to_dict()))
    entities = set(recorded.entities())
    for side, path in zip("ab", pair(runs, "errors"), strict=True):
        original = RunRecording(path)
        assert {p.removeprefix(f"{side}/") for p in entities if p.startswith(f"{side}/world/scan")} == {paths.SCAN}
        for name in ("scores/SA/so_far", "scores/wrong_points/false_negatives"):
            np.testing.assert_array_equal(recorded.curve(f"{side}/{name}")[1], original.curve(name)[1])
        assert recorded.static(f"__properties/{side}")["digest"][0] == original.properties["digest"]
        assert recorded.static(f"{side}/scores/SA/so_far")["SeriesLines:names"][0].startswith(side.upper() + " octomap")
        assert "AnnotationContext:context" in {
            c.split(":", 1)[0] + ":context" for c in [str(x) for x in _components(recorded, side)]
        }
    gain = recorded.curve("compare/gain/a")[1] + recorded.curve("compare/gain/b")[1]
    scores = comparison.pairs[0]["scores"]
    assert gain.sum() == pytest.approx(scores["SA"]["delta"] + scores["DA"]["delta"])
    assert sorted(recorded.curve("compare/changed_frames")[0]) == sorted(
        f["frame"] for f in comparison.pairs[0]["frames"]
    )
    assert recorded.static("compare/report")["TextDocument:text"][0].startswith("## A octomap resolution=0.15")
    assert len(recorded.static("compare/places")["Boxes3D:half_sizes"]) == 10
    assert not any("answers" in path or "octomap" in path for path in entities)
    with pytest.raises(DataError, match="holds a comparison of runs, not a run"):
        RunRecording(merged["two"])


def _components(recorded: Any, side: str) -> list[str]:
    return [
        name
        for chunk in recorded.store.stream().filter(content=f"/{side}", is_static=True)
        for name in chunk.to_record_batch().schema.names
    ]


@pytest.mark.parametrize("mode", ["two", "full"])
def test_points_are_coloured_by_who_is_right(runs: dict[str, Path], merged: dict[str, Path], mode: str) -> None:
    first = labels(runs["errors/fine"])
    second = labels(runs["errors/coarse"])
    recorded = read(merged[mode])
    rows = dict(recorded.rows(compare_layout.SCAN))
    for frame, scan in enumerate(world().scans):
        assert scan.labels is not None
        xyz, classes = rows[frame]["Points3D:positions"], rows[frame]["Points3D:class_ids"]
        who = (first[frame] == scan.labels) + 2 * (second[frame] == scan.labels)
        labelled = scan.labels != 255
        by_place: dict[Any, set[int]] = {}
        for point, code in zip(scan.points[labelled], who[labelled], strict=True):
            by_place.setdefault(point.tobytes(), set()).add(int(code))
        assert all(int(code) in by_place[point.tobytes()] for point, code in zip(xyz, classes, strict=True))
        moving = labelled & (scan.labels == 1)
        drawn = labelled if mode == "full" else moving
        told = Counter(classes.tolist())
        assert all(told[code] >= n for code, n in Counter(who[drawn].tolist()).items())
        if mode == "full":
            assert len(classes) == labelled.sum()


def test_info_and_pictures_of_a_comparison(merged: dict[str, Path], tmp_path: Path) -> None:
    facts = read(merged["many"]).facts()
    assert facts["C"].startswith("octomap")
    assert facts["frames"] == "6"
    try:
        made = shot(merged["two"], tmp_path / "x.png", frames=(1, 3), view="A octomap resolution=0.15", size=(500, 300))
    except MissingDependency as missing:
        pytest.skip(str(missing))
    assert len(made) == 2


def test_the_viewer_has_no_complaint(merged: dict[str, Path]) -> None:
    views = {
        "two": {"A octomap resolution=0.15", "B octomap resolution=0.6", "whole run: green A is better, purple B",
                "right in this frame: green A, purple B, white none", "report", "SA [%]: A green, B purple"},
        "many": {"A octomap: whole run", "SA [%]: A green, B purple, C yellow", "report"},
        "scores": {"report", "kept: m to removed", "removed: m to kept"},
    }  # fmt: skip
    for name, expected in views.items():
        try:
            with viewer.headless((1600, 900)) as client:
                push(merged[name], client)
                shown = settled(client)
        except MissingDependency as missing:
            pytest.skip(str(missing))
        assert {n: reports for n, reports in shown.items() if reports} == {}
        if name == "many":
            assert len([n for n in shown if n and n.endswith("whole run")]) == 3
        else:
            assert expected <= set(shown)


@pytest.mark.parametrize("eye", EYES)
def test_colours_differ_to_every_eye(eye: str) -> None:
    colours = [merge.RUNS[0], merge.RUNS[1], merge.NOBODY, merge.EVERYBODY, merge.DARK]
    seen = [lab(np.array(EYES[eye]) @ linear(colour)) for colour in colours]
    assert min(np.linalg.norm(a - b) for a, b in itertools.combinations(seen, 2)) > 18
    assert (NEITHER, BOTH) == (0, 3)  # as the sizes and the legend are ordered


def test_more_than_two(runs: dict[str, Path]) -> None:
    a, b = pair(runs, "errors")
    three = dv.compare(a, b, a)
    assert [(p["first"], p["second"]) for p in three.pairs] == [("A", "B"), ("A", "C")]
    assert three.pairs[0]["scores"] == dv.compare(a, b).pairs[0]["scores"]
    assert three.pairs[1]["scores"]["AA"]["delta"] == 0
    assert three.runs[2]["scores"] == three.runs[0]["scores"] != three.runs[1]["scores"]
    assert "C octomap" in three.markdown()


def changed(path: Path, change: Any, **what: Any) -> Path:
    return record(InMemory([change(scan) for scan in room(3, 300).scans]), path, **what)


def test_without_dynamic_points(tmp_path: Path) -> None:
    def still(scan: Scan) -> Scan:
        return replace(scan, labels=np.zeros(len(scan), np.uint8))

    a, b = (changed(tmp_path / f"{name}.rrd", still, mode=mode) for name, mode in (("a", "errors"), ("b", "full")))
    comparison = dv.compare(a, b, out=tmp_path / "compare.rrd")
    scores = comparison.pairs[0]["scores"]
    assert scores["AA"] == {"first": None, "second": None, "delta": None, "interval": None}
    assert scores["SA"]["delta"] == 0
    assert "n/a" in str(comparison)
    assert read(tmp_path / "compare.rrd").frames == 3
    comparison.save(tmp_path / "compare.json")
    with pytest.raises(UsageError, match="AA is undefined"):
        comparison.fallen(0.0)


def test_refusals(runs: dict[str, Path], merged: dict[str, Path], tmp_path: Path) -> None:
    a, b = pair(runs, "errors")
    other = record(room(4, 300), tmp_path / "other.rrd")
    blind = record(room(4, 300, labelled=False), tmp_path / "blind.rrd")
    void = changed(tmp_path / "void.rrd", lambda scan: replace(scan, labels=np.full(len(scan), 255, np.uint8)))
    cut = tmp_path / "cut.rrd"
    cut.write_bytes(a.read_bytes()[:-900])

    class Torn(InMemory):
        reads = 0

        def __getitem__(self, position: int) -> Scan:
            self.reads += 1
            if self.reads == 4 + 2 * len(self):
                raise RuntimeError("torn")
            return super().__getitem__(position)

    with pytest.raises(RuntimeError, match="torn"):
        record(Torn(room(6, 300).scans), tmp_path / "torn.rrd", command="dynaviz run guess room")
    torn = tmp_path / ".torn.rrd.part"
    refused: list[tuple[tuple[Path, ...], type[Exception], str]] = [
        ((a,), UsageError, r"1 recording\(s\) given: compare takes 2 to 8"),
        ((), UsageError, r"0 recording\(s\) given"),
        ((a,) * 9, UsageError, r"9 recording\(s\) given"),
        ((a, other), DataError, r"other\.rrd: is of other points than .*room, 4 frames, digest .* instead of"),
        ((a, torn), DataError, r"torn.*was not finished\. Run it again with: dynaviz run guess room"),
        ((torn, a), DataError, r"torn.*was not finished"),
        ((cut, a), DataError, r"cut\.rrd: was cut off.*dynaviz repair"),
        ((blind, blind), DataError, r"blind\.rrd: has no ground truth"),
        ((void, void), DataError, r"void\.rrd: has no labelled point"),
        ((a, merged["two"]), DataError, r"two\.rrd: holds a comparison of runs, not a run"),
        ((a, tmp_path / "absent.rrd"), DataError, r"absent\.rrd: No such file"),
    ]
    for recordings, kind, text in refused:
        with pytest.raises(kind, match=text) as caught:
            dv.compare(*recordings, out=tmp_path / "compare.rrd")
        assert "\n" not in str(caught.value)
    with pytest.raises(UsageError, match="is one of the recordings to compare"):
        dv.compare(a, b, out=a.parent / "../fine/run.rrd")
    (tmp_path / "file").touch()
    with pytest.raises(DataError, match="cannot be written"):
        dv.compare(a, b, out=tmp_path / "file/compare.rrd")
    assert not (tmp_path / "compare.rrd").exists()
    assert not list(tmp_path.glob(".compare*"))


def test_nothing_half_written_is_left(runs: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*what: Any) -> None:
        raise RuntimeError("interrupted")

    monkeypatch.setattr(merge, "_distances", fail)
    with pytest.raises(RuntimeError, match="interrupted"):
        dv.compare(*pair(runs, "errors"), out=tmp_path / "compare.rrd")
    assert list(tmp_path.iterdir()) == []


def test_the_page_names_every_entity_and_property(merged: dict[str, Path]) -> None:
    page = re.sub("```.*?```", "", README[README.index("## Comparing runs") :], flags=re.DOTALL)
    told = set(re.findall(r"`([^`]+)`", page))
    for name in ("COMPARE", "GROUND", "SCAN", "WHERE", "PLACES", "GAIN", "CHANGED", "DISTANCE", "REPORT"):
        assert any(getattr(compare_layout, name) in words for words in told), name
    assert set(read(merged["two"]).properties) <= told


def test_json(runs: dict[str, Path], tmp_path: Path) -> None:
    comparison: Comparison = dv.compare(*pair(runs, "errors"))
    comparison.save(tmp_path / "c.json")
    plain = json.loads((tmp_path / "c.json").read_text())
    assert (plain["schema"], plain["kind"]) == (1, "comparison")
    assert set(plain) == {"schema", "kind", "sequence", "interval", "verdicts", "runs", "pairs"}
    assert plain["interval"]["block"] == 2
    assert {"letter", "name", "path", "sha256", "method", "parameters", "scores", "runtime"} <= set(plain["runs"][0])
    told = {"first", "second", "scores", "right", "by_range", "by_reason", "frames", "places", "places_note"}
    assert set(plain["pairs"][0]) == told | {"differ", "runtime"}
    assert plain["pairs"][0]["scores"]["FP"].keys() == {"first", "second", "delta", "interval"}
