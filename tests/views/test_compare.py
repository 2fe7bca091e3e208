"""Comparing recordings: against raw labels, in all modes, and inputs that are refused."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.compared_recordings import MODES, dynamic_labels, odd_room, pair
from helpers.guessing_method import record
from helpers.worlds import InMemory, room

import dynaviz as dv
from dynaviz.contracts.scan import Scan
from dynaviz.errors import DataError, UsageError
from dynaviz.scores.comparison.pair import ScoreChange
from dynaviz.scores.comparison.settings import SettingChange
from dynaviz.scores.result import Result
from dynaviz.views.compare import merge
from dynaviz.views.read.reader import read

KINDS = [
    (truth, who)
    for truth in ("static", "dynamic")
    for who in ("neither", "only_first", "only_second", "both")
]


@pytest.mark.parametrize(
    ("mode", "other"), [(m, None) for m in MODES] + [("full", "errors"), ("errors", "scores")]
)
def test_against_raw_labels(runs: dict[str, Path], mode: str, other: str | None) -> None:
    comparison = dv.compare(*pair(runs, mode, other))
    found = comparison.pairs[0]
    right, wrong = Counter[Any](), dict[Any, list[int]]()
    raw = [dynamic_labels(runs[f"{mode}/{name}"]) for name in ("fine", "coarse")]
    for scan, a, b in zip(odd_room().scans, *raw, strict=True):
        assert scan.labels is not None
        for truth, first, second, xyz in zip(
            scan.labels, a == scan.labels, b == scan.labels, scan.points, strict=True
        ):
            if truth == 255:
                continue
            right[KINDS[4 * truth + first + 2 * second]] += 1
            if np.isfinite(xyz).all():
                row = wrong.setdefault(tuple(np.floor(xyz[:2] / 5) * 5), [0, 0, 0, 0])
                row[truth] += not first
                row[2 + truth] += not second
    assert right == +Counter(
        {(truth, who): getattr(getattr(found.right, truth), who) for truth, who in KINDS}
    )
    assert found.right.dynamic.only_first > 0
    results = [Result.load(runs[f"{mode}/{name}"] / "result.json") for name in ("fine", "coarse")]
    for name, score in found.scores.items():
        if name in results[0].metrics:
            a, b = (result.metrics[name] for result in results)
            assert a is not None
            assert b is not None
            assert score.delta == pytest.approx(b - a, abs=1e-9)
            assert getattr(comparison.runs[1].scores, name) == pytest.approx(b)
    if "scores" in (mode, other):
        assert found.places is None
        assert "contains no coordinates" in found.places_note
        return
    assert found.places is not None
    assert len(found.places) == 10
    for place in found.places:
        assert [n for side in (place.first, place.second) for n in (side.FP, side.FN)] == wrong[
            place.low
        ]


def test_all_modes_give_the_same_comparison(runs: dict[str, Path]) -> None:
    full, errors, scores = (dv.compare(*pair(runs, mode)).pairs[0] for mode in MODES)
    for key in ("scores", "right", "by_range", "by_reason", "frames"):
        assert getattr(full, key) == getattr(errors, key) == getattr(scores, key)
    assert full.places is not None
    assert errors.places is not None
    for a, b in zip(full.places, errors.places, strict=True):
        assert a.height == pytest.approx(b.height, abs=0.2)
        assert replace(a, height=0.0) == replace(b, height=0.0)


def test_names_and_tables(runs: dict[str, Path]) -> None:
    comparison = dv.compare(*pair(runs, "errors"))
    assert comparison.pairs[0].differ == (SettingChange("resolution", 0.15, 0.6),)
    assert [run.name for run in comparison.runs] == [
        "octomap resolution=0.15",
        "octomap resolution=0.6",
    ]
    assert comparison.title == "A octomap resolution=0.15 | B octomap resolution=0.6 on room"
    shown = str(comparison)
    assert all(
        word in shown
        for word in ("only A", "crossed_by_rays", "over movers", "30-50 m", "resolution")
    )
    again = dv.compare(*pair(runs, "errors")[:1] * 2)
    assert [run.name for run in again.runs] == ["octomap fine"] * 2
    assert "are even" in again.verdicts()[0]


def test_more_than_two(runs: dict[str, Path]) -> None:
    a, b = pair(runs, "errors")
    three = dv.compare(a, b, a)
    assert [(p.first, p.second) for p in three.pairs] == [("A", "B"), ("A", "C")]
    assert three.pairs[0].scores == dv.compare(a, b).pairs[0].scores
    assert three.pairs[1].scores.AA.delta == 0
    assert three.runs[2].scores == three.runs[0].scores != three.runs[1].scores
    assert "C octomap" in three.markdown()


def changed(path: Path, change: Any, **options: Any) -> Path:
    return record(InMemory([change(scan) for scan in room(3, 300).scans]), path, **options)


def test_without_dynamic_points(tmp_path: Path) -> None:
    def static(scan: Scan) -> Scan:
        return replace(scan, labels=np.zeros(len(scan), np.uint8))

    a, b = (
        changed(tmp_path / f"{name}.rrd", static, mode=mode)
        for name, mode in (("a", "errors"), ("b", "full"))
    )
    comparison = dv.compare(a, b, out=tmp_path / "compare.rrd")
    scores = comparison.pairs[0].scores
    assert ScoreChange(None, None, None, None) == scores.AA
    assert scores.SA.delta == 0
    assert "n/a" in str(comparison)
    assert read(tmp_path / "compare.rrd").frames == 3
    comparison.save(tmp_path / "compare.json")
    with pytest.raises(UsageError, match="AA is undefined"):
        comparison.drops_below(0.0)


def test_refusals(runs: dict[str, Path], merged: dict[str, Path], tmp_path: Path) -> None:
    a, b = pair(runs, "errors")
    other = record(room(4, 300), tmp_path / "other.rrd")
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
        (
            (a, other),
            DataError,
            r"other\.rrd: is from a different sequence than .*room, 4 frames.* instead of",
        ),
        (
            (a, torn),
            DataError,
            r"torn.*contains an unfinished run\. Run it again with: dynaviz run guess room",
        ),
        ((torn, a), DataError, r"torn.*contains an unfinished run"),
        ((cut, a), DataError, r"cut\.rrd: is incomplete.*dynaviz info"),
        ((a, merged["two"]), DataError, r"two\.rrd: contains a comparison, not a run"),
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


def test_runs_without_ground_truth_are_compared_by_what_they_removed(tmp_path: Path) -> None:
    blind = record(room(4, 300, labelled=False), tmp_path / "blind.rrd")
    void = changed(
        tmp_path / "void.rrd", lambda scan: replace(scan, labels=np.full(len(scan), 255, np.uint8))
    )
    for recording in (blind, void):
        comparison = dv.compare(recording, recording, out=tmp_path / "compare.rrd")
        assert (tmp_path / "compare.rrd").is_file()
        assert comparison.verdicts()[0].startswith("There is no ground truth")
        removed = comparison.pairs[0].removed
        assert removed is not None
        assert removed.points.both > 0
        assert removed.points.only_first == removed.points.only_second == 0
        with pytest.raises(UsageError, match="AA is undefined"):
            comparison.drops_below(0.0)


def test_an_interrupted_comparison_leaves_no_file(
    runs: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*what: Any) -> None:
        raise RuntimeError("interrupted")

    monkeypatch.setattr(merge, "_write_distances", fail)
    with pytest.raises(RuntimeError, match="interrupted"):
        dv.compare(*pair(runs, "errors"), out=tmp_path / "compare.rrd")
    assert list(tmp_path.iterdir()) == []


def test_json(runs: dict[str, Path], tmp_path: Path) -> None:
    comparison = dv.compare(*pair(runs, "errors"))
    comparison.save(tmp_path / "c.json")
    plain = json.loads((tmp_path / "c.json").read_text())
    assert (plain["schema"], plain["kind"]) == (1, "comparison")
    assert list(plain) == ["schema", "kind", "sequence", "interval", "verdicts", "runs", "pairs"]
    assert list(plain["sequence"]) == ["name", "digest", "frames", "points", "at_sensor"]
    assert plain["interval"]["block"] == 2
    assert list(plain["runs"][0]) == [
        "letter", "name", "path", "sha256", "method", "title", "mode", "scoring", "online", "seed",
        "parameters",
        "scores", "runtime", "instrumented", "command", "ceiling",
    ]  # fmt: skip
    first = plain["pairs"][0]
    assert list(first) == [
        "first", "second", "scores", "right", "by_range", "by_reason", "frames", "places",
        "places_note", "differ",
        "runtime", "removed", "over_movers", "objects", "surfaces",
    ]  # fmt: skip
    assert list(first["scores"]) == ["SA", "DA", "AA", "HA", "FP", "FN"]
    assert list(first["scores"]["FP"]) == ["first", "second", "delta", "interval"]
    assert list(first["right"]["static"]) == ["neither", "only_first", "only_second", "both"]
    assert list(first["by_range"][0]) == ["band", "static", "dynamic"]
    assert list(first["by_reason"][0]) == [
        "truth",
        "right",
        "first_reason",
        "second_reason",
        "points",
    ]
    assert list(first["frames"][0]) == [
        "frame",
        "index",
        "gain",
        "gain_SA",
        "gain_DA",
        "first",
        "second",
    ]
    place = ["low", "high", "height", "frame", "gain", "gain_SA", "gain_DA", "first", "second"]
    assert list(first["places"][0]) == place
    assert list(first["places"][0]["first"]) == ["FP", "FN"]
    assert list(first["differ"][0]) == ["name", "first", "second"]
    assert list(first["runtime"]) == ["ratio", "first_s", "second_s", "notes"]
