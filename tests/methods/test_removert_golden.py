"""The labels of the benchmark's port on the same input."""

from __future__ import annotations

import pytest

from dynaviz_methods.removert import Removert

PUBLISHED = {"mini": (97.02, 37.78), "kitti_tracking_0012": (99.71, 19.89)}  # SA and DA
OURS = {"mini": (91.20, 91.20), "kitti_tracking_0012": (92.14, 96.32)}
REVERTED = {"mini": (97.81, 80.78), "kitti_tracking_0012": (99.51, 91.34)}


def test_the_port_removes_the_points_of_the_public_one(golden):
    ours, theirs = golden.run(Removert, "port"), golden.removed["removert_port"]
    assert (ours == theirs).mean() > 0.99998  # the port computes angles in single precision
    assert ours[theirs].mean() > 0.999
    assert golden.scores(ours) == pytest.approx(golden.scores(theirs), abs=0.005)
    assert golden.scores(ours)[:2] == pytest.approx(PUBLISHED[golden.name], abs=0.01)


def test_judging_every_point_removes_far_more_dynamic_points(golden):
    assert golden.scores(golden.run(Removert))[:2] == pytest.approx(OURS[golden.name], abs=0.02)


def test_with_the_revert_step_most_static_points_are_kept(golden):
    ours = golden.run(Removert, resolutions=(2.5,), revert_resolutions=(2.09,))
    assert golden.scores(ours)[:2] == pytest.approx(REVERTED[golden.name], abs=0.02)
