"""The cleaned map of the benchmark's port on the same input, point by point."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from dynaviz.io.pcd import read_pcd
from dynaviz.method import Context
from dynaviz.params import resolve
from dynaviz.scan import Scan
from dynaviz.survey import Extent
from dynaviz_methods.erasor import Erasor

PUBLISHED = {20: (89.65, 26.58), 78: (97.90, 80.86)}  # SA and DA by number of scans
OURS = {20: (97.68, 28.76), 78: (99.98, 79.97)}


def run(scans, params):
    method = Erasor(params)
    method.begin(Context(Extent.of(*scans[:1]), raw_map=np.concatenate([s.points for s in scans])))
    for s in scans:
        method.observe(s)
    return method


@pytest.fixture(scope="module", params=["mini", "kitti_tracking_0012"])
def golden(request, shared):
    """Scans, their ground truth, the public port's map, and ours after the same scans."""
    if not (shared / "golden").is_dir():
        pytest.skip("needs golden/ in the folder of real data")
    folder = shared / "golden/mini" if request.param == "mini" else request.getfixturevalue(request.param)
    clouds = [read_pcd(path) for path in sorted((folder / "pcd").glob("*.pcd"))]
    scans = [Scan(k, cloud.xyz, cloud.T_world_sensor) for k, cloud in enumerate(clouds)]
    truth = read_pcd(folder / "gt_cloud.pcd")["intensity"]
    theirs = read_pcd(shared / f"golden/erasor/{request.param}.pcd").xyz
    return scans, truth, theirs, run(scans, resolve(Erasor, preset="port").params)


def scores(truth, removed):
    return 100 * (~removed[truth == 0]).mean(), 100 * removed[truth == 1].mean()


def test_the_port_leaves_the_very_map_of_the_public_one(golden):
    _, _, theirs, port = golden
    ours = port.cleaned_map()
    assert len(ours) == len(theirs)
    assert cKDTree(theirs).query(ours)[0].max() < 1e-3  # their centroids are sums of float32
    assert cKDTree(ours).query(theirs)[0].max() < 1e-3


def test_the_port_scores_as_the_public_one(golden):
    scans, truth, theirs, port = golden
    points, known = np.concatenate([s.points for s in scans]), truth < 2
    published = scores(truth[known], cKDTree(theirs).query(points[known])[0] > 0.05)
    assert published == pytest.approx(PUBLISHED[len(scans)], abs=0.005)
    tree = cKDTree(theirs)
    for s in scans[::5]:
        expected = tree.query(s.points, distance_upper_bound=0.1)[0] > 0.05
        assert (port.label(s) == expected).mean() > 0.999  # points at 0.05 m go either way


def test_labels_of_points_keep_more_of_what_stands(golden):
    scans, truth, _, port = golden
    ours = run(scans, Erasor.Params(sensor_height=1.73))
    static, dynamic = scores(truth, np.concatenate([ours.label(s) for s in scans]))
    assert (static, dynamic) == pytest.approx(OURS[len(scans)], abs=0.05)
    assert len(port.cleaned_map()) > len(ours.cleaned_map())  # which has nothing inserted
