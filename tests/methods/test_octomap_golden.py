"""The labels of the public implementations on the same input."""

from __future__ import annotations

import numpy as np
import pytest

from dynaviz_methods.octomap.method import OctoMap, OctoMapG, OctoMapGF


@pytest.mark.slow
def test_octomap_matches_the_public_program_except_on_borders(golden):
    ours, theirs = golden.run(OctoMap), golden.removed["octomap"]
    assert (ours == theirs).mean() > 0.9999
    assert ours[theirs].mean() > 0.999
    assert golden.scores(ours) == pytest.approx(golden.scores(theirs), abs=0.01)


@pytest.mark.parametrize(
    "golden", ["mini", pytest.param("kitti_tracking_0012", marks=pytest.mark.slow)], indirect=True
)
def test_with_a_float32_resolution_every_label_matches(golden):
    np.testing.assert_array_equal(
        golden.run(OctoMap, resolution=float(np.float32(0.1))), golden.removed["octomap"]
    )


@pytest.mark.slow
def test_octomap_g_scores_like_the_public_program(golden):
    ours, theirs = golden.scores(golden.run(OctoMapG)), golden.scores(golden.removed["octomap_g"])
    assert ours == pytest.approx(theirs, abs=1.0)


@pytest.mark.slow
def test_the_noise_filter_keeps_more_static_points(mini):
    assert mini.scores(mini.run(OctoMapGF))[0] > mini.scores(mini.run(OctoMapG))[0]
