"""What changed between two drives: appeared, disappeared, and not seen."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.static_hall import SENSOR, hall

import dynaviz as dv
from dynaviz.arrays import F64, Bool
from dynaviz.cleaning.changes import (
    APPEARED,
    DISAPPEARED,
    LISTED,
    MOVED,
    NAMES,
    NOT_SEEN,
    SEEN_AGAIN,
    Pair,
)
from dynaviz.contracts.scan import Scan
from dynaviz.errors import DataError, UsageError
from dynaviz.explorer.cards import cards
from dynaviz.explorer.run import ExploredRun
from dynaviz.io.fields import read_points
from dynaviz.sources.datasets.drives import Drives
from dynaviz.sources.drive import Drive
from dynaviz.testing import InMemory

SMALL, WALL = np.array([0.5, 0.5, 0.7]), np.array([0.2, 1.2, 1.2])  # half edges, metres
GONE, NEW, HIDDEN = (np.array(at) for at in ([3.6, 2.2, 0.9], [3.6, -2.2, 1.4], [9.8, -6.0, 0.8]))
FRAMES = 10


def drive(
    name: str, *standing: tuple[F64, F64], seed: int = 0, moved: F64 | None = None
) -> InMemory:
    """A drive through the hall, in which other things stand."""
    scans = [
        dataclasses.replace(scan, labels=None)
        for scan in hall(FRAMES, seed=seed, standing=standing)
    ]
    if moved is not None:
        scans = [scan.moved(moved) for scan in scans]
    return InMemory(scans, name, SENSOR)


@pytest.fixture(scope="module")
def both() -> Drives:
    """On Tuesday, one box is gone, and a wall stands before the place of another one, which only
    Monday can see.
    """
    monday = drive("monday", (GONE, SMALL), (HIDDEN, SMALL))
    return Drives.of([monday, drive("tuesday", (NEW, WALL), seed=1)])


@pytest.fixture(scope="module")
def cleaned(both: Drives, tmp_path_factory: pytest.TempPathFactory) -> Any:
    return dv.clean(both, tmp_path_factory.mktemp("changes") / "clean.pcd", changed=True)


def reasons(cleaned: Any) -> list[np.ndarray]:
    with np.load(cleaned.changes.folder / "labels.npz") as z:
        return np.split(z["reasons"], np.cumsum(z["points"])[:-1])


def on(scan: Scan, box: F64, half: F64) -> Bool:
    """(N,) bool: the points on a box."""
    near: Bool = (np.abs(scan.points - box) < half + 0.1).all(1)
    return near


def shares(cleaned: Any, both: Drives, frames: range, box: F64, half: F64) -> F64:
    """Share of the points on a box by reason."""
    found = [
        codes[on(both[k], box, half)] for k, codes in enumerate(reasons(cleaned)) if k in frames
    ]
    counts = np.bincount(np.concatenate(found), minlength=len(NAMES))
    assert counts.sum() > 100
    return counts / counts.sum()


def test_what_is_gone_is_told_from_what_is_hidden(cleaned: Any, both: Drives) -> None:
    monday, tuesday = range(FRAMES), range(FRAMES, 2 * FRAMES)
    assert shares(cleaned, both, monday, GONE, SMALL)[DISAPPEARED] > 0.9
    assert shares(cleaned, both, tuesday, NEW, WALL)[APPEARED] > 0.9
    hidden = shares(cleaned, both, monday, HIDDEN, SMALL)
    assert hidden[NOT_SEEN] > 0.8
    assert hidden[DISAPPEARED] == 0


def test_the_hall_is_unchanged_and_movers_are_no_changes(cleaned: Any, both: Drives) -> None:
    changed = static = 0
    for scan, codes in zip(map(both.__getitem__, range(len(both))), reasons(cleaned), strict=True):
        wall = (np.abs(scan.points[:, :2]) > 13.8).any(1)
        changed += int((codes[wall] <= APPEARED).sum())
        static += int((codes[wall] == SEEN_AGAIN).sum())
    print(changed, static)
    assert changed == 0
    assert static > 10_000
    assert (cleaned.changes.counts[:, MOVED] > 500).all()


def test_changes_are_listed_with_their_places_and_written(cleaned: Any, both: Drives) -> None:
    changes = cleaned.changes
    kinds = {}
    for cluster in changes.clusters[:2]:
        middle = (np.array(cluster.low) + np.array(cluster.high)) / 2
        kinds[max(cluster.reasons, key=cluster.reasons.__getitem__)] = middle
    print(cleaned)
    assert np.linalg.norm(kinds["disappeared"] - GONE) < 0.5
    assert np.linalg.norm(kinds["appeared"] - NEW) < 0.7
    totals = changes.counts.sum(0)
    for code in (DISAPPEARED, APPEARED, NOT_SEEN):
        assert len(read_points(changes.folder / f"{NAMES[code]}.pcd")) == totals[code] > 0
    assert totals.sum() == sum(len(both[k]) for k in range(len(both)))
    page = (cleaned.folder / "summary.md").read_text()
    assert "## What changed" in page
    assert "1. Appeared: " in page or "1. Disappeared: " in page
    assert (changes.folder / "run.rrd").is_file()
    assert (
        cleaned.to_dict()["changed"]["drives"]["monday"]["disappeared"]
        == changes.counts[0, DISAPPEARED]
    )


@pytest.mark.slow
def test_tiles_find_the_same_changes(cleaned: Any, both: Drives, tmp_path: Path) -> None:
    tiled = dv.clean(both, tmp_path / "clean.pcd", changed=True, tiles=15.0, record="none")
    assert tiled.changes.counts.tolist() == cleaned.changes.counts.tolist()
    assert tiled.changes.result.labels_sha256 == cleaned.changes.result.labels_sha256
    assert sum(len(read_points(file)) for file in (tiled.changes.folder / "appeared").glob("*.pcd"))
    assert (tiled.changes.folder / "appeared" / "tiles.json").is_file()


def test_drives_that_are_not_in_one_frame_are_refused(tmp_path: Path) -> None:
    beside = Drives.of([drive("monday"), drive("tuesday", seed=1, moved=np.array([0.0, 0.5, 0.0]))])
    with pytest.raises(
        DataError,
        match=r"monday and tuesday: do not agree at .* of .* places.*0\.5. m.*Register both",
    ):
        dv.clean(beside, tmp_path / "clean.pcd", changed=True, record="none")
    far = Drives.of([drive("monday"), drive("tuesday", moved=np.array([500.0, 0.0, 0.0]))])
    with pytest.raises(DataError, match="pass no common place"):
        dv.clean(far, tmp_path / "clean.pcd", changed=True, record="none")


def test_changes_need_two_drives(
    tmp_path: Path, run_command: Callable[..., tuple[int, str, str]]
) -> None:
    with pytest.raises(UsageError, match="compares two drives, not 1"):
        dv.clean(drive("monday"), tmp_path / "clean.pcd", changed=True)
    three = Drives.of([drive("monday")] * 3)
    with pytest.raises(UsageError, match="compares two drives, not 3"):
        dv.clean(three, tmp_path / "clean.pcd", changed=True)
    with pytest.raises(UsageError, match="frames of one drive only"):
        dv.clean(
            Drives.of([drive("monday")] * 2), tmp_path / "clean.pcd", changed=True, frames="0:8"
        )


def test_the_second_drive_begins_where_the_first_one_ends() -> None:
    scans = drive("monday").scans
    parts = [InMemory(scans[:3], "monday", SENSOR), InMemory(scans[3:], "tuesday", SENSOR)]
    drives = Drive.of(Drives.of(parts))
    assert [len(Pair.of(drives).alone(which, drives)) for which in (0, 1)] == [3, FRAMES - 3]
    assert Pair.of(dv.open(drives, stride=2)).first == 2


def test_the_explorer_shows_the_changes(cleaned: Any) -> None:
    explored = ExploredRun(cleaned.changes.folder)
    assert explored.result.clusters == cleaned.changes.result.clusters
    assert explored.title == "What changed, by seethrough"
    found = explored.wrong
    point = explored.point(int(found.frame[0]), int(found.point[0]))
    assert point["removed"]
    assert point["reason"] in NAMES[:2]
    for case, card in zip(explored.result.clusters, cards(explored), strict=True):
        assert case.suspicion == 0
        assert case.did == max(case.reasons, key=case.reasons.__getitem__)
        assert card.title in {f"{case.did.capitalize()} {what}" for what in ("object", "ground")}
        assert case.sentence.startswith(f"{card.title.split()[0]}: ")
    assert explored.compares
    for frame, codes in enumerate(reasons(cleaned)):
        for code in np.unique(codes):
            point = explored.point(frame, int(np.flatnonzero(codes == code)[0]))
            assert point["answer"] == NAMES[code].replace("_", " ")
            assert point["sentence"].startswith(
                f"{point['answer'].capitalize()} (no ground truth): "
            )


@dataclass(frozen=True)
class Shifted(InMemory):
    """A drive whose coordinates in the source are far from zero."""

    origin: F64 = field(default_factory=lambda: np.array([500_000.0, 5_400_000.0, 0.0]))


def test_changes_far_from_the_origin_are_listed_in_the_coordinates_of_the_source(
    cleaned: Any, both: Drives, tmp_path: Path
) -> None:
    parts = [each.reader for each in both.parts]
    far = Drives.of([Shifted(each.scans, each.name, each.sensor) for each in parts])  # type: ignore[attr-defined]
    found = dv.clean(far, tmp_path / "clean.pcd", changed=True)
    assert found.changes.clusters == cleaned.changes.clusters  # in the frame of the recording
    here, there = (listed(each.folder / "summary.md") for each in (cleaned, found))
    assert len(there) == min(len(found.changes.clusters), LISTED) > 0
    np.testing.assert_allclose(there, here + far.origin, atol=0.11)  # written with one decimal
    kept = found.changes.result.static_map()
    np.testing.assert_allclose(
        kept, cleaned.changes.result.static_map() + far.origin, rtol=0, atol=1e-3
    )
    assert ExploredRun(found.changes.result).compares
    assert not ExploredRun(found.result).compares


def listed(summary: Path) -> F64:
    """(K, 3): the places of the changes in a summary, metres."""
    page = summary.read_text().partition("## What changed")[2]
    places = re.findall(r"frames, \(.*?\) m, at \((.*?)\) m", page)
    return np.array([[float(x) for x in place.split(", ")] for place in places])
