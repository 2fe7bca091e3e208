"""Causes of cases at the bounds of each criterion, and the sentences about them."""

import msgspec
import numpy as np
import pytest

from dynaviz.contracts.looks import CountedLooks, Look
from dynaviz.contracts.method import Cause as Word
from dynaviz.scores.failure_case import FailureCase
from dynaviz.scores.looks import CaseLooks, Ceiling, Estimate
from dynaviz_eval.attribution import sentence, shape
from dynaviz_eval.cases import Cases, summed
from dynaviz_eval.causes import MeasuredCause as Why
from dynaviz_eval.causes import cause_of, looks_of, near_cause

CASE = summed(np.empty(0, Cases(1, np.inf).kind)).dtype


def looks(**values) -> CaseLooks:
    none = {"hit": 0, "through": 0, "hidden": 0, "between": 0, "outside": 0}
    few = {"points": 64, "seen_through": 0, "hits": 2, "throughs": 0, "surface": 0}
    return CaseLooks(**{**none, **few, **values})


@pytest.mark.parametrize(
    ("values", "word", "expected"),
    [
        ({"hit": 40, "hidden": 30, "between": 30}, None, Why.STOOD),
        ({"hit": 30, "hidden": 40, "between": 30}, None, Why.HIDDEN),
        ({"hit": 30, "hidden": 30, "between": 40}, None, Why.BETWEEN),
        ({"outside": 100}, None, Why.OUTSIDE),
        ({}, None, Why.UNKNOWN),
        ({"hit": 10, "through": 2, "seen_through": 100}, None, Why.STOOD),
        ({"hit": 10, "through": 3, "seen_through": 100}, None, Why.OUTWEIGHED),
        ({"hit": 10, "through": 3, "seen_through": 49.9}, None, Why.STOOD),
        ({"hit": 10, "through": 10, "seen_through": 50}, None, Why.OUTWEIGHED),
        (
            {"hit": 9, "through": 10, "seen_through": 50, "before": 50},
            None,
            Why.FORGOTTEN,
        ),
        ({"hit": 9, "through": 10, "seen_through": 50, "before": 49}, None, Why.DEMAND),
        ({"through": 9, "seen_through": 50, "before": 90, "hits": 0}, None, Why.DEMAND),
        ({"through": 9, "seen_through": 50}, Word.TAKEN_FOR_GROUND, Why.GROUND),
        ({"through": 9, "seen_through": 50}, Word.HEIGHT_LIMIT, Why.LIMIT),
        ({"through": 9, "seen_through": 50}, Word.OUT_OF_RANGE, Why.LIMIT),
        ({"hidden": 9, "seen_through": 49}, Word.OUT_OF_RANGE, Why.HIDDEN),
        ({"through": 9, "seen_through": 50}, Word.SPARSE_RINGS, Why.DEMAND),
    ],
)
def test_causes_of_kept_points(values, word, expected):
    assert cause_of("false_negative", looks(**values), word) is expected


SEEN = {"hit": 10, "through": 10, "seen_through": 50}


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"hit": 5, "seen_through": 49.9, "mover": 0.5}, Why.NO_RAY_CELL),
        ({"hit": 5, "seen_through": 49.9, "mover": 0.51}, Why.NO_RAY_MOVER),
        ({"hit": 5, "mover": 3.0}, Why.NO_RAY_MOVER),
        ({"hit": 5, "mover": 3.01}, Why.NO_RAY),
        ({"hit": 5}, Why.NO_RAY),
        ({"between": 5}, Why.UNKNOWN),
        (SEEN | {"hits": 1}, Why.BRIEF),
        (SEEN | {"hits": 1.5, "grazing": 50.1, "surface": 25}, Why.GRAZING),
        (SEEN | {"hits": 1.5, "grazing": 50.1, "surface": 24.9}, Why.THIN),
        (SEEN | {"grazing": 50, "surface": 50, "close": 50}, Why.POSES),
        (SEEN | {"grazing": 50, "surface": 49, "close": 50}, Why.THIN),
        (SEEN | {"surface": 50, "close": 49}, Why.THIN),
        (SEEN | {"before": 30, "after": 20}, Why.THIN),
        (SEEN | {"before": 30, "after": 21}, Why.OTHER_TIMES),
    ],
)
def test_causes_of_removed_points(values, expected):
    assert cause_of("false_positive", looks(**values), Word.GRAZING_RAYS) is expected


