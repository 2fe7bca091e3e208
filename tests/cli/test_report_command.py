"""The command ``dynaviz report``."""

from __future__ import annotations

import functools
import json
from dataclasses import replace
from pathlib import Path

import pytest

from dynaviz.scores.result import Result
from dynaviz.scores.sections import Runtime, Sections, SequenceInfo


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    counts = {"static_kept": 9, "static_removed": 1, "dynamic_removed": 8, "dynamic_kept": 2}
    metrics = {"SA": 90.0, "DA": 80.0, "AA": 84.85, "HA": 84.71, "precision": None, "IoU": None}
    result = Result("octomap", {}, SequenceInfo("s", "d"), Sections(counts=counts, metrics=metrics))
    result.save(tmp_path / "runs/a/result.json")
    return tmp_path / "runs"


@pytest.fixture
def report(run_command):
    return functools.partial(run_command, "report")


@pytest.mark.parametrize(
    ("name", "begins"),
    [
        ("r.html", "<!DOCTYPE html>"),
        ("r.md", "# "),
        ("r.csv", "sequence,"),
        ("r.HTM", "<!DOCTYPE html>"),
    ],
)
def test_the_suffix_selects_the_format(report, folder, tmp_path, name, begins):
    assert report(folder, "-o", tmp_path / name)[0] == 0
    text = (tmp_path / name).read_text()
    assert text.startswith(begins)
    assert "90.0" in text


def test_without_a_file_the_report_is_printed(report, folder):
    code, out, _ = report(folder)
    assert (code, out[:8]) == (0, "# Report")
    assert report(folder / "a/result.json", "--format", "csv")[1].count("\n") == 2


def test_maps_of_other_programs_have_no_runtime(report, folder):
    first = Result.load(folder / "a/result.json")
    runtime = Runtime(frames=3)  # as for a scored map
    for name in ("a", "b"):
        replace(first, sequence=SequenceInfo(name, name), runtime=runtime).save(
            folder / name / "result.json"
        )
    code, out, err = report(folder)
    assert code == 0, err
    assert "all 2" in out


def test_a_result_found_by_several_paths_counts_once(report, folder):
    assert (
        report(folder, folder / "a", folder / "a/result.json", "--format", "csv")[1].count("\n")
        == 2
    )


def test_a_result_takes_precedence_over_an_earlier_error(report, folder):
    (folder / "a/error.json").write_text("{}")
    assert report(folder, "--format", "csv")[1].count("\n") == 2


def broken(folder: Path, name: str, content: str) -> Path:
    (folder / "b").mkdir()
    (folder / "b" / name).write_text(content)
    return folder


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (lambda folder: (folder.parent / "nowhere",), "does not exist"),
        (lambda folder: (folder.parent / "empty",), "contains no result.json"),
        (lambda folder: (folder, "-o", "x.docx"), "Give --format csv|html|latex|md"),
        (lambda folder: (folder, "--format", "htlm"), "Did you mean 'html'?"),
        (lambda folder: (broken(folder, "result.json", "{"),), "b/result.json: not valid JSON"),
        (
            lambda folder: (broken(folder, "error.json", json.dumps({"error": 1})),),
            "b/error.json: does not state",
        ),
    ],
)
def test_errors_take_one_line(report, folder, given, message):
    (folder.parent / "empty").mkdir()
    code, _, err = report(*given(folder))
    assert code == 2
    assert err.count("\n") == 1
    assert message in err
