"""Files written by an earlier version.

Two results, their recordings and their comparison stay readable.
"""

from __future__ import annotations

import gzip
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.worlds import room

import dynaviz as dv
from dynaviz.contracts.scan import Outcome
from dynaviz.errors import UsageError
from dynaviz.runs.run import open_run
from dynaviz.scores.collect import collect
from dynaviz.scores.result import Result
from dynaviz.sources.datasets.convert import convert
from dynaviz.views.read.reader import RunRecording

DATA = Path(__file__).resolve().parents[1] / "data/previous"
RUNS = ("fine", "coarse")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files as they were written, recordings unpacked."""
    folder = tmp_path_factory.mktemp("previous")
    for name in RUNS:
        (folder / name).mkdir()
        shutil.copy(DATA / name / "result.json", folder / name)
        (folder / name / "run.rrd").write_bytes(
            gzip.decompress((DATA / name / "run.rrd.gz").read_bytes())
        )
    return folder


def unchanged(old: Any, new: Any) -> bool:
    """Whether two JSON values are equal, except for added keys without a value."""
    if isinstance(old, dict) and isinstance(new, dict):
        added = new.keys() - old.keys()
        return (
            old.keys() <= new.keys()
            and all(new[key] is None or new[key] == {} for key in added)
            and all(unchanged(value, new[key]) for key, value in old.items())
        )
    if isinstance(old, list) and isinstance(new, list):
        return len(old) == len(new) and all(map(unchanged, old, new))
    return bool(old == new)


@pytest.mark.parametrize("name", RUNS)
def test_results_load_and_are_written_unchanged(files: Path, name: str) -> None:
    path = files / name / "result.json"
    result = Result.load(path)
    plain, old = json.loads(json.dumps(result.to_dict())), json.loads(path.read_text())
    added = {"preset", "parameter_origins", "pose_findings"}
    assert unchanged(old, {key: value for key, value in plain.items() if key not in added})
    assert "octomap" in str(result)
    assert f"{old['metrics']['SA']:.2f}" in str(result)
    assert result.failures[0].points == old["failures"]["cases"][0]["points"]


@pytest.mark.parametrize("name", RUNS)
def test_recordings_contain_the_labels_and_the_result(files: Path, name: str) -> None:
    recording = RunRecording(files / name / "run.rrd")
    result = Result.load(files / name / "result.json")
    assert recording.complete
    assert recording.result is not None
    assert recording.result.sections == result.sections
    scans, found = room(3, 300).scans, np.zeros(len(Outcome), np.int64)
    for answers, drawn, scan in zip(recording.answers(), recording.drawn(), scans, strict=True):
        np.testing.assert_array_equal(answers.truth, scan.labels)
        np.testing.assert_array_equal(drawn.xyz, scan.points[drawn.point])
        found += np.bincount(answers.outcome, minlength=len(Outcome))
    assert found[Outcome.FALSE_POSITIVE] == result.counts["static_removed"]
    assert found[Outcome.FALSE_NEGATIVE] == result.counts["dynamic_kept"]


def test_the_comparison_is_the_same(
    files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(files)
    comparison = dv.compare("fine/run.rrd", "coarse/run.rrd", out=tmp_path / "compare.rrd")
    comparison.save(tmp_path / "compare.json")
    plain, old = (json.loads((folder / "compare.json").read_text()) for folder in (tmp_path, DATA))
    for content in (plain, old):
        without_prose(content)
    assert plain["pairs"][0].pop("objects")  # from what earlier results have of each object
    assert plain["pairs"][0].pop("surfaces")  # from their cases
    assert unchanged(old, plain)


def without_prose(comparison: dict[str, Any]) -> None:
    """Remove sentences, which are not part of the format."""
    del comparison["verdicts"]
    for pair in comparison["pairs"]:
        del pair["places_note"], pair["runtime"]["notes"]


def test_a_comparison_with_itself_finds_no_difference(files: Path) -> None:
    path = files / "fine/run.rrd"
    pair = dv.compare(path, path).pairs[0]
    assert (pair.frames, pair.places, pair.differ) == ((), (), ())
    assert pair.scores.SA.delta == 0


def test_a_report_collects_them(files: Path) -> None:
    assert [run.label for run in collect([files])] == ["octomap", "octomap"]
    text = dv.report(files, format="md")
    for name in RUNS:
        assert f"{Result.load(files / name / 'result.json').metrics['SA']:.2f}" in text
    assert "<img" in dv.report(files, format="html")


def test_runs_that_do_not_state_their_origin(tmp_path: Path) -> None:
    """Of the version before runs stated their origin.

    All opens, and the ledger asks for the sequence in one line.
    """
    earlier = DATA.with_name("before_origin")
    for name in ("result.json", "labels.npz"):
        shutil.copy(earlier / name, tmp_path)
    (tmp_path / "run.rrd").write_bytes(gzip.decompress((earlier / "run.rrd.gz").read_bytes()))
    convert(room(3, 300), tmp_path / "room")
    with pytest.raises(
        UsageError,
        match=r"does not state where its sequence came from\. Give the sequence of the run",
    ):
        dv.why(tmp_path, 0, 5)
    labels = open_run(tmp_path).labels
    for file in (tmp_path, tmp_path / "run.rrd"):
        found = dv.why(file, 1, 5, sequence=tmp_path / "room")
        assert found.ledger.removed == labels[1][5]
        assert found.ledger.rules
    assert open_run(tmp_path).result.origin is None
    assert dv.compare(tmp_path / "run.rrd", tmp_path / "run.rrd").pairs
