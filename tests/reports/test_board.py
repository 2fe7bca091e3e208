"""Boards: digests and scores of entries, runs whose labels or sequence changed, and a page that
mixes nothing.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.browser import CHROMIUM, measured
from helpers.guessing_method import Guess, run_into
from helpers.html_pages import Page
from helpers.made_results import result
from helpers.worlds import InMemory, room

from dynaviz.contracts import registry
from dynaviz.contracts.protocol import ProtocolScores
from dynaviz.contracts.scan import Sequence
from dynaviz.errors import DataError
from dynaviz.reports.board.entries import read_board
from dynaviz.reports.board.write import write_board
from dynaviz.reports.reporting import Study
from dynaviz.scores.collect import collect
from dynaviz.scores.result import Result
from dynaviz.sources.drive import Drive

PROTOCOLS = {handle.name for handle in registry.handles("protocols")}


@pytest.fixture
def hall() -> InMemory:
    return room(frames=3, rays=300)


@pytest.fixture
def folder(tmp_path: Path, hall: InMemory) -> Path:
    """Two runs: of all frames, and of the last two."""
    for name, sequence in (("whole", hall), ("end", Drive.of(hall).select("1:"))):
        guess(sequence, tmp_path / name)
    return tmp_path


def guess(sequence: Sequence, folder: Path) -> None:
    """Run the test's method with the metrics that a board repeats."""
    metrics = tuple(
        registry.load("metrics", name)(Guess.info) for name in ("confusion", "voxelwise")
    )
    run_into(folder, sequence, recorded=False, metrics=metrics)


def edit(path: Path, change: Callable[[Any], None]) -> None:
    plain = json.loads(path.read_text())
    change(plain)
    path.write_text(json.dumps(plain))


def test_entries_have_digests_and_the_scores_of_every_protocol(
    folder: Path, hall: InMemory
) -> None:
    written = write_board(folder, folder / "site", [hall])
    board = read_board(folder / "site/board.json")
    assert board == written.board
    assert (written.rescored, [entry.path for entry in board.entries]) == (2, ["end", "whole"])
    for entry in board.entries:
        made = Result.load(folder / entry.path / "result.json")
        assert (entry.labels_sha256, entry.sequence) == (made.labels_sha256, made.sequence)
        assert set(entry.protocols) == PROTOCOLS
        points = entry.protocols["points"]
        assert points.scores == {name: made.metrics[name] for name in points.scores}
        assert points.counts == {name: made.counts[name] for name in points.counts}
        assert entry.protocols["semantickitti_mos"].scores["IoU"] == made.metrics["IoU"]
        voxels = made.sections.voxelwise
        assert voxels is not None
        assert entry.protocols["freedom"].scores["PR"] == voxels.PR


def test_known_scores_are_taken_over_by_digest(folder: Path, hall: InMemory) -> None:
    write_board(folder, folder / "site", [hall])
    assert write_board(folder, folder / "site").rescored == 0
    edit(folder / "end/result.json", lambda plain: plain.update(labels_sha256="ab" * 32))
    changed = write_board(folder, folder / "site", [hall]).board
    remarks = {entry.path: entry.remark for entry in changed.entries}
    assert remarks == {"end": "labels.npz differs from the labels that were scored", "whole": ""}


def test_runs_without_their_sequence_keep_their_own_scores(folder: Path) -> None:
    written = write_board(folder, folder / "site")
    assert {entry.remark for entry in written.board.entries} == {
        "the sequence was not found; give it with --sequence"
    }
    rows = {row[0]["text"]: row for row in Page(written.page.read_text()).body("main-1")}
    metrics = Result.load(folder / "end/result.json").metrics
    (row,) = rows.values()
    assert "not found" in row[0]["text"]
    assert row[1]["text"] in {
        f"{metrics['AA']:.2f}",
        f"{Result.load(folder / 'whole/result.json').metrics['AA']:.2f}",
    }
    assert {cell["text"] for cell in row[2:]} == {"n/a"}


def flip_a_label(folder: Path) -> None:
    with np.load(folder / "end/labels.npz") as z:
        arrays = dict(z)
    arrays["dynamic"][0] ^= 128
    np.savez(folder / "end/labels.npz", **arrays)


@pytest.mark.parametrize(
    ("change", "remark"),
    [
        (flip_a_label, "labels.npz differs from the labels that were scored"),
        (lambda folder: (folder / "end/labels.npz").unlink(), "labels.npz is missing"),
        (
            lambda folder: edit(
                folder / "end/result.json", lambda r: r["sequence"].update(digest="0")
            ),
            "the sequence room differs from that of the run",
        ),
    ],
    ids=["label", "no labels", "digest"],
)
def test_changed_runs_are_not_scored(
    folder: Path, hall: InMemory, change: Callable[[Path], None], remark: str
) -> None:
    change(folder)
    board = write_board(folder, folder / "site", [hall]).board
    assert {entry.path: (entry.remark, bool(entry.protocols)) for entry in board.entries} == {
        "end": (remark, False),
        "whole": ("", True),
    }


