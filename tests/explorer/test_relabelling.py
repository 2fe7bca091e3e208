"""Corrections of ground truth: the scores with them, and what they leave alone."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from urllib.parse import urlencode
from urllib.request import Request, urlopen

import numpy as np
import pytest

import dynaviz as dv
from dynaviz.errors import DataError, UsageError
from dynaviz.runs.relabelling import Box, Correction, correct, read_corrections, rescore
from dynaviz.scores.result import Result


@pytest.fixture
def run(runs: dict[str, Path], tmp_path: Path) -> Path:
    """A copy of the fine run, to correct."""
    return Path(shutil.copytree(runs["fine"], tmp_path / "run"))


def digest(run: Path) -> str:
    return Result.load(run / "result.json").sequence.digest


def bytes_in(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_without_corrections_the_scores_are_those_of_the_run(run: Path) -> None:
    metrics = Result.load(run / "result.json").metrics
    found = rescore(run)
    assert (
        found.before
        == found.after
        == {name: pytest.approx(metrics[name]) for name in ("SA", "DA", "AA", "HA")}
    )
    assert (found.corrections, found.points) == (0, 0)


@pytest.mark.parametrize("truth", ["static", "dynamic"])
def test_the_points_in_a_box_are_scored_with_the_other_truth(
    run: Path, runs: dict[str, Path], truth: str
) -> None:
    frame, sequence = 2, runs["fine"].parent / "room"
    scans = dv.open(sequence)
    labels, known = [scan.labels for scan in scans], scans[frame].labels
    assert known is not None
    xyz = scans[frame].points[known != (truth == "dynamic")].astype(float)[:200]
    low, high = xyz.min(0).tolist(), xyz.max(0).tolist()
    box = Box(frame, tuple(low), tuple(high))
    before = bytes_in(run) | bytes_in(sequence)
    correct(run, digest(run), 1, Correction(1, "Kept car", truth, (box,)))  # type: ignore[arg-type]
    inside = (
        (scans[frame].points >= np.array(low) - 0.02)
        & (scans[frame].points <= np.array(high) + 0.02)
    ).all(1)
    changed = inside & (known < 2) & (known != (truth == "dynamic"))
    labels[frame] = np.where(changed, 1 - known, known)
    removed = list(Result.load(run / "result.json").labels)
    truths, answers = np.concatenate(labels), np.concatenate(removed)  # type: ignore[arg-type]
    found = rescore(run)
    assert found.points == changed.sum() > 5
    assert found.after["SA"] == pytest.approx(100 * (~answers[truths == 0]).mean())
    assert found.after["DA"] == pytest.approx(100 * answers[truths == 1].mean())
    assert str(found).endswith(f"with 1 correction of {changed.sum():,} points.")
    written = bytes_in(run) | bytes_in(sequence)
    assert {name for name in written if written[name] != before.get(name)} == {
        str(run / "corrections.json")
    }


def test_a_case_is_corrected_at_most_once_and_that_can_be_withdrawn(run: Path) -> None:
    box = Box(0, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    for truth in ("static", "dynamic"):
        correct(run, digest(run), 3, Correction(3, "Kept car", truth, (box,)))  # type: ignore[arg-type]
    correct(run, digest(run), 4, Correction(4, "Removed wall", "dynamic", (box,)))
    found = [(each.case, each.truth) for each in read_corrections(run, digest(run)).corrections]
    assert found == [(3, "dynamic"), (4, "dynamic")]
    correct(run, digest(run), 3, None)
    assert [each.case for each in read_corrections(run, digest(run)).corrections] == [4]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "not valid JSON"),
        ('{"sequence": 3}', "is not a file of corrections"),
        ('{"sequence": "other"}', "is for a different sequence than the run"),
        ('{"sequence": "other", "schema": 99}', "was written by a newer dynaviz"),
    ],
)
def test_files_that_are_no_corrections_are_refused(run: Path, content: str, message: str) -> None:
    (run / "corrections.json").write_text(content)
    with pytest.raises(DataError, match=rf"corrections\.json.* {message}"):
        rescore(run)


def test_runs_that_cannot_be_rescored(runs: dict[str, Path], tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no ground truth to correct"):
        rescore(runs["unknown"])
    with pytest.raises(DataError, match=r"contains no result\.json and no run\.rrd"):
        rescore(tmp_path)


def test_the_page_corrects_a_case(run: Path, run_command) -> None:
    case = next(
        case for case in Result.load(run / "result.json").failures if case.kind == "false_negative"
    )
    number = Result.load(run / "result.json").failures.index(case) + 1

    def ask(name: str, method: str = "GET", **query: object) -> dict[str, str]:
        with urlopen(
            Request(f"{server.url}api/{name}?{urlencode(query)}", method=method), timeout=60
        ) as answer:
            found: dict[str, str] = json.loads(answer.read())
            return found

    with dv.explore(run) as server:
        assert ask("correct", "POST", case=number, truth="static") == {str(number): "static"}
        text = ask("rescored")["text"]
    assert text == str(rescore(run))
    assert rescore(run).after["DA"] > rescore(run).before["DA"]  # type: ignore[operator]
    (made,) = read_corrections(run, digest(run)).corrections
    assert {box.frame for box in made.boxes} == set(range(case.first_frame, case.last_frame + 1))
    assert run_command("score", run)[:2] == (0, f"{text}\n")
    with dv.explore(run) as server:
        assert ask("runs")["a"]["corrections"] == {str(number): "static"}  # type: ignore[index]
        assert ask("correct", "POST", case=number) == {}
