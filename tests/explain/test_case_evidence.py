"""Sentences about cases follow from the stored evidence, for every method and each cause that it
gives.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from statistics import median

import pytest
from helpers.worlds import room

import dynaviz as dv
from dynaviz.contracts import registry
from dynaviz.contracts.evidence import TESTS
from dynaviz.contracts.method import Cause
from dynaviz.explain.case_evidence import evidence_of, evidence_text, flip
from dynaviz.explain.deciding import decided_by, deciding_scans, scan_terms
from dynaviz.explain.document import cause_at
from dynaviz.explain.point_ledger import PointLedger, TermValue
from dynaviz.explain.strip import strip
from dynaviz.spatial.surface import GRAZING
from dynaviz.views.read.reader import RunRecording

METHODS = sorted(registry.loadable("methods"))


@pytest.fixture(scope="module", params=METHODS)
def recording(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> RunRecording:
    scans = room(6, 1500)
    scans = replace(scans, sensor=replace(scans.sensor, rings=24, elevation=(-60.0, 60.0)))
    folder = tmp_path_factory.mktemp("evidence")
    dv.run(request.param, scans, out=folder)
    return RunRecording(folder / "run.rrd")


def cases(recording: RunRecording) -> list[tuple[int, tuple[PointLedger, ...]]]:
    assert recording.result is not None
    listed = range(1, len(recording.result.failures[:20]) + 1)
    return [(number, ledgers) for number in listed if (ledgers := recording.ledgers(number))]


def test_the_costliest_case_has_evidence_and_its_points_are_stored_with_their_answers(
    recording: RunRecording,
) -> None:
    assert recording.result is not None
    answers = {each.frame: each for each in recording.answers()}
    assert not recording.result.failures or recording.ledgers(1)
    for number, ledgers in cases(recording):
        case = recording.result.failures[number - 1]
        for ledger in ledgers:
            stored = answers[ledger.frame]
            assert ledger.frame == case.worst_frame
            assert ledger.removed == stored.dynamic[ledger.point] == (case.kind == "false_positive")
            assert ledger.reason == recording.reasons[stored.reasons[ledger.point]]
            assert ledger.verdict == ledger.removed
            assert ledger.wrong


def test_the_sentence_of_a_case_quotes_a_reason_of_its_points(recording: RunRecording) -> None:
    assert recording.result is not None
    for case in recording.result.failures:
        meanings = [
            reason.meaning.partition(": ")[2]
            for reason in recording.reasons
            if reason.name in case.reasons
        ]
        assert any(case.sentence.lower().endswith(f"{meaning.lower()}.") for meaning in meanings), (
            case.sentence
        )


def test_the_numbers_of_the_evidence_are_those_of_the_ledgers(recording: RunRecording) -> None:
    for _, ledgers in cases(recording):
        found = evidence_of(ledgers)
        assert found.hit == median(
            sum(entry.hits > 0 for entry in ledger.entries) for ledger in ledgers
        )
        assert found.crossed == median(
            sum(entry.crossed > 0 for entry in ledger.entries) for ledger in ledgers
        )
        assert found.text.startswith("Removed: " if found.removed else "Kept: ")
        ended = f"those of {found.hit:g} ended in it" if found.hit else "none ended in it"
        assert ended in found.text
        seen = (
            f"rays of {found.crossed:g} of {found.searched} scans crossed"
            if found.crossed
            else "no rays of"
        )
        assert seen in found.text
        assert found.deciding is not None
        for term in found.deciding.terms:
            assert term.holds == found.removed
            if (
                term.value is not None
                and math.isfinite(term.value)
                and not math.isnan(term.threshold)
            ):
                assert TESTS[term.test](term.value, term.threshold) == found.removed


def test_a_case_and_its_points_have_one_cause(
    recording: RunRecording,
) -> None:
    meanings = {reason.name: reason.meaning.partition(": ")[2] for reason in recording.reasons}
    assert recording.result is not None
    for number, ledgers in cases(recording):
        case = recording.result.failures[number - 1]
        assert {cause_at(recording.result, ledger) for ledger in ledgers} == {case.cause}
        assert case.reason is not None
        assert case.sentence.lower().endswith(f"{meanings[case.reason].lower()}.")
        deciding = [ledger for ledger in ledgers if ledger.reason.name == case.reason]
        text = evidence_text(ledgers, case)
        assert (
            text.startswith(evidence_of(deciding).text)
            if deciding
            else "another reason decides" in text
        )
        stated = (
            f"The rays that ended on it met {100 * (case.grazed or 0):.0f} % of its surface at "
            f"less than {GRAZING:g}°."
        )
        assert evidence_text(ledgers, case).endswith(stated) == (case.grazed is not None)


# what a reason states, by the ledger alone
CLAIMS: dict[str, dict[str, Callable[[PointLedger], bool]]] = {
    "octomap": {
        "crossed_by_rays": lambda ledger: any("crossed" in entry.steps for entry in ledger.entries),
        "hit_more_than_missed": lambda ledger: any(
            "crossed" in entry.steps for entry in ledger.entries
        ),
        "never_crossed": lambda ledger: (
            not any("crossed" in entry.steps for entry in ledger.entries)
        ),
        "ground_plane": lambda ledger: not _holds(ledger, "on the ground plane"),
        "noise_cell": lambda ledger: any("hit" in entry.steps for entry in ledger.entries),
    },
    "dufomap": {
        "void_seen": lambda ledger: 2.0 in _values(ledger, "saw"),
        "beside_unknown": lambda ledger: (
            1.0 in _values(ledger, "saw") and 2.0 not in _values(ledger, "saw")
        ),
        "never_crossed": lambda ledger: _values(ledger, "saw") <= {0.0},
    },
    "dynablox": {
        "never_free": lambda ledger: 1.0 not in _values(ledger, "ever-free"),
        "ever_free": lambda ledger: _holds(ledger, "ever-free when it came"),
        "ever_free_small_cluster": lambda ledger: _holds(ledger, "ever-free when it came"),
        "beside_ever_free": lambda ledger: not _holds(ledger, "ever-free when it came"),
        "revoked": lambda ledger: 1.0 in _values(ledger, "ever-free"),
    },
    "beautymap": {
        "always_seen": lambda ledger: _values(ledger, "outcome") <= {0.0},
        "near_sensor": lambda ledger: 1.0 in _values(ledger, "outcome"),
        "ground_not_seen": lambda ledger: 2.0 in _values(ledger, "outcome"),
        "above_highest_seen": lambda ledger: 3.0 in _values(ledger, "outcome"),
        "above_view": lambda ledger: 4.0 in _values(ledger, "outcome"),
        "ground_slice": lambda ledger: 5.0 in _values(ledger, "outcome"),
        "overhang": lambda ledger: (
            6.0 in _values(ledger, "outcome") or _holds(ledger, "removed slice above it")
        ),
        "ray_blocked": lambda ledger: 7.0 in _values(ledger, "outcome"),
        "not_in_scan": lambda ledger: _rule(ledger, "slice missed"),
        "above_fine_ground": lambda ledger: _rule(ledger, "above the ground"),
        "fine_ground": lambda ledger: _holds(ledger, "removed slice above it"),
    },
    "erasor": {
        "map_not_higher": lambda ledger: not _holds(ledger, "ratio of heights"),
        "ground_of_flagged_bin": lambda ledger: not _holds(ledger, "ground of its bin"),
        "bin_ratio": lambda ledger: _holds(ledger, "ratio of heights"),
        "low_bin": lambda ledger: _holds(ledger, "ratio of heights"),
        "too_few_points": lambda ledger: not _holds(ledger, "scan points in its bin"),
        "outside_height_band": lambda ledger: not _values(ledger, "scan"),
    },
    "removert": {
        "nearer_than_scan_at_res_1": lambda ledger: ledger.rules[0].holds,
        "nearer_than_scan_at_res_2": lambda ledger: (
            [rule.holds for rule in ledger.rules[:2]] == [False, True]
        ),
        "nearer_than_scan_at_res_3": lambda ledger: (
            [rule.holds for rule in ledger.rules[:3]] == [False, False, True]
        ),
        "agrees": lambda ledger: not any(rule.holds for rule in ledger.rules),
        "hidden": lambda ledger: not any(rule.holds for rule in ledger.rules),
    },
    "hmm_mos": {
        "warm_up": lambda ledger: not _holds(ledger, "scans so far"),
        "long_occupied": lambda ledger: (
            1.0 in _values(ledger, "state") and not _holds(ledger, "summed score")
        ),
        "unknown_around": lambda ledger: _value(ledger, "summed score") == 0,
        "below_threshold": lambda ledger: (
            0 < _value(ledger, "summed score") <= _threshold(ledger, "summed score")
        ),
        "above_threshold": lambda ledger: _rule(ledger, "above"),
        "carried": lambda ledger: _rule(ledger, "carried"),
        "beside_dynamic": lambda ledger: _rule(ledger, "next to dynamic"),
    },
    "freedom": {
        "never_seen_through": lambda ledger: _values(ledger, "passes") <= {0.0},
        "seen_too_rarely": lambda ledger: (
            max(_values(ledger, "passes")) > 0 and 27 not in _values(ledger, "clear")
        ),
        "beside_unclear": lambda ledger: (
            max(_values(ledger, "passes")) > 0 and 27 not in _values(ledger, "clear")
        ),
        "in_free_space": lambda ledger: _rule(ledger, "level"),
        "grown_in_scan": lambda ledger: _rule(ledger, "level"),
        "turned_free": lambda ledger: _rule(ledger, "level"),
        "grown_in_map": lambda ledger: _rule(ledger, "level"),
        "retaken": lambda ledger: not _rule(ledger, "level"),
        "revoked": lambda ledger: 27 in _values(ledger, "clear"),
    },
    "seethrough": {
        "low": lambda ledger: not _holds(ledger, "height above the ground"),
        "never_clear": lambda ledger: _value(ledger, "evidence of its voxel") <= 0,
        "too_little_clear": lambda ledger: (
            _value(ledger, "evidence of its voxel") > 0 and not _rule(ledger, "place")
        ),
        "seen_through": lambda ledger: _rule(ledger, "place"),
        "followed": lambda ledger: _rule(ledger, "place"),
        "foot": lambda ledger: _rule(ledger, "foot") or _rule(ledger, "empty foot"),
        "high": lambda ledger: not _holds(ledger, "more than 4.5 m above the ground"),
    },
}


def _values(ledger: PointLedger, name: str) -> set[float]:
    return {value for entry in ledger.entries if (value := entry.values.get(name)) is not None}


def _rule(ledger: PointLedger, name: str) -> bool:
    return next(rule.holds for rule in ledger.rules if rule.name == name)


def _term(ledger: PointLedger, name: str) -> TermValue:
    return next(term for rule in ledger.rules for term in rule.terms if term.name == name)


def _holds(ledger: PointLedger, name: str) -> bool:
    return _term(ledger, name).holds


def _value(ledger: PointLedger, name: str) -> float:
    value = _term(ledger, name).value
    assert value is not None
    return value


def _threshold(ledger: PointLedger, name: str) -> float:
    return _term(ledger, name).threshold


def test_what_a_reason_states_follows_from_the_ledger(recording: RunRecording) -> None:
    method = str(recording.properties["method"]).partition("_g")[0]
    for _, ledgers in cases(recording):
        for ledger in ledgers:
            if ledger.reason.cause in (
                None,
                Cause.OUT_OF_RANGE,
            ):  # it states nothing that a scan contributed
                continue
            assert CLAIMS[method][ledger.reason.name](ledger), (ledger.reason.name, ledger.point)
            rule = decided_by(ledger)
            assert rule is not None
            assert rule.holds == ledger.removed
            if text := flip(ledger):
                assert "threshold" in text


def test_sums_of_log_odds_follow_from_their_steps(recording: RunRecording) -> None:
    found = [
        (ledger, quantity)
        for _, ledgers in cases(recording)
        for ledger in ledgers
        for quantity in ledger.quantities
        if quantity.steps
    ]
    assert bool(found) == str(recording.properties["method"]).startswith("octomap")
    logit = {
        name: math.log(p / (1 - p))
        for name, p in recording.parameters.items()
        if name.startswith(("prob_", "clamp_"))
    }
    for ledger, quantity in found:
        total, (low, high) = 0.0, (logit[name] for name in quantity.limits)
        for entry in ledger.entries:
            for name, parameter in quantity.steps:
                if name in entry.steps:
                    total = min(max(total + logit[parameter], low), high)
            value = entry.values[quantity.name]
            assert value == pytest.approx(total, abs=1e-5)


def test_the_page_draws_each_scan_once(recording: RunRecording) -> None:
    for _, ledgers in cases(recording):
        drawn = strip(ledgers)
        frames = [scan["frame"] for scan in drawn["scans"]]
        assert frames == sorted({entry.frame for ledger in ledgers for entry in ledger.entries})
        assert all(0 <= scan[share] <= 1 for scan in drawn["scans"] for share in ("hit", "crossed"))


def test_a_rule_that_one_scan_fulfils_follows_from_the_numbers_of_the_scans(
    recording: RunRecording,
) -> None:
    """The stored terms of single scans give the verdict, and the numbers that are quoted."""
    for _, ledgers in cases(recording):
        for ledger in ledgers:
            for rule in ledger.rules:
                if rule.frame is None:
                    continue
                by_frame = {
                    entry.frame: terms
                    for entry in ledger.entries
                    if (terms := scan_terms(entry, rule))
                }
                held = [all(term.holds for term in terms) for terms in by_frame.values()]
                assert rule.holds == any(held)
                if rule.frame in by_frame:
                    assert [(t.value, t.holds) for t in by_frame[rule.frame]] == [
                        (t.value, t.holds) for t in rule.terms
                    ]


def test_a_kept_point_quotes_the_scan_that_failed_by_least(recording: RunRecording) -> None:
    for _, ledgers in cases(recording):
        for ledger in ledgers:
            rule = decided_by(ledger)
            if ledger.removed or rule is None or rule.frame is None:
                continue
            most = max(
                (
                    sum(t.holds for t in terms)
                    for e in ledger.entries
                    if (terms := scan_terms(e, rule))
                ),
                default=0,
            )
            assert sum(term.holds for term in rule.terms) >= most


def test_deciding_scans_add_up_to_the_ledger(recording: RunRecording) -> None:
    """Each scan is in one row at most, in order; changes in rows add up to those of the scans."""
    for _, ledgers in cases(recording):
        for ledger in ledgers:
            rows = deciding_scans(ledger)
            frames = [frame for row in rows for frame in row.frames]
            assert frames == sorted(frames)
            assert any(row.frames[0] == ledger.frame == row.frames[1] for row in rows)
            assert sum(row.scans for row in rows) <= len(ledger.entries)
            inside = [
                entry
                for entry in ledger.entries
                if any(row.frames[0] <= entry.frame <= row.frames[1] for row in rows)
            ]
            assert sum(row.hits for row in rows) <= sum(entry.hits for entry in inside)
            verdicts = [entry.removed for entry in ledger.entries if entry.removed is not None]
            turned = [row.removed for row in rows if row.removed is not None]
            if verdicts:
                assert (turned[-1] if turned else False) == verdicts[-1]
