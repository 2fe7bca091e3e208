"""Which parts of an object stay, and for how long something was in their places."""

from __future__ import annotations

import numpy as np
import pytest

from dynaviz.arrays import I32, I64
from dynaviz_methods import staying
from dynaviz_methods.trails import Trails

POINTS = np.random.default_rng(0).uniform(0, 0.29, (100, 3)).astype(np.float32)  # in one cell
STAYS, LASTS, NEITHER = (100, 0), (0, 100), (0, 0)


@pytest.mark.parametrize(
    ("touched", "since", "later", "expected"),
    [
        (5, 0, 10, STAYS),
        (5, 100, 20, STAYS),
        (6, 0, 30, NEITHER),
        (6, 100, 19, NEITHER),
        (12, 100, 20, LASTS),
        (13, 100, 30, NEITHER),
    ],
)
def test_what_lasts_may_be_seen_clear_more_often_than_what_stays(
    touched: int, since: int, later: int, expected: tuple[int, int]
) -> None:
    """Errors of poses let rays pass through the surface of a parked car next to a walker."""

    def tally(groups: I32, n: int) -> I64:
        assert n == 1
        assert (groups == 0).all()
        return np.array([[100], [100], [0], [touched], [0], [0], [1000]])

    def spans(parts: I32, n: int) -> I64:
        return np.array([[600], [100 * later], [since]])

    objects, earliest = np.zeros(100, np.int32), np.array([staying.EARLIER])
    stays, lasts = staying.staying(POINTS, objects, (0.3, 0.9), 3, earliest, tally, spans)
    assert (len(stays), len(lasts)) == expected


def test_places_of_low_points_only_were_empty() -> None:
    """The ground may be found lower after more scans, and points that were low join an object."""
    trails = Trails(np.zeros(2, np.int32))
    for now in range(6):
        places = np.array([0, 1])
        trails.observe(places, np.ones(2, np.bool_), np.array([True, False]), np.zeros(2, np.bool_), now)
    earlier, later, since = trails.spans(np.zeros(2, np.int32), 1, np.array([0, 1]), 4, trails.labelled)
    assert (earlier, later, since) == (4, 1, 1)
