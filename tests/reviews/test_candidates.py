"""Places worth a decision: what they contain, and what deciding about them changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.worlds import room

import dynaviz as dv
from dynaviz.arrays import Bool
from dynaviz.contracts.scan import Label, Scan
from dynaviz.reviews.applying import NONE, Applied
from dynaviz.reviews.calibration import FEATURES, WEIGHTS, probability
from dynaviz.reviews.candidates import Candidate, candidates
from dynaviz.reviews.decisions import ReviewDecision
from dynaviz.reviews.survey import ReviewSurvey
from dynaviz.sources.datasets.convert import convert

ROOM = room(frames=8, rays=4000)
FAR = np.array([512_000.0, 5_403_000.0, 40.0])
ORIGIN = np.zeros(3)


def truth(scan: Scan) -> Bool:
    assert scan.labels is not None
    return np.asarray(scan.labels == Label.DYNAMIC)


def chosen(candidate: Candidate, scan: Scan) -> Bool:
    found = Applied([ReviewDecision("static", candidate.region)]).verdicts(scan) != NONE
    return np.asarray(found)


def test_a_mover_that_was_kept_and_a_wall_that_was_removed_are_candidates() -> None:
    kept = [np.zeros(len(scan), np.bool_) for scan in ROOM.scans]
    found = candidates(ROOM.scans, kept)
    assert {each.answered for each in found} == {"kept"}
    moving = sum(int(truth(scan).sum()) for scan in ROOM.scans)
    inside = max(
        sum(int((chosen(each, scan) & truth(scan)).sum()) for scan in ROOM.scans) for each in found
    )
    assert inside > moving / 2
    removed = [np.ones(len(scan), np.bool_) for scan in ROOM.scans]
    assert {each.answered for each in candidates(ROOM.scans, removed)} == {"removed"}


def test_the_points_of_a_candidate_are_those_that_its_region_contains() -> None:
    for labels in (np.zeros, np.ones):
        answers = [labels(len(scan), np.bool_) for scan in ROOM.scans]
        found = candidates(ROOM.scans, answers)
        assert found
        assert [each.number for each in found] == list(range(1, len(found) + 1))
        assert [each.expected for each in found] == sorted(e.expected for e in found)[::-1]
        for each in found:
            times = {piece.time for piece in each.region.pieces}  # between them it is on its way
            inside = [
                chosen(each, scan) & (scan.index in times or scan.stamp_ns in times)
                for scan in ROOM.scans
            ]
            assert sum(int(rows.sum()) for rows in inside) == pytest.approx(
                each.points, rel=0.05, abs=5
            )
            frames = [k for k, rows in enumerate(inside) if rows.any()]
            assert each.first_frame <= min(frames)
            assert max(frames) <= each.last_frame


def test_candidates_do_not_need_truth_and_are_the_same_far_away() -> None:
    answers = [truth(scan) for scan in ROOM.scans]
    here = candidates(ROOM.scans, answers)
    blind = candidates([scan.without_truth() for scan in ROOM.scans], answers)
    far = candidates(ROOM.scans, answers, FAR)
    for one, two, three in zip(here, blind, far, strict=True):
        assert one.sentence == two.sentence
        assert one.wrong == three.wrong
        np.testing.assert_allclose(np.array(three.low) - FAR, one.low, atol=1e-6)


def test_a_probability_grows_with_what_speaks_for_an_error() -> None:
    none = dict.fromkeys(FEATURES, 0.0)
    assert set(WEIGHTS) == {"kept", "removed"}
    assert probability("kept", {**none, "moved": 2.0}) > probability("kept", none)
    assert 0 < probability("removed", none) < 1


def test_a_survey_counts_what_writing_the_labels_changes() -> None:
    answers = [truth(scan) for scan in ROOM.scans]
    survey = ReviewSurvey(ROOM.scans, answers, ORIGIN)
    decisions = [ReviewDecision("static", survey.candidates[0].region)]
    decisions += [ReviewDecision("dynamic", each.region) for each in survey.candidates[1:4]]
    applied = Applied(decisions)
    for scan, dynamic in zip(ROOM.scans, answers, strict=True):
        applied.answers(scan, dynamic)
    found = survey.by_hand(decisions)
    assert found.kept == applied.by_hand.kept
    assert found.removed == applied.by_hand.removed
    assert [each.points for each in found.effects] == [e.points for e in applied.by_hand.effects]


def test_what_is_around_a_place_is_what_the_scans_have_there() -> None:
    answers = [truth(scan) for scan in ROOM.scans]
    survey = ReviewSurvey(ROOM.scans, answers, ORIGIN)
    first = survey.candidates[0]
    low = np.array(first.low) - 1
    high = np.array(first.high) + 1
    seen = survey.around(low, high, first.region, [ReviewDecision("static", first.region)])
    assert (seen.chosen == (seen.verdicts != NONE)).all()
    for frame, scan in enumerate(ROOM.scans):
        inside = ((scan.points >= low) & (scan.points <= high)).all(1)
        assert (seen.frame == frame).sum() == inside.sum()
        assert (seen.frame[seen.chosen] == frame).sum() == chosen(first, scan).sum()


def test_a_review_lists_candidates_and_decides_about_them(tmp_path: Path) -> None:
    convert(ROOM, tmp_path / "room")
    dv.run("octomap", tmp_path / "room", out=tmp_path / "run", record="none", threads=1)
    review = dv.review(tmp_path / "run")
    first = review.candidates[0]
    verdict = "dynamic" if first.answered == "kept" else "static"
    made = review.decide(first, verdict)
    assert made.key == first.key
    assert made.answered == first.answered
    before = dv.review(tmp_path / "run", review=tmp_path / "none.json").labels
    changed = sum(int((a != b).sum()) for a, b in zip(before, review.labels, strict=True))
    assert changed == pytest.approx(first.points, rel=0.05)
    again = dv.review(tmp_path / "run").candidates[0]
    assert again.key == first.key  # a decision does not change the questions


def test_a_candidate_is_one_line_in_a_session() -> None:
    (first, *_) = candidates(
        ROOM.scans, [np.zeros(len(scan.points), np.bool_) for scan in ROOM.scans]
    )
    assert repr(first) == f"<Candidate 1. {first.sentence}>"
    assert repr(first.region) == f"<ObjectRegion in {len(first.region.pieces)} frames>"
