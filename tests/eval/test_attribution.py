"""Causes of cases at the very bounds of each rule, and what is said of them."""

import numpy as np
import pytest

from dynaviz.method import Cause, Reason
from dynaviz_eval.attribution import causes_of, sentence, shape
from dynaviz_eval.cases import Cases, summed

REASONS = (
    Reason("crossed", "rays", Cause.GRAZING_RAYS),
    Reason("crossed_often", "rays, too", Cause.GRAZING_RAYS),
    Reason("never_crossed", "no rays", Cause.NOTHING_BEHIND),
    Reason("few_rays", "few rays", Cause.SPARSE_RINGS),
    Reason("too_high", "height", Cause.HEIGHT_LIMIT),
    Reason("mystery", "nobody knows"),
)
CASE = summed(np.empty(0, Cases(len(REASONS) + 1, np.inf).kind)).dtype


def cause(kind: str, said: int, size=(1, 1, 1), **looks) -> Cause | None:
    total = np.zeros(1, CASE)
    for name, value in {"points": 100, "cells": 10, **looks}.items():
        total[name] = value
    total["low"], total["high"] = 5, np.asarray(size, np.float32) + 5
    total["reasons"][0, said] = 100
    return causes_of(kind, total, REASONS)[0]


@pytest.mark.parametrize(
    ("looks", "expected"),
    [
        ({"beside": 51}, Cause.SHARED_CELL),
        ({"beside": 50}, Cause.NOTHING_BEHIND),
        ({"size": (1.6, 0.1, 0.5)}, Cause.GRAZING_RAYS),
        ({"size": (0.1, 1.6, 0.5)}, Cause.GRAZING_RAYS),
        ({"size": (1.6, 1.6, 0.61)}, Cause.NOTHING_BEHIND),
        ({"size": (1.5, 1.5, 0.5)}, Cause.NOTHING_BEHIND),
        ({"cells": 51}, Cause.SPARSE_RINGS),
        ({"cells": 50}, Cause.NOTHING_BEHIND),
    ],
)
def test_what_was_removed_is_blamed_on_how_it_lies(looks, expected):
    assert cause("false_positive", 2, **looks) is expected


@pytest.mark.parametrize(
    ("said", "looks", "expected"),
    [
        (0, {"frames": 10, "moved": 0.99}, Cause.STANDING),
        (0, {"frames": 9, "moved": 0.99}, Cause.NOTHING_BEHIND),
        (0, {"frames": 10, "moved": 1.0}, Cause.NOTHING_BEHIND),
        (0, {"cells": 51}, Cause.SPARSE_RINGS),
        (0, {"cells": 50}, Cause.NOTHING_BEHIND),
        (3, {}, Cause.SPARSE_RINGS),
        (0, {"size": (9, 9, 0.1)}, Cause.NOTHING_BEHIND),
    ],
)
def test_what_was_kept_is_blamed_on_how_it_moves(said, looks, expected):
    assert cause("false_negative", said, **looks) is expected


@pytest.mark.parametrize("kind", ["false_negative", "false_positive"])
def test_the_looks_do_not_matter_where_rays_do_not(kind):
    looks = {"frames": 20, "beside": 100, "cells": 100, "size": (9, 9, 0.1)}
    assert cause(kind, 4, **looks) is Cause.HEIGHT_LIMIT
    assert cause(kind, 5, **looks) is cause(kind, len(REASONS), **looks) is None  # the last code has no legend


def test_the_cause_of_most_points_counts_whatever_their_reasons():
    total = np.zeros(1, CASE)
    total["points"], total["cells"], total["high"] = 100, 10, (9, 9, 0.1)
    total["reasons"] = [30, 30, 0, 0, 40, 0, 0]
    assert causes_of("false_positive", total, REASONS) == [Cause.GRAZING_RAYS]
    total["reasons"] = [20, 20, 0, 0, 60, 0, 0]
    assert causes_of("false_positive", total, REASONS) == [Cause.HEIGHT_LIMIT]


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        ((1.6, 0.1, 0.5), "level surface"),
        ((1.4, 0.1, 1.5), "pole or trunk"),
        ((0.1, 1.4, 1.3), "small thing"),
        ((1, 1, 1), "small thing"),
        ((1.5, 0.1, 0.5), "wall or other surface"),
        ((1.6, 0.1, 0.6), "wall or other surface"),
        ((0.1, 1.5, 3), "wall or other surface"),
    ],
)
def test_things_are_called_by_their_size(size, expected):
    assert shape("false_positive", np.array(size, np.float32)) == expected
    assert shape("false_negative", np.array(size, np.float32)) == "something that moves"


def told(**values) -> str:
    case = {"kind": "false_negative", "what": "car", "cause": "standing too long", "frames": 2, "moved": 1.0}
    case |= {
        "range": {"min": 3.2, "max": 8.4},
        "low": [1, 2, 3],
        "high": [3, 3, 3.5],
        "reasons": {"mystery": 4, "x": 1},
    }
    return sentence(case | values)


def test_sentences():
    stood = "It stood too long: seen there more often than seen through."
    assert told() == f"Kept: car, 2 frames, 3 to 8 m away, moved 1 m. {stood}"
    assert told(frames=1, moved=0.9) == f"Kept: car, 1 frame, 3 to 8 m away, hardly moved. {stood}"
    assert told(cause=None, range={"min": 3.2, "max": 3.4}).endswith(
        "frames, 3 m away, moved 1 m. The method says: mystery."
    )
    removed = told(kind="false_positive", cause="grazing rays")
    assert removed.startswith("Removed: car, 2.0 x 1.0 x 0.5 m, 2 frames, 3 to 8 m away. Rays that passed it")
