"""The cleaned map of the benchmark's port on the same input, point by point."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from dynaviz.contracts.params import resolve
from dynaviz.io.pcd import read_pcd
from dynaviz_methods.erasor.method import Erasor

PUBLISHED = {"mini": (89.65, 26.58), "kitti_tracking_0012": (97.90, 80.86)}  # SA and DA
OURS = {"mini": (97.68, 28.76), "kitti_tracking_0012": (99.98, 79.97)}


@pytest.fixture(scope="module")
def theirs(golden):
    """The public port's map."""
    return read_pcd(golden.shared / f"golden/erasor/{golden.name}.pcd").xyz


@pytest.fixture(scope="module")
def port(golden):
    """Ours after the same scans."""
    return golden.observed(Erasor, resolve(Erasor, preset="port").params)


def test_the_cleaned_map_of_the_port_matches_the_public_one(port, theirs):
    ours = port.cleaned_map()
    assert len(ours) == len(theirs)
    assert cKDTree(theirs).query(ours)[0].max() < 1e-3  # the port sums centroids in float32
    assert cKDTree(ours).query(theirs)[0].max() < 1e-3


def test_the_port_scores_like_the_public_one(golden, port, theirs):
    tree, known = cKDTree(theirs), golden.truth < 2
    removed = np.zeros(len(known), bool)
    removed[known] = tree.query(golden.points[known])[0] > 0.05
    assert golden.scores(removed)[:2] == pytest.approx(PUBLISHED[golden.name], abs=0.005)
    for scan in golden.scans[::5]:
        expected = tree.query(scan.points, distance_upper_bound=0.1)[0] > 0.05
        assert (port.label(scan).dynamic == expected).mean() > 0.999  # points at 0.05 m may differ


def test_point_level_labels_keep_more_static_points(golden, port):
    ours = golden.observed(Erasor, Erasor.Params(sensor_height=1.73))
    removed = np.concatenate([ours.label(scan).dynamic for scan in golden.scans])
    assert golden.scores(removed)[:2] == pytest.approx(OURS[golden.name], abs=0.05)
    assert len(port.cleaned_map()) > len(ours.cleaned_map())  # ours has no inserted points
