"""Which parts of an object stay, and for how long something was in their places."""

from __future__ import annotations

import numpy as np
import pytest

from dynaviz.arrays import F32, I32, I64
from dynaviz_methods import staying
from dynaviz_methods.trails import Trails

# Points in a row along x, through several cells
POINTS = np.stack([np.linspace(0, 3.7, 100), np.full(100, 0.1), np.full(100, 0.5)], 1).astype(np.float32)
NARROW = POINTS * np.array([0.9, 1, 1], np.float32)
STAYS, LASTS, NEITHER = (100, 0), (0, 100), (0, 0)


def _parts(points: F32, touched: int, always: int) -> tuple[int, int]:
    """The numbers of points that stay and that last, of 100 in one part without votes."""

    def tally(groups: I32, n: int) -> I64:
        size = np.bincount(groups, minlength=n)
        nothing = np.zeros(n, np.int64)
        return np.array([size, size, nothing, touched * size // 100, nothing, nothing, 10 * size])

    def spans(parts: I32, n: int) -> I64:
        assert n == 1
        return np.array([[600], [1000], [0]])

    objects, earliest = np.zeros(100, np.int32), np.array([staying.EARLIER])
    stays, lasts = staying.staying(points, objects, (0.3, 0.9), 3, earliest, np.arange(100) < always, tally, spans)
    return len(stays), len(lasts)


@pytest.mark.parametrize(
    ("touched", "always", "expected"),
    [(5, 0, STAYS), (5, 100, STAYS), (6, 69, NEITHER), (6, 70, LASTS), (30, 70, LASTS), (31, 100, NEITHER)],
)
def test_what_lasts_may_be_seen_clear_more_often_than_what_stays(
    touched: int, always: int, expected: tuple[int, int]
) -> None:
    """Errors of poses let rays pass through the surface of a parked car next to a walker."""
    assert _parts(POINTS, touched, always) == expected


def test_what_lasts_is_wide() -> None:
    """The places of people in a crowd are always taken, one person after the other."""
    assert _parts(NARROW, 6, 100) == NEITHER


def test_always_is_from_the_beginning_to_the_end_of_a_square() -> None:
    """Something may be missing for two scans at both ends, and in half of the others."""
    trails = Trails(np.zeros(2, np.int32))
    within, dynamic = np.ones(4, np.bool_), np.zeros(4, np.bool_)
    for now in range(36):
        there = np.array([True, 2 <= now < 34, now < 33, now % 3 == 0])
        trails.observe(np.arange(4), within, there, dynamic, now)
    assert trails.always(np.arange(4), 30).tolist() == [True, True, False, False]
    assert trails.always(np.arange(4), 37).tolist() == [False, False, False, False]


def test_places_of_low_points_only_were_empty() -> None:
    """The ground may be found lower after more scans, and points that were low join an object."""
    trails = Trails(np.zeros(2, np.int32))
    for now in range(6):
        places = np.array([0, 1])
        trails.observe(places, np.ones(2, np.bool_), np.array([True, False]), np.zeros(2, np.bool_), now)
    earlier, later, since = trails.spans(np.zeros(2, np.int32), 1, np.array([0, 1]), 4, trails.labelled)
    assert (earlier, later, since) == (4, 1, 1)