def test_labels_of_other_points_are_not_scored(folder: Path) -> None:
    for other, problem in (
        (room(3, 200), "has 300 labels for frame"),
        (room(2, 300), "labels for 3 frames, of which"),
    ):
        board = write_board(folder, folder / "site", [other]).board
        assert any(problem in entry.remark for entry in board.entries)


def made_study(tmp_path: Path, *results: Result, **scores: dict[str, float]) -> Study:
    """A study of made results; every run has the same scores by protocol."""
    for number, each in enumerate(results):
        each.save(tmp_path / f"{number:02}" / "result.json")
    runs = collect([tmp_path])
    made = {name: ProtocolScores(values) for name, values in scores.items()}
    return Study(
        runs,
        tmp_path,
        protocols=registry.loadable("protocols"),
        scores={run.file: made for run in runs},
    )


KITTI = {"name": "kitti_00", "digest": "k", "frames": 141, "points": 17362230}


def test_published_figures_are_never_mixed_with_measured_ones(tmp_path: Path) -> None:
    study = made_study(
        tmp_path,
        result("dufomap", KITTI),
        result("erasor", KITTI),
        benchmark={"AA": 12.34, "SA": 23.45, "DA": 34.56},
    )
    page = Page(registry.load("reports", "html")(study))
    rows = {row[0]["text"]: [cell["text"] for cell in row] for row in page.body("published-1")}
    assert rows["DUFOMap"][1:9] == [
        "97.96",
        "98.72",
        "98.34",
        "98.34",
        "23.45",
        "34.56",
        "12.34",
        "n/a",
    ]
    assert rows["DOR fusion"][5:9] == ["–"] * 4
    assert [cell["text"] for cell in page.tables["published-1"][0][1:3]] == [
        "published [%]",
        "here, same protocol [%]",
    ]
    published = {row[k] for row in rows.values() for k in range(1, 5)}
    elsewhere = {name: table for name, table in page.tables.items() if "published" not in name}
    assert not published & {
        cell["text"] for table in elsewhere.values() for row in table for cell in row
    }


def test_published_scores_under_a_protocol_stand_beside_own_ones(tmp_path: Path) -> None:
    study = made_study(tmp_path, result("erasor", KITTI), erasor={"F1": 61.5, "PR": 50, "RR": 80})
    page = Page(registry.load("reports", "html")(study))
    rows = {
        row[0]["text"]: [cell["text"] for cell in row] for row in page.body("published-protocols-1")
    }
    assert rows["ERASOR"][3:9] == ["95.50", "93.98", "97.08", "61.50", "50.00", "80.00"]
    assert rows["ERASOR2"][6:9] == ["–"] * 3


@pytest.mark.slow
def test_several_sequences_have_a_table_for_each_protocol(tmp_path: Path) -> None:
    runs = [result(m, s) for m in ("octomap", "erasor") for s in ("semantickitti_08", "hall")]
    runs += [result("removert", "hall"), result("map", "hall", scoring="nn")]
    counts = {"TP": 30, "FP": 10, "FN": 20}
    study = made_study(tmp_path, *runs)
    scores = {
        run.file: {"semantickitti_mos": ProtocolScores({"IoU": 50.0}, counts)} for run in study.runs
    }
    text = registry.load("reports", "html")(
        Study(study.runs, tmp_path, protocols=study.protocols, scores=scores)
    )
    page = Page(text)
    assert not any(
        name.startswith("across") and name.endswith("nn") for name in page.tables
    )  # a single sequence
    rows = {
        row[0]["text"]: [cell["text"] for cell in row[1:]]
        for row in page.body("across-semantickitti_mos-mask")
    }
    assert rows == {
        "octomap": ["50.00"] * 3,
        "erasor": ["50.00"] * 3,
        "removert": ["–", "50.00", "–"],
    } or rows == {
        "octomap": ["50.00"] * 3,
        "erasor": ["50.00"] * 3,
        "removert": ["50.00", "–", "–"],
    }
    assert "In the split val of SemanticKITTI-MOS." in page.text
    assert len(page.ids) == len(set(page.ids))
    assert {link[1:] for link in page.links if link.startswith("#")} <= set(page.ids)
    assert all(loaded.startswith("#") for loaded in page.loaded)
    assert not re.search(r"""(src|href|url\()\s*=?\s*["'(]?\s*(https?:)?//""", text)
    if CHROMIUM:
        (tmp_path / "index.html").write_text(text)
        assert measured(tmp_path / "index.html", 390)["cut"] == []


def test_a_damaged_board_is_refused(folder: Path, hall: InMemory) -> None:
    write_board(folder, folder / "site", [hall])
    for content, problem in (
        ("{}", "is not the file of a board"),
        ('{"entries": [1]}', "is not a valid board"),
        ('{"entries": [], "schema": 99}', "was written by a newer dynaviz"),
        ("{", "board.json"),
    ):
        (folder / "site/board.json").write_text(content)
        with pytest.raises(DataError, match=problem):
            write_board(folder, folder / "site", [hall])
