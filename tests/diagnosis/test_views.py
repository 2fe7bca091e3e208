"""How the sensor moved around a scan."""

from __future__ import annotations

import numpy as np
import pytest

from dynaviz.sources.hypotheses.views import around


@pytest.mark.parametrize(
    ("stamps", "before", "after"),
    [
        (
            [0, 500_000_000, 1_000_000_000],
            -2.0,
            1.0,
        ),  # at 2 Hz, a sweep of 0.1 s takes a fifth of the way
        ([0, 50_000_000, 100_000_000], -10.0, 5.0),  # no farther than the next frame
        ([None] * 3, -10.0, 5.0),
    ],
)
def test_poses_one_sweep_before_and_after_are_on_the_way_to_the_next_frames(stamps, before, after):
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = -10, 0, 5
    found = around(1, [0, 1, 2], list(poses), stamps)
    assert found is not None
    np.testing.assert_allclose(found[:, 0, 3], [before, after])
