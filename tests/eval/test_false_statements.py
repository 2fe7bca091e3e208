"""Statements that were once false: each is asked again, of the run that made it."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest

import dynaviz as dv
from dynaviz.explain.deciding import deciding_scans
from dynaviz.runs.run import Run, open_run
from dynaviz.scores.failure_case import FailureCase

pytestmark = pytest.mark.slow

DEMO = "simulate:demo"
KITTI = "kitti_tracking/training/velodyne/0011"
NEVER = "no ray through most of it"


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Run]:
    folder = tmp_path_factory.mktemp("runs")

    @cache
    def made(method: str, sequence: str = DEMO, record: Any = "none") -> Run:
        at = folder / str(len(list(folder.iterdir())))
        dv.run(method, sequence, out=at, record=record, maps=False)
        return open_run(at)

    return made


def kept(run: Run, what: str) -> FailureCase:
    """The case of an object."""
    return next(
        case
        for case in run.result.failures
        if case.kind == "false_negative" and f"{case.what} {case.instance or ''}".find(what) >= 0
    )


@pytest.mark.parametrize("method", ["dufomap", "beautymap", "octomap", "erasor"])
def test_a_car_that_stands_is_called_that_by_every_method(runs, method):
    """It was "nothing behind", "standing too long" or "shared cell", by method."""
    case = kept(runs(method), "moving car 1")
    assert case.cause == "stood there"
    assert case.behaviour == "stood still until the end"
    assert case.looks.hit >= 4 * case.looks.through


def test_a_truck_that_was_seen_through_did_not_stand_there(runs):
    """It was "hits outweigh misses" with 5 hits and 16 crossings."""
    case = kept(runs("octomap"), "moving truck 4")
    assert case.cause == "seen through before it came"
    assert case.looks.throughs > 2 * case.looks.hits
    assert case.behaviour == "passed by"


@pytest.mark.parametrize("what", ["moving truck 4", "moving person 10", "moving person 20"])
def test_what_rays_went_through_is_not_between_rays(runs, what):
    """It was "sparse rings"; the evidence was there, and the method demands more."""
    case = kept(runs("dufomap"), what)
    assert case.cause.startswith("seen through")
    assert case.looks.throughs >= 10
    assert case.looks.seen_through >= 90


def test_a_mover_is_in_the_cell_only_if_one_is_near(runs):
    """All 33 holes of ERASOR were "shared cell"."""
    holes = [case for case in runs("erasor").result.failures if case.kind == "false_positive"]
    assert len(holes) > 20
    for case in holes:
        if "mover" in case.cause:
            assert case.cause.startswith(NEVER)
            near = case.looks.mover
            assert ("in its cell" in case.cause) == (near is not None and near <= 0.5)
            assert ("no mover near" in case.cause) == (near is None or near > 3)


def test_a_kept_point_of_erasor_has_the_terms_that_failed_scan_by_scan(runs):
    """It was "0.281, not below 0.2", although the ratio was lower in another scan."""
    run = runs("erasor", record="errors")
    listed = enumerate(run.result.failures[:20], 1)
    kept_cases = [number for number, case in listed if case.kind == "false_negative"]
    ledgers = [each for number in kept_cases for each in run.recording.ledgers(number)]
    texts = [row.text for each in ledgers for row in deciding_scans(each)]
    failed = [text for text in texts if re.search(r"points in its bin \d+ of \d+", text)]
    assert len(failed) > 10


@pytest.mark.filterwarnings("ignore:.*poses drift")
def test_a_surface_far_from_movers_has_none_in_its_cell(runs, real_data):
    """Surfaces 16 m from any dynamic point were "shared cell"."""
    run = runs("seethrough", str(real_data / KITTI))
    drive = dv.open(real_data / KITTI)
    scans = [drive[k] for k in range(len(drive))]
    movers = [scan.points[scan.labels == 1] for scan in scans]
    far = 0
    for case in run.result.failures:
        if case.kind == "false_positive":
            near = np.concatenate(movers[case.first_frame : case.last_frame + 1])
            outside = np.maximum(np.maximum(case.low - near, near - case.high), 0)
            if np.linalg.norm(outside, axis=1).min(initial=np.inf) > 3:
                far += 1
                assert "a mover" not in case.cause
    assert far > 20


@pytest.mark.filterwarnings("ignore:.*poses drift")
def test_what_an_object_hid_itself_does_not_lack_a_background(runs, real_data):
    """Car 1 was "nothing behind": 91 % of the looks are hidden by the car itself."""
    case = kept(runs("seethrough", str(real_data / KITTI)), "car 1")
    assert case.looks.hidden > 80
    assert case.looks.outside < 5
    assert case.looks.seen_through >= 50
    assert case.cause == "seen through, but the method demands more"
    assert "hit by 0 other scans, seen through by 1" in case.sentence


def test_behaviour_is_that_of_the_frames_of_the_case(runs, real_data):
    """Bus 51 "stood still until the end" in frames in which it moves 2 m each."""
    for method in ("seethrough", "dufomap"):
        bus = kept(runs(method, str(real_data / "nuscenes")), "rigid bus 51")
        assert bus.behaviour == "came to a stop"
        assert bus.moved > 5


def test_an_object_is_one_row(runs, real_data):
    """Of 20 cases, 12 were bus 51."""
    cases = runs("seethrough", str(real_data / "nuscenes")).result.failures
    numbers = [case.instance for case in cases if case.kind == "false_negative" and case.instance]
    assert len(numbers) == len(set(numbers)) > 5
