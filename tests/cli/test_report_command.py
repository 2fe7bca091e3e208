"""dynaviz report as a user types it."""

from __future__ import annotations

import functools
import json
from dataclasses import replace
from pathlib import Path

import pytest

from dynaviz.results.result import Result


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    sections = {"counts": {"static_kept": 9, "static_removed": 1, "dynamic_removed": 8, "dynamic_kept": 2}}
    metrics = {"SA": 90.0, "DA": 80.0, "AA": 84.85, "HA": 84.71, "precision": None, "IoU": None}
    result = Result("octomap", {}, {"name": "s", "digest": "d"}, sections={**sections, "metrics": metrics})
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
        ("r.tex", "% "),
        ("r.csv", "sequence,"),
        ("r.HTM", "<!DOCTYPE html>"),
    ],
)
def test_the_suffix_tells_the_format(report, folder, tmp_path, name, begins):
    assert report(folder, "-o", tmp_path / name)[0] == 0
    text = (tmp_path / name).read_text()
    assert text.startswith(begins)
    assert "90.0" in text


def test_without_a_file_it_is_printed(report, folder):
    code, out, _ = report(folder)
    assert (code, out[:8]) == (0, "# Report")
    assert report(folder / "a/result.json", "--format", "csv")[1].count("\n") == 2


def test_a_map_of_another_program_has_no_runtime_on_all_sequences_either(report, folder):
    first = Result.load(folder / "a/result.json")
    runtime = {"mean_s": None, "std_s": None, "frames": 3}  # as a scored map has it
    for name in ("a", "b"):
        replace(first, sequence={"name": name, "digest": name}, runtime=runtime).save(folder / name / "result.json")
    code, out, err = report(folder)
    assert code == 0, err
    assert "all 2" in out


def test_what_two_paths_hold_is_found_once(report, folder):
    assert report(folder, folder / "a", folder / "a/result.json", "--format", "csv")[1].count("\n") == 2


def test_a_result_goes_before_an_earlier_error(report, folder):
    (folder / "a/error.json").write_text("{}")
    assert report(folder, "--format", "csv")[1].count("\n") == 2


def broken(folder: Path, name: str, content: str) -> Path:
    (folder / "b").mkdir()
    (folder / "b" / name).write_text(content)
    return folder


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (lambda folder: (folder.parent / "nowhere",), "does not exist"),
        (lambda folder: (folder.parent / "empty",), "holds no result.json"),
        (lambda folder: (folder, "-o", "x.docx"), "give --format csv|html|latex|md"),
        (lambda folder: (folder, "--format", "htlm"), "Did you mean 'html'?"),
        (lambda folder: (broken(folder, "result.json", "{"),), "b/result.json: not valid JSON"),
        (lambda folder: (broken(folder, "error.json", json.dumps({"error": 1})),), "b/error.json: does not tell"),
    ],
)
def test_a_mistake_is_answered_in_one_line(report, folder, given, said):
    (folder.parent / "empty").mkdir()
    code, _, err = report(*given(folder))
    assert code == 2
    assert err.count("\n") == 1
    assert said in err
