"""Maps that are written again from the labels of a run, with the decisions of a person."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.scan_folders import write_attributed_scans
from helpers.worlds import room

import dynaviz as dv
from dynaviz.errors import DataError, UsageError
from dynaviz.io.fields import coordinates, read_fields
from dynaviz.reviews.regions import ROUNDED, BoxRegion

Command = Callable[..., tuple[int, str, str]]
FRAMES = 4
FAR = np.array([512_000.0, 5_403_000.0, 0.0])
SCANS = room(frames=FRAMES, rays=1500).scans


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scans with ring and intensity, far from the origin of their world."""
    return write_attributed_scans(tmp_path_factory.mktemp("drive") / "scans", SCANS, FAR)


def clean(source: Any, out: Path, **options: Any) -> Any:
    return dv.clean(source, out, method="octomap", record="none", threads=1, **options)


@pytest.fixture(scope="module")
def first(drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a map and its run."""
    folder = tmp_path_factory.mktemp("first")
    clean(drive, folder / "map.npz", keep_dynamic=folder / "removed.npz", mark=False)
    return folder


@pytest.fixture
def run(first: Path, tmp_path: Path) -> Path:
    """A copy of the folder of the run, to decide about."""
    return Path(shutil.copytree(first / "map_run", tmp_path / "map_run"))


def box_around(points: np.ndarray) -> BoxRegion:
    return BoxRegion(
        tuple((points.min(0) - 0.001).tolist()), tuple((points.max(0) + 0.001).tolist())
    )


def same_fields(one: Path, other: Path) -> bool:
    first, second = (read_fields(path) for path in (one, other))
    return list(first) == list(second) and all(
        first[name].dtype == second[name].dtype and (first[name] == second[name]).all()
        for name in first
    )


def test_without_decisions_the_map_is_the_first_one(first: Path, run: Path, tmp_path: Path) -> None:
    again = dv.clean(run, tmp_path / "again.npz", keep_dynamic=tmp_path / "removed.npz")
    assert same_fields(tmp_path / "again.npz", first / "map.npz")
    assert same_fields(tmp_path / "removed.npz", first / "removed.npz")
    assert (again.account.kept_by_hand, again.account.removed_by_hand) == (0, 0)
    assert again.account.points == sum(len(scan) for scan in SCANS)


def test_each_point_goes_where_the_last_decision_about_it_says(
    drive: Path, run: Path, tmp_path: Path
) -> None:
    world = [scan.points.astype(np.float64) for scan in dv.open(drive)]
    points = np.concatenate(world) + FAR
    review = dv.review(run)
    removed = np.concatenate(review.labels)
    middle = np.median(points[removed], axis=0)
    kept_box = box_around(points[removed][np.abs(points[removed] - middle).max(1) < 1.0])
    removed_box = box_around(points[~removed][:40])
    review.decide(removed_box, "dynamic", what="a shelf", reviewer="R", reason="gone later")
    review.decide(kept_box, "static", what="a pole | post")

    def inside(box: BoxRegion) -> np.ndarray:
        low = np.array(box.low) - ROUNDED
        high = np.array(box.high) + ROUNDED
        return ((points >= low) & (points <= high)).all(1)

    expected = np.where(inside(kept_box), False, inside(removed_box) | removed)
    assert (expected & ~removed).sum() > 0
    assert (removed & ~expected).sum() > 0
    assert (np.concatenate(dv.review(run).labels) == expected).all()

    written = dv.review(run).write(
        tmp_path / "signed.npz", keep_dynamic=tmp_path / "signed_removed.npz"
    )
    for name, chosen in (("signed", ~expected), ("signed_removed", expected)):
        found = read_fields(tmp_path / f"{name}.npz")
        assert np.allclose(coordinates(found), points[chosen], rtol=0, atol=2e-3)
        numbers = np.concatenate([np.arange(len(scan)) for scan in SCANS])[chosen]
        assert (found["ring"] == numbers % 16).all()
        assert (found["intensity"] == (numbers / 7).astype(np.float32)).all()
    account = written.account
    assert account.kept + account.removed == len(points) == account.points
    assert account.kept_by_hand == (removed & ~expected).sum()
    assert account.removed_by_hand == (expected & ~removed).sum()
    assert f"{account.kept_by_hand:,} of the kept" in str(account)

    summary = (run / "summary.md").read_text()
    assert "## Decided by hand" in summary
    assert "| dynamic | a shelf |" in summary
    assert "| R | gone later |" in summary
    assert "| static | a pole / post |" in summary
    # the labels are those of the method, whatever was decided
    assert (np.concatenate(dv.Result.load(run / "result.json").labels) == removed).all()


def test_marks_tell_what_was_changed_by_hand(run: Path, tmp_path: Path) -> None:
    review = dv.review(run)
    removed = np.concatenate(review.labels)
    points = np.concatenate([scan.points.astype(np.float64) for scan in SCANS])
    everything = BoxRegion((-1e7, -1e7, -1e7), (1e7, 1e7, 1e7))
    review.decide(everything, "static")
    review.write(tmp_path / "marked.npz", mark=True)
    found = read_fields(tmp_path / "marked.npz")
    assert len(found["x"]) == len(points)
    assert (found["dynamic"] == 0).all()
    assert (found["by_hand"].astype(bool) == removed).all()
    review.undo()
    review.write(tmp_path / "undone.npz", mark=True)
    found = read_fields(tmp_path / "undone.npz")
    assert (found["dynamic"].astype(bool) == removed).all()
    assert not found["by_hand"].any()
    assert [type(each).__name__ for each in review.history] == ["ReviewDecision", "Undo"]


def test_the_same_file_gives_the_same_map_in_a_run_of_the_method(
    drive: Path, run: Path, tmp_path: Path
) -> None:
    review = dv.review(run)
    centre = FAR + np.concatenate([scan.points[:50] for scan in SCANS]).mean(0)
    review.decide(BoxRegion(tuple(centre - 2), tuple(centre + 2)), "dynamic")
    review.write(tmp_path / "written.npz")
    cleaned = clean(drive, tmp_path / "cleaned.npz", review=run / "review.json")
    assert same_fields(tmp_path / "written.npz", tmp_path / "cleaned.npz")
    assert cleaned.account.removed_by_hand > 0
    section = cleaned.result.sections.review
    assert section is not None
    assert (section.decisions, section.removed) == (1, cleaned.account.removed_by_hand)
    tiled = clean(drive, tmp_path / "tiled.npz", review=run / "review.json", tiles=10)
    again = dv.clean(tmp_path / "tiled_run", tmp_path / "tiled_again.npz")
    assert tiled.account.removed_by_hand > 0
    assert again.account == tiled.account
    names = sorted(path.name for path in (tmp_path / "tiled").iterdir())
    assert len(names) > 1
    assert sorted(path.name for path in (tmp_path / "tiled_again").iterdir()) == names
    for name in names:
        if name.endswith(".npz"):
            assert same_fields(tmp_path / "tiled" / name, tmp_path / "tiled_again" / name)


def test_the_command_writes_the_map_and_says_what_matches_nothing(
    run: Path, tmp_path: Path, run_command: Command
) -> None:
    review = dv.review(run, review=tmp_path / "elsewhere.json")
    review.decide(BoxRegion((0, 0, 0), (1, 1, 1)), "static", what="a wall")
    code, out, err = run_command(
        "clean", run, "-o", tmp_path / "map.laz", "--review", tmp_path / "elsewhere.json",
        "--accept",
    )  # fmt: skip
    assert code == 0, err
    assert (tmp_path / "map.laz").is_file()
    assert "1 of 1 decisions match no point of this sequence" in err
    assert "static: a wall" in err
    assert "by hand" in out or "by hand" in (run / "summary.md").read_text()
    code, _, err = run_command("clean", run, "-o", tmp_path / "map.laz", "-m", "erasor")
    assert code == 2
    assert "a run" in err


def test_what_cannot_be_written_leaves_the_map_as_it_was(
    drive: Path, run: Path, tmp_path: Path
) -> None:
    out = tmp_path / "map.npz"
    dv.review(run).write(out)
    before = out.read_bytes()
    (run / "review.json").write_text("{")
    with pytest.raises(DataError, match=r"review\.json.* not valid JSON"):
        dv.review(run).write(out)
    (run / "review.json").write_text(json.dumps({"schema": 1, "entries": []}))
    with pytest.raises(UsageError, match="contains no point"):
        dv.review(run).write(out, region="0,0,1,1")
    assert out.read_bytes() == before
    with pytest.raises(DataError, match="does not exist"):
        clean(drive, out, review=run / "none.json")
