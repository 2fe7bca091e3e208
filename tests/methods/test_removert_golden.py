"""The labels of the benchmark's port on the same input."""

from __future__ import annotations

import pytest

from dynaviz_methods.removert.method import Removert

PUBLISHED = {"mini": (97.02, 37.78), "kitti_tracking_0012": (99.71, 19.89)}  # SA and DA


@pytest.mark.parametrize(
    "golden", ["mini", pytest.param("kitti_tracking_0012", marks=pytest.mark.slow)], indirect=True
)
def test_the_port_removes_the_points_of_the_public_one(golden):
    ours, theirs = golden.run(Removert, "port"), golden.removed["removert_port"]
    assert (ours == theirs).mean() > 0.99998  # the port computes angles in single precision
    assert ours[theirs].mean() > 0.999
    assert golden.scores(ours) == pytest.approx(golden.scores(theirs), abs=0.005)
    assert golden.scores(ours)[:2] == pytest.approx(PUBLISHED[golden.name], abs=0.01)


def test_scores_of_judging_every_point_and_of_the_revert_step(mini):
    assert mini.scores(mini.run(Removert))[:2] == pytest.approx((91.20, 91.20), abs=0.02)
    ours = mini.run(Removert, resolutions=(2.5,), revert_resolutions=(2.09,))
    assert mini.scores(ours)[:2] == pytest.approx((97.81, 80.78), abs=0.02)