def test_without_looks_the_cause_cannot_be_told():
    for kind in ("false_negative", "false_positive"):
        assert cause_of(kind, None, Word.HEIGHT_LIMIT) is Why.UNKNOWN


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        ((1.6, 0.1, 0.5), "level surface"),
        ((1.4, 0.1, 1.5), "pole or trunk"),
        ((0.1, 1.4, 1.3), "small object"),
        ((1, 1, 1), "small object"),
        ((1.5, 0.1, 0.5), "wall or other surface"),
        ((1.6, 0.1, 0.6), "wall or other surface"),
        ((0.1, 1.5, 3), "wall or other surface"),
    ],
)
def test_unnamed_cases_are_named_by_their_size(size, expected):
    case = np.zeros((), CASE)
    case["points"], case["ground"], case["high"] = 100, 50, size
    assert shape("false_positive", case) == expected
    assert shape("false_negative", case) == "moving object"
    case["ground"] = 51
    assert shape("false_positive", case) == "ground"


def sentence_of(**values) -> str:
    case = {
        "kind": "false_negative",
        "what": "car",
        "instance": 12,
        "cause": "standing too long",
        "behaviour": "stood still until the end",
        "frames": 2,
        "moved": 1.0,
        "range": {"min": 3.2, "mean": 5.0, "max": 8.4},
        "points": 5,
        "cost": 1.0,
        "first_frame": 0,
        "last_frame": 1,
        "worst_frame": 0,
        "low": [1, 2, 3],
        "high": [3, 3, 3.5],
        "reasons": {"mystery": 4, "x": 1},
    }
    made = msgspec.convert(case | values, FailureCase)
    return sentence(made, "kept: rays crossed it, but hits outweigh misses")


def test_sentences_state_what_the_object_did_and_what_the_method_did():
    did = "Rays crossed it, but hits outweigh misses."
    assert (
        sentence_of() == f"Kept: car 12, 2 frames, 3 to 8 m away, stood still until the end. {did}"
    )
    one = sentence_of(frames=1, instance=None)
    assert one == f"Kept: car, 1 frame, 3 to 8 m away, stood still until the end. {did}"
    assert (
        sentence_of(behaviour="far away") == f"Kept: car 12, 2 frames, far away (3 to 8 m). {did}"
    )
    assert sentence_of(behaviour=None) == f"Kept: car 12, 2 frames, 3 to 8 m away, moved 1 m. {did}"
    assert sentence_of(behaviour=None, moved=0.9).startswith(
        "Kept: car 12, 2 frames, 3 to 8 m away, moved less than"
    )
    assert "frames, 3 m away, stood still" in sentence_of(
        range={"min": 3.2, "mean": 3.3, "max": 3.4}
    )
    removed = {"kind": "false_positive", "what": "ground", "instance": None}
    where = "Removed: ground, 2.0 x 1.0 x 0.5 m, 2 frames, 3 to 8 m away"
    assert sentence_of(**removed, behaviour="always in view").startswith(
        f"{where}, always in view. Rays crossed"
    )
    assert sentence_of(**removed, behaviour=None).startswith(f"{where}. Rays crossed")


def seen(through: int) -> CountedLooks:
    """128 places that two other scans hit, of which some were also seen through twice."""
    counts = np.zeros((128, len(Look)), np.int32)
    counts[:, Look.HIT] = 2
    counts[:through, Look.THROUGH] = 2
    zero = np.zeros(128, np.int32)
    far = np.full(128, 9.0, np.float32)
    frames = np.zeros((1, 1, len(Look)), np.int32)
    known = np.zeros(128, np.bool_)
    return CountedLooks(counts, zero, zero, zero, zero, zero, far, far, frames, known)


@pytest.mark.parametrize(
    ("through", "cause", "near"),
    [
        (10, Why.NO_RAY, None),
        (58, Why.NO_RAY, Why.THIN),
        (63, Why.NO_RAY, Why.THIN),
        (64, Why.THIN, Why.NO_RAY),
        (70, Why.THIN, Why.NO_RAY),
        (118, Why.THIN, None),
    ],
)
def test_a_cause_near_a_threshold_names_the_other(through, cause, near):
    rows = np.arange(128)
    assert cause_of("false_positive", looks_of(seen(through), rows)) == cause
    assert near_cause("false_positive", seen(through), rows, cause) == near


def test_a_single_point_has_no_near_cause() -> None:
    rows = np.arange(1)
    cause = cause_of("false_positive", looks_of(seen(0), rows))
    assert near_cause("false_positive", seen(0), rows, cause) is None


def test_a_score_beyond_what_points_allow_has_what_objects_allow_beside_it() -> None:
    found = Ceiling(
        possible=Estimate(27.4, 1.2),
        possible_by_object=Estimate(70.0),
        removed_seen=Estimate(20.8),
        removed_unseen=Estimate(33.3),
        kept_seen=Estimate(6.4),
        kept_unseen=Estimate(39.4),
    )
    assert found.of_kept().endswith("the drive allows 27.4 ±1.2 by point and 70.0 by object")
    within = msgspec.structs.replace(found, removed_unseen=Estimate(0.1))
    assert within.of_kept().endswith("the drive allows 27.4 ±1.2")
