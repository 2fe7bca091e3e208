"""Decisions about ground truth: the scores with them, and what they leave alone."""

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
from dynaviz.reviews.decisions import Decisions, ReviewDecision
from dynaviz.reviews.regions import ObjectRegion, Piece
from dynaviz.runs.reviewed import reviewed_scores
from dynaviz.scores.result import Result


@pytest.fixture
def run(runs: dict[str, Path], tmp_path: Path) -> Path:
    """A copy of the fine run, to correct."""
    return Path(shutil.copytree(runs["fine"], tmp_path / "run"))


def digest(run: Path) -> str:
    return Result.load(run / "result.json").sequence.digest


def bytes_in(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_without_decisions_the_scores_are_those_of_the_run(run: Path) -> None:
    metrics = Result.load(run / "result.json").metrics
    found = reviewed_scores(run)
    expected = {name: pytest.approx(metrics[name]) for name in ("SA", "DA", "AA", "HA")}
    assert found.before == expected
    assert found.after == expected
    assert (found.decisions, found.points) == (0, 0)


@pytest.mark.parametrize("truth", ["static", "dynamic"])
@pytest.mark.parametrize("earlier", [False, True], ids=["review", "corrections"])
def test_the_points_in_a_box_are_scored_with_the_other_truth(
    run: Path, runs: dict[str, Path], truth: str, earlier: bool
) -> None:
    frame = 2
    sequence = runs["fine"].parent / "room"
    scans = dv.open(sequence)
    labels = [scan.labels for scan in scans]
    known = labels[frame]
    assert known is not None
    xyz = scans[frame].points[known != (truth == "dynamic")].astype(float)[:200]
    low = xyz.min(0).tolist()
    high = xyz.max(0).tolist()
    before = bytes_in(run) | bytes_in(sequence)
    margin = 0.02
    if earlier:
        box = {"frame": frame, "low": low, "high": high}
        made = {"case": 1, "what": "Kept car", "truth": truth, "boxes": [box]}
        plain = {"sequence": digest(run), "corrections": [made], "schema": 1}
        (run / "corrections.json").write_text(json.dumps(plain))
    else:
        piece = Piece(scans[frame].index, tuple(low), tuple(high))
        region = ObjectRegion("frame", (piece,), margin=margin)
        Decisions(run).add(ReviewDecision(truth, region))  # type: ignore[arg-type]
    inside = (
        (scans[frame].points >= np.array(low) - margin)
        & (scans[frame].points <= np.array(high) + margin)
    ).all(1)
    changed = inside & (known < 2) & (known != (truth == "dynamic"))
    labels[frame] = np.where(changed, 1 - known, known)
    truths = np.concatenate(labels)  # type: ignore[arg-type]
    answers = np.concatenate(list(Result.load(run / "result.json").labels))
    found = reviewed_scores(run)
    assert found.points == changed.sum() > 5
    assert found.after["SA"] == pytest.approx(100 * (~answers[truths == 0]).mean())
    assert found.after["DA"] == pytest.approx(100 * answers[truths == 1].mean())
    assert str(found).endswith(f"with 1 decision ({changed.sum():,} points changed).")
    written = bytes_in(run) | bytes_in(sequence)
    name = "corrections.json" if earlier else "review.json"
    changed_files = {path for path in written if written[path] != before.get(path)}
    assert changed_files == {str(run / name)}


def test_corrections_of_an_earlier_version_are_carried_into_the_review(run: Path) -> None:
    box = {"frame": 0, "low": [0, 0, 0], "high": [1, 1, 1]}
    made = {"case": 3, "what": "Kept car", "truth": "dynamic", "boxes": [box]}
    plain = {"sequence": digest(run), "corrections": [made], "schema": 1}
    (run / "corrections.json").write_text(json.dumps(plain))
    with dv.explore(run) as server:
        assert ask(server.url, "runs")["a"]["corrections"] == {"3": "dynamic"}
        assert ask(server.url, "correct", "POST", case=4, truth="static") == {
            "3": "dynamic",
            "4": "static",
        }
        assert ask(server.url, "correct", "POST", case=3) == {"4": "static"}
    assert json.loads((run / "corrections.json").read_text()) == plain
    assert [each.verdict for each in Decisions(run).standing] == ["static"]


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
        reviewed_scores(run)


def test_runs_that_cannot_be_rescored(runs: dict[str, Path], tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no ground truth to correct"):
        reviewed_scores(runs["unknown"])
    with pytest.raises(DataError, match=r"contains no result\.json and no run\.rrd"):
        reviewed_scores(tmp_path)


def ask(url: str, name: str, method: str = "GET", **query: object) -> dict[str, str]:
    request = Request(f"{url}api/{name}?{urlencode(query)}", method=method)
    with urlopen(request, timeout=60) as answer:
        found: dict[str, str] = json.loads(answer.read())
        return found


def test_the_page_corrects_a_case(run: Path, runs: dict[str, Path], run_command) -> None:
    failures = Result.load(run / "result.json").failures
    case = next(case for case in failures if case.kind == "false_negative")
    number = failures.index(case) + 1
    with dv.explore(run) as server:
        corrected = ask(server.url, "correct", "POST", case=number, truth="static")
        assert corrected == {str(number): "static"}
        text = ask(server.url, "rescored")["text"]
    found = reviewed_scores(run)
    assert text == str(found)
    assert found.after["DA"] > found.before["DA"]  # type: ignore[operator]
    (made,) = Decisions(run).standing
    assert isinstance(made.region, ObjectRegion)
    times = [piece.time for piece in made.region.pieces]
    scans = dv.open(runs["fine"].parent / "room")
    frames = range(case.first_frame, case.last_frame + 1)
    assert times == [scans[frame].index for frame in frames]
    assert run_command("score", run)[:2] == (0, f"{text}\n")
    with dv.explore(run) as server:
        assert ask(server.url, "runs")["a"]["corrections"] == {str(number): "static"}  # type: ignore[index]
        assert ask(server.url, "correct", "POST", case=number) == {}


def test_another_method_is_scored_against_the_same_truth(
    run: Path, runs: dict[str, Path], tmp_path: Path
) -> None:
    """A file that a person made for one run changes the truth of every run on the sequence."""
    scans = dv.open(runs["fine"].parent / "room")
    piece = Piece(scans[1].index, (-2.0, -2.0, -2.0), (2.0, 2.0, 2.0))
    Decisions(run).add(ReviewDecision("dynamic", ObjectRegion("frame", (piece,))))
    review = run / "review.json"
    coarse = reviewed_scores(runs["coarse"], review=review)
    assert coarse.points == reviewed_scores(run).points > 0
    again = dv.run(
        "octomap", scans, out=tmp_path / "again", record="none", settings=("resolution=0.9",),
        review=review,
    )  # fmt: skip
    assert again.metrics["AA"] == pytest.approx(coarse.after["AA"])
    assert again.labels_sha256 == Result.load(runs["coarse"] / "result.json").labels_sha256
    comparison = dv.compare(runs["fine"] / "run.rrd", runs["coarse"] / "run.rrd", review=review)
    assert f"{coarse.after['AA']:.1f}" in str(comparison)
