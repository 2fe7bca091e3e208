"""Causes of cases at the bounds of each rule, and the sentences about them."""

import numpy as np
import pytest

from dynaviz.contracts.method import Cause, Reason
from dynaviz_eval.attribution import causes_of, sentence, shape
from dynaviz_eval.cases import Cases, summed

pytestmark = pytest.mark.boundscheck

REASONS = (
    Reason("crossed", "rays", Cause.GRAZING_RAYS),
    Reason("crossed_often", "rays as well", Cause.GRAZING_RAYS),
    Reason("never_crossed", "no rays", Cause.NOTHING_BEHIND),
    Reason("few_rays", "few rays", Cause.SPARSE_RINGS),
    Reason("too_high", "height", Cause.HEIGHT_LIMIT),
    Reason("mystery", "unknown"),
    Reason("hit_more", "hits", Cause.STANDING),
)
CASE = summed(np.empty(0, Cases(len(REASONS) + 1, np.inf).kind)).dtype


def cause(kind: str, reason: int, size=(1, 1, 1), **looks) -> Cause | None:
    total = np.zeros(1, CASE)
    for name, value in {"points": 100, "cells": 10, **looks}.items():
        total[name] = value
    total["low"], total["high"] = 5, np.asarray(size, np.float32) + 5
    total["reasons"][0, reason] = 100
    return causes_of(kind, total, REASONS)[0][0]


@pytest.mark.parametrize(
    ("looks", "expected"),
    [
        ({"touching": 51}, Cause.SHARED_CELL),
        ({"touching": 50}, Cause.NOTHING_BEHIND),
        ({"surface": 100, "grazed": 51}, Cause.GRAZING_RAYS),
        ({"surface": 100, "grazed": 50}, Cause.NOTHING_BEHIND),
        ({"surface": 15, "grazed": 15}, Cause.GRAZING_RAYS),
        ({"surface": 14, "grazed": 14}, Cause.NOTHING_BEHIND),
        ({"surface": 50, "ground": 51}, Cause.NOTHING_BEHIND),
        ({"surface": 49, "ground": 51}, Cause.SPARSE_RINGS),
        ({"surface": 49, "ground": 50}, Cause.NOTHING_BEHIND),
        ({"cells": 51, "surface": 100, "grazed": 51}, Cause.GRAZING_RAYS),
        ({"cells": 51}, Cause.SPARSE_RINGS),
        ({"cells": 50}, Cause.NOTHING_BEHIND),
    ],
)
def test_the_cause_of_a_removed_case_depends_on_measured_angles_and_density(looks, expected):
    assert cause("false_positive", 2, **looks) is expected


@pytest.mark.parametrize(
    ("reason", "looks", "expected"),
    [
        (6, {"frames": 10, "moved": 0.99}, Cause.STANDING),
        (6, {"frames": 49, "moved": 1.4}, Cause.STANDING),
        (6, {"frames": 9, "moved": 0.0}, Cause.OCCUPIED),
        (6, {"frames": 10, "moved": 1.0}, Cause.OCCUPIED),
        (6, {"frames": 40, "moved": 23.2, "cells": 100}, Cause.OCCUPIED),
        (2, {"frames": 50, "moved": 0.0}, Cause.NOTHING_BEHIND),
        (0, {"frames": 10, "moved": 0.99}, Cause.NOTHING_BEHIND),
        (0, {"cells": 51}, Cause.SPARSE_RINGS),
        (0, {"cells": 50}, Cause.NOTHING_BEHIND),
        (3, {}, Cause.SPARSE_RINGS),
        (0, {"size": (9, 9, 0.1)}, Cause.NOTHING_BEHIND),
    ],
)
def test_the_cause_of_a_kept_case_follows_its_reasons_and_motion(reason, looks, expected):
    assert cause("false_negative", reason, **looks) is expected


def test_a_method_cannot_declare_at_which_angle_rays_met_a_surface():
    assert cause("false_positive", 0) is Cause.PARTLY_EMPTY
    assert cause("false_positive", 0, surface=100, grazed=51) is Cause.GRAZING_RAYS


@pytest.mark.parametrize("kind", ["false_negative", "false_positive"])
def test_shape_and_motion_only_refine_causes_of_visibility(kind):
    looks = {"frames": 20, "touching": 100, "cells": 100, "surface": 100, "grazed": 100}
    assert cause(kind, 4, **looks) is Cause.HEIGHT_LIMIT
    assert (
        cause(kind, 5, **looks) is cause(kind, len(REASONS), **looks) is None
    )  # the last code has no reason


def test_the_cause_of_most_points_wins_over_the_most_frequent_reason():
    total = np.zeros(1, CASE)
    total["points"], total["cells"] = 100, 10
    total["reasons"] = [30, 30, 0, 0, 40, 0, 0, 0]
    assert causes_of("false_positive", total, REASONS) == [(Cause.PARTLY_EMPTY, 0)]
    total["reasons"] = [20, 20, 0, 0, 60, 0, 0, 0]
    assert causes_of("false_positive", total, REASONS) == [(Cause.HEIGHT_LIMIT, 4)]


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
        "range": {"min": 3.2, "max": 8.4},
        "low": [1, 2, 3],
        "high": [3, 3, 3.5],
        "reasons": {"mystery": 4, "x": 1},
    }
    return sentence(case | values, "kept: rays crossed it, but hits outweigh misses")


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
    assert "frames, 3 m away, stood still" in sentence_of(range={"min": 3.2, "max": 3.4})
    removed = {"kind": "false_positive", "what": "ground", "instance": None}
    where = "Removed: ground, 2.0 x 1.0 x 0.5 m, 2 frames, 3 to 8 m away"
    assert sentence_of(**removed, behaviour="always in view").startswith(
        f"{where}, always in view. Rays crossed"
    )
    assert sentence_of(**removed, behaviour=None).startswith(f"{where}. Rays crossed")
