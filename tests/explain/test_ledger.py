"""The ledger of a point: what each scan contributed, and the rules that decided.

Checked by hand and by geometry.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from helpers.worlds import pose, room

from dynaviz import api
from dynaviz.contracts import registry
from dynaviz.contracts.evidence import Asked, Evidence, Quantity, Rule, Term, voxels_around
from dynaviz.contracts.method import Context, Labels, MethodInfo, Reason
from dynaviz.contracts.scan import Scan
from dynaviz.engine.loop import RunSpec, execute
from dynaviz.errors import DataError, PluginError, UsageError
from dynaviz.explain.ledger import Ledger
from dynaviz.explain.repeat import repeat
from dynaviz.runs.explanation import explain, why
from dynaviz.scores.result import Result
from dynaviz.sources.summary import summarize
from dynaviz.testing import InMemory

HIT, MISS = np.log(0.7 / 0.3), np.log(0.4 / 0.6)


@dataclass(frozen=True)
class NoParams:
    pass


class PassedOnce:
    """Removes all points if any scan had a point beyond x = 3, or the last scan one below x = 1."""

    info = MethodInfo(
        "passed_once",
        "Passed once",
        "none",
        (Reason("kept", "kept: no"), Reason("gone", "removed: so")),
    )
    Params = NoParams
    lie = False

    def __init__(self, params: Any):
        self.params = params

    def begin(self, context: Context) -> None:
        self.farthest, self.latest, self.lowest = 0.0, np.nan, np.nan

    def observe(self, scan: Scan) -> None:
        self.latest, self.lowest = float(scan.points[:, 0].max()), float(scan.points[:, 0].min())
        self.farthest = max(self.farthest, self.latest)

    def label(self, scan: Scan) -> Labels:
        dynamic = np.full(len(scan), (self.farthest > 3 or self.lowest < 1) != self.lie)
        return Labels(dynamic, dynamic.astype(np.uint8))

    def evidence(self, asked: Asked) -> Evidence:
        one = np.ones(len(asked.rows))
        beyond = (
            Term("latest", one * self.latest, ">", 3, "m"),
            Term("lowest", one * self.lowest, ">", 0, "m"),
        )
        far = Rule("far", beyond, lasting=True)
        low = Rule("low", (Term("lowest", one * self.lowest, "<", 1, "m"),))
        total = Quantity("farthest", one * self.farthest, "m", total=True)
        return Evidence(voxels_around(asked.points, 1.0), (total,), (far, low))


def line(index: int, *xs: float) -> Scan:
    """Points on a line along x, seen from its start."""
    points = np.array([[x, 0.5, 0.5] for x in xs], np.float32)
    return Scan(index, points, pose(0.0, 0.5, 0.5), labels=np.zeros(len(xs), np.uint8))


SCANS = InMemory(
    [line(7, 2.5, 2.0), line(8, 3.5, 1.5), line(9, 2.25, 1.75), line(10, 2.75, 1.25)], "line"
)


def ledger(
    scans: InMemory, frame: int, *points: int, method: type = PassedOnce, online: bool = False
) -> Any:
    kept = Ledger({frame: points})
    execute(RunSpec(method(NoParams()), scans, NoParams(), online=online), [kept])
    return kept.ledgers[frame]


def test_entries_have_the_rays_the_changes_and_the_verdict_so_far() -> None:
    (found,) = ledger(SCANS, 0, 0)
    assert (found.frame, found.index, found.point, found.truth) == (0, 7, 0, "static")
    assert found.removed
    assert found.verdict
    assert found.wrong
    assert found.reason.name == "gone"
    assert [(e.frame, e.index, e.hits, e.crossed, e.removed) for e in found.entries] == [
        (0, 7, 2, 0, False),
        (1, 8, 0, 1, True),
        (2, 9, 1, 0, True),
        (3, 10, 1, 0, True),
    ]
    assert [dict(e.changes) for e in found.entries] == [
        {"farthest": 2.5},
        {"farthest": 1.0},
        {},
        {},
    ]
    assert [e.range_m for e in found.entries] == [2.5] * 4
    assert [e.behind_m for e in found.entries] == [None, 1.0, None, None]
    assert [e.holds for e in found.entries] == [(), ("far",), (), ()]


def test_a_lasting_rule_keeps_the_numbers_of_the_scan_that_fulfilled_it() -> None:
    (found,) = ledger(SCANS, 2, 0)
    far, low = found.rules
    assert (far.holds, far.frame, [t.value for t in far.terms]) == (True, 1, [3.5, 1.5])
    assert (low.holds, low.frame, [(t.value, t.holds) for t in low.terms]) == (
        False,
        None,
        [(1.25, False)],
    )


def test_online_the_ledger_ends_with_the_frame_of_the_point() -> None:
    (found,) = ledger(SCANS, 0, 0, online=True)
    assert not found.removed
    assert found.searched == len(found.entries) == 1
    (far, _) = found.rules
    assert (far.holds, far.frame) == (False, 0)  # the scan that came closest


def test_a_wall_has_an_angle() -> None:
    scans = room(frames=2, rays=2000)
    side = np.flatnonzero(np.abs(scans[0].points[:, 1] - 6) < 1e-3)
    row = int(side[np.argmin(np.abs(scans[0].points[side] - (6, 6, 1)).sum(1))])
    (found,) = ledger(scans, 0, row)
    x, y, _ = scans[0].points[row]
    assert found.entries[0].angle_deg == pytest.approx(np.degrees(np.arctan2(y, x)), abs=2)


def test_evidence_that_contradicts_the_label_is_an_error() -> None:
    with pytest.raises(
        PluginError, match="passed_once: its evidence contradicts the label of point 1 of frame 3"
    ):
        ledger(SCANS, 3, 1, method=type("Liar", (PassedOnce,), {"lie": True}))


@pytest.mark.parametrize(
    ("frame", "point", "problem"), [(4, 0, "frame 4: the run has"), (0, 2, "point 2: frame 0 has")]
)
def test_frames_and_points_that_do_not_exist(frame: int, point: int, problem: str) -> None:
    with pytest.raises(UsageError, match=problem):
        ledger(SCANS, frame, point)


def test_the_log_odds_of_octomap_are_its_hits_and_misses() -> None:
    scans = room(rays=1500)
    result = api.run("octomap", scans)
    answers = explain(result, {3: range(0, 1500, 50)}, sequence=scans)[3]
    steps = 0
    for answer in answers:
        assert answer.ledger.verdict == answer.ledger.removed
        for entry in answer.ledger.entries:
            before = entry.values["log-odds"] - entry.changes.get("log-odds", 0.0)
            expected = min(
                before + MISS * (entry.crossed > 0) + HIT * (entry.hits > 0), np.log(0.97 / 0.03)
            )
            assert entry.values["log-odds"] == pytest.approx(expected, abs=1e-5)
            steps += 1
    assert steps > 50


@pytest.mark.parametrize("name", ["octomap", "octomap_g", "dufomap", "seethrough"])
def test_replaying_only_what_the_points_need_gives_the_ledgers_of_a_whole_run(name: str) -> None:
    scans, asked = room(frames=8, rays=1500), {2: range(0, 1500, 90), 5: [7]}
    method = registry.load("methods", name)
    whole = Ledger(asked)
    run = RunSpec(method(method.Params()), scans, method.Params())
    execute(run, [whole])
    found = repeat(replace(run, summary=summarize(scans)), list(asked.items()))
    assert found.ledgers == [whole.ledgers[2], whole.ledgers[5]]
    assert found.seconds > 0
    assert found.labels_sha256 is None
    assert repeat(run, list(asked.items()), whole=True).ledgers == found.ledgers


@pytest.mark.parametrize(
    ("name", "online"),
    [("seethrough", False), ("erasor", False), ("dynablox", False), ("removert", True)],
)
def test_methods_that_decide_in_different_places_explain_a_run(name: str, online: bool) -> None:
    scans = room(frames=4, rays=300)
    scans = replace(scans, sensor=replace(scans.sensor, rings=24, elevation=(-60.0, 60.0)))
    result = api.run(name, scans, online=online)
    answer = why(result, 2, 100, sequence=scans)  # raises if the verdict differs from the label
    assert answer.ledger.verdict is not None
    assert answer.ledger.rules
    assert answer.note == ""
    json.dumps(answer.to_dict(), allow_nan=False)


def test_a_different_sequence_is_an_error() -> None:
    result = api.run("octomap", room(frames=2, rays=300))
    with pytest.raises(DataError, match="is from a different sequence than the 3 frames of room"):
        why(result, 0, 0, sequence=room(frames=3, rays=300))
    assert why(result, 0, 0).ledger.searched == 2  # its sequence is still in memory
    loaded = Result.from_dict(result.to_dict(), "result.json")
    with pytest.raises(
        UsageError,
        match=r"from data in memory, which only the process .* dynaviz.explore\(result\)",
    ):
        why(loaded, 0, 0)
    with pytest.raises(
        UsageError, match=r"does not state where its sequence came from\. Give the sequence"
    ):
        why(replace(loaded, origin=None), 0, 0)
