"""Decisions: their file, the regions that they are about, and what they do to answers and truth."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.worlds import room

from dynaviz.contracts.scan import Label, Scan
from dynaviz.errors import DataError, UsageError
from dynaviz.reviews.applying import NONE, Applied, seen_in
from dynaviz.reviews.decisions import Decisions, ReviewDecision, Undo
from dynaviz.reviews.regions import (
    BoxRegion,
    ObjectRegion,
    Piece,
    PolygonRegion,
    Span,
    packed_cells,
    piece_of,
    unpacked_cells,
)
from dynaviz.sources.datasets.in_memory import ArraySequence
from dynaviz.sources.drive import Drive

BOX = BoxRegion((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))


def scan_of(points: Any, index: int = 0, stamp_ns: int | None = None, **more: Any) -> Scan:
    return Scan(index, np.asarray(points, np.float32), np.eye(4), stamp_ns, **more)


def verdicts(region: Any, points: Any, verdict: Any = "static", **more: Any) -> list[int]:
    of = {name: more.pop(name) for name in ("index", "stamp_ns") if name in more}
    return (
        Applied([ReviewDecision(verdict, region, **more)]).verdicts(scan_of(points, **of)).tolist()
    )


def random_points(seed: int, n: int = 4000) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-5, 5, (n, 3)).astype(np.float32)


def test_entries_are_added_and_undone(tmp_path: Path) -> None:
    decisions = Decisions(tmp_path)
    assert decisions.path == tmp_path / "review.json"
    first = decisions.add(ReviewDecision("static", BOX, what="a pole", reason="seen", reviewer="R"))
    second = decisions.add(ReviewDecision("dynamic", BOX))
    assert first.id != second.id
    assert first.made < second.made or first.made == second.made
    assert decisions.undo() == second
    assert Decisions(tmp_path).standing == (first,)
    assert decisions.undo(first.id) == first
    assert Decisions(tmp_path).standing == ()
    entries = Decisions(tmp_path).entries
    assert [type(each) for each in entries] == [ReviewDecision, ReviewDecision, Undo, Undo]
    with pytest.raises(UsageError, match="contains no decision to undo"):
        decisions.undo()


def test_two_writers_lose_nothing(tmp_path: Path) -> None:
    context = multiprocessing.get_context("spawn")
    workers = [context.Process(target=add_some, args=(tmp_path, name)) for name in "ab"]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(60)
        assert worker.exitcode == 0
    found = [each.what for each in Decisions(tmp_path).standing]
    for name in "ab":
        assert [what for what in found if what[0] == name] == [f"{name}{k}" for k in range(15)]


def add_some(folder: Path, name: str) -> None:
    decisions = Decisions(folder)
    for k in range(15):
        decisions.add(ReviewDecision("static", BOX, what=f"{name}{k}"))


def test_a_killed_writer_leaves_whole_files_and_no_lock_that_lasts(tmp_path: Path) -> None:
    code = (
        "import sys; sys.path.insert(0, sys.argv[2])\n"
        "from pathlib import Path\n"
        "from test_decisions import BOX, ReviewDecision, Decisions\n"
        "decisions = Decisions(Path(sys.argv[1])); print('ready', flush=True)\n"
        "while True: decisions.add(ReviewDecision('static', BOX))\n"
    )
    for _ in range(3):
        command = [sys.executable, "-c", code, str(tmp_path), str(Path(__file__).parent)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, env=env()) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == b"ready\n"
            before = len(Decisions(tmp_path).entries)
            while len(Decisions(tmp_path).entries) < before + 3:
                time.sleep(0.01)
            os.kill(process.pid, signal.SIGKILL)
        killed = len(Decisions(tmp_path).entries)
        Decisions(tmp_path).add(ReviewDecision("dynamic", BOX))
        assert len(Decisions(tmp_path).entries) in (killed + 1, killed + 2)


def env() -> dict[str, str]:
    tests = str(Path(__file__).parents[1])
    return {**os.environ, "PYTHONPATH": tests}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "not valid JSON"),
        ("[1, 2]", "is not a file of decisions"),
        ('{"entries": [{"type": "decision", "verdict": "maybe"}], "schema": 1}', "Invalid enum"),
        ('{"entries": [], "schema": 99}', "was written by a newer dynaviz"),
        ('{"type": "FeatureCollection", "features": []}', "is not a file of decisions"),
    ],
)
def test_other_files_are_refused_and_stay_as_they_are(
    tmp_path: Path, content: str, message: str
) -> None:
    file = tmp_path / "review.json"
    file.write_text(content)
    with pytest.raises(DataError, match=message) as caught:
        Decisions(tmp_path)
    assert "\n" not in str(caught.value)
    file.unlink()
    decisions = Decisions(tmp_path)
    file.write_text(content)
    with pytest.raises(DataError, match=message):
        decisions.add(ReviewDecision("static", BOX))
    assert file.read_text() == content


def test_any_change_of_a_byte_is_read_or_refused(tmp_path: Path) -> None:
    decisions = Decisions(tmp_path)
    piece = piece_of(3, random_points(0, 50).astype(np.float64))
    decisions.add(ReviewDecision("static", ObjectRegion("frame", (piece,)), what="an object"))
    whole = decisions.path.read_bytes()
    random = np.random.default_rng(1)
    for _ in range(200):
        changed = bytearray(whole)
        changed[random.integers(len(whole))] = random.integers(32, 127)
        decisions.path.write_bytes(changed)
        with contextlib.suppress(DataError):
            Applied(Decisions(tmp_path).standing).verdicts(scan_of(random_points(2), index=3))


def test_a_box_holds_at_all_times_and_a_span_limits_it() -> None:
    points = random_points(3)
    inside = (np.abs(points) <= 1).all(1)
    for index in (0, 7):
        assert verdicts(BOX, points, index=index) == np.where(inside, 0, NONE).tolist()
    span = Span("frame", 4, None)
    assert verdicts(BOX, [[0, 0, 0]], span=span, index=3) == [NONE]
    assert verdicts(BOX, [[0, 0, 0]], span=span, index=4) == [0]
    span = Span("stamp", None, 10**18)
    assert verdicts(BOX, [[0, 0, 0]], span=span, index=3) == [NONE]
    assert verdicts(BOX, [[0, 0, 0]], span=span, stamp_ns=10**18 + 900_000) == [0]
    assert verdicts(BOX, [[0, 0, 0]], span=span, stamp_ns=10**18 + 2_000_000) == [NONE]


def test_a_polygon_is_limited_in_height() -> None:
    region = PolygonRegion(((0, 0), (4, 0), (0, 4)), 0.0, 1.0)
    points = [[1, 1, 0.5], [1, 1, 1.5], [3, 3, 0.5], [-1, 1, 0.5]]
    assert verdicts(region, points, "dynamic") == [1, NONE, NONE, NONE]


@pytest.mark.parametrize("offset", [0.0, 512_000.0])
def test_an_object_contains_its_own_points_and_no_cell_beside(offset: float) -> None:
    points = random_points(4)
    chosen = np.linalg.norm(points, axis=1) < 2
    origin = np.array([offset, 10 * offset, 0.0])
    world = points.astype(np.float64) + origin
    region = ObjectRegion("frame", (piece_of(5, world[chosen]),))
    applied = Applied([ReviewDecision("static", region)], origin)
    found = applied.verdicts(scan_of(points, index=5)) == 0
    low = world[chosen].min(0)
    cells = np.floor((world - low) / region.edge).astype(int)
    filled = {tuple(cell) for cell in cells[chosen].tolist()}
    assert found.tolist() == [tuple(cell) in filled for cell in cells.tolist()]
    assert found[chosen].all()
    assert (applied.verdicts(scan_of(points, index=6)) == NONE).all()


def test_an_object_is_on_its_way_between_two_frames() -> None:
    body = random_points(5, 300).astype(np.float64) / 10
    pieces = tuple(piece_of(t, body + np.array([t * 0.5, 0, 0])) for t in (10, 12, 40))
    region = ObjectRegion("frame", pieces)
    between = (body + np.array([11 * 0.5, 0, 0])).astype(np.float32)
    assert verdicts(region, between, index=11) == [0] * len(body)
    assert set(verdicts(region, between, index=26)) == {NONE}  # too long unseen
    assert set(verdicts(region, between, index=41)) == {NONE}


def test_cells_are_packed_and_unpacked() -> None:
    cells = np.unique(np.random.default_rng(6).integers(0, 300, (500, 3)), axis=0)
    assert (unpacked_cells(packed_cells(cells)) == cells).all()
    for text in ("", "AAAA", "not base64"):
        with pytest.raises(ValueError, match="cells"):
            unpacked_cells(text)


def test_the_last_decision_on_a_point_holds_and_each_effect_is_counted() -> None:
    points = random_points(7)
    small = BoxRegion((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5))
    far = BoxRegion((90.0, 90.0, 90.0), (91.0, 91.0, 91.0))
    applied = Applied(
        [
            ReviewDecision("dynamic", BOX),
            ReviewDecision("static", small),
            ReviewDecision("static", far),
        ]
    )
    dynamic = np.random.default_rng(8).random(len(points)) < 0.5
    answers, found = applied.answers(scan_of(points), dynamic)
    inner = (np.abs(points) <= 0.5).all(1)
    outer = (np.abs(points) <= 1).all(1) & ~inner
    assert (answers == np.where(inner, False, np.where(outer, True, dynamic))).all()
    assert (found == np.where(inner, 0, np.where(outer, 1, NONE))).all()
    counts = [(each.points, each.kept, each.removed) for each in applied.by_hand.effects]
    assert counts == [
        (outer.sum(), 0, (outer & ~dynamic).sum()),
        (inner.sum(), (inner & dynamic).sum(), 0),
        (0, 0, 0),
    ]
    assert applied.by_hand.kept == (inner & dynamic).sum()
    assert "1 of 3 decisions match no point" in applied.by_hand.warning("review.json")


def test_many_decisions_give_the_same_as_one_by_one() -> None:
    points = random_points(9)
    random = np.random.default_rng(10)
    made = []
    for _ in range(40):
        low = random.uniform(-5, 4, 3)
        high = low + random.uniform(0, 2, 3)
        box = BoxRegion(tuple(low.tolist()), tuple(high.tolist()))
        made.append(ReviewDecision(str(random.choice(["static", "dynamic"])), box))  # type: ignore[arg-type]
    scan = scan_of(points)
    expected = np.full(len(points), NONE)
    for each in made:
        alone = Applied([each]).verdicts(scan)
        expected[alone != NONE] = alone[alone != NONE]
    assert (Applied(made).verdicts(scan) == expected).all()


def test_truth_follows_decisions_and_unlabelled_points_stay_so() -> None:
    labels = np.array([0, 1, 255, 0], np.uint8)
    scan = scan_of(np.zeros((4, 3)), labels=labels)
    found = Applied([ReviewDecision("dynamic", BOX)]).truth(scan).labels
    assert found is not None
    assert found.tolist() == [1, 1, 255, 1]
    undecided = Applied([ReviewDecision("undecided", BOX)]).truth(scan).labels
    assert undecided is not None
    assert undecided.tolist() == [255] * 4
    without = scan_of([[0, 0, 0], [9, 9, 9]])
    assert Applied([ReviewDecision("static", BOX)]).truth(without).labels is None
    made = Applied([ReviewDecision("static", BOX)], makes_truth=True).truth(without).labels
    assert made is not None
    assert made.tolist() == [Label.STATIC, Label.UNLABELLED]


def test_decisions_of_another_world_or_another_drive(tmp_path: Path) -> None:
    here = Drive.of(room(frames=5, rays=50))
    decisions = Decisions(tmp_path)
    piece = Piece(here[2].index, (-50.0, -50.0, -50.0), (50.0, 50.0, 50.0))
    seen = seen_in(here, 2)
    decisions.add(ReviewDecision("static", ObjectRegion("frame", (piece,)), seen=seen))
    assert (Applied.to(here, decisions).verdicts(here[2]) == 0).all()
    later = here.select("2:5")
    assert (Applied.to(later, decisions).verdicts(later[0]) == 0).all()
    away = Drive.of(Away(here))
    with pytest.raises(DataError, match=r"another world frame .* 30\.0 m away") as caught:
        Applied.to(away, decisions)
    assert "\n" not in str(caught.value)
    other = away.renamed("another")
    applied = Applied.to(other, decisions)
    applied.answers(other[2], np.zeros(len(other[2]), np.bool_))
    assert len(applied.by_hand.unmatched) == 1  # frame 2 of another drive


@dataclasses.dataclass(frozen=True)
class Away:
    """The same drive in another world frame."""

    whole: Any
    has_labels = False

    @property
    def name(self) -> str:
        return str(self.whole.name)

    @property
    def sensor(self) -> Any:
        return self.whole.sensor

    def __len__(self) -> int:
        return len(self.whole)

    def __getitem__(self, position: int) -> Scan:
        return self.whole[position].moved(np.array([30.0, 0.0, 0.0]))


def test_the_file_is_plain(tmp_path: Path) -> None:
    Decisions(tmp_path).add(ReviewDecision("static", BOX, reason="it is a pole"))
    plain = json.loads((tmp_path / "review.json").read_text())
    assert plain["schema"] == 1
    entry = plain["entries"][0]
    assert (entry["type"], entry["verdict"], entry["reason"]) == (
        "decision",
        "static",
        "it is a pole",
    )
    assert entry["region"] == {"type": "box", "low": [-1, -1, -1], "high": [1, 1, 1]}


def test_world_coordinates_survive_a_far_origin() -> None:
    far = np.array([512_000.0, 5_403_000.0, 380.0])
    pose = np.eye(4)
    pose[:3, 3] = far
    points = random_points(11, 500)
    sequence = Drive.of(ArraySequence.of([(points, pose)]))
    region = BoxRegion(tuple((far - 1).tolist()), tuple((far + 1).tolist()))
    applied = Applied([ReviewDecision("static", region)], sequence.origin)
    assert ((applied.verdicts(sequence[0]) == 0) == (np.abs(points) <= 1).all(1)).mean() > 0.999
