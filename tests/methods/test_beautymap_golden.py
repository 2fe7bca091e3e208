"""The labels of the public implementation on the same input."""

from __future__ import annotations

import numpy as np
import pytest

from dynaviz.io.pcd import read_pcd
from dynaviz.method import Context
from dynaviz.scan import Scan
from dynaviz.survey import Extent
from dynaviz_methods.beautymap import BeautyMap

# Same label, of its removed points, of our removed points: at least so many per cent; and our SA and DA.
EXPECTED = {"mini": (98.0, 95.0, 92.0, 89.07, 68.91), "kitti_tracking_0012": (99.99, 99.9, 99.4, 99.95, 62.88)}


@pytest.mark.parametrize("name", EXPECTED)
def test_labels_are_nearly_the_public_ones(name, shared, request):
    if not (shared / "golden").is_dir():
        pytest.skip("needs golden/ in the folder of real data")
    folder = shared / "golden/mini" if name == "mini" else request.getfixturevalue(name)
    clouds = [read_pcd(path) for path in sorted((folder / "pcd").glob("*.pcd"))]
    scans = [Scan(k, cloud.xyz, cloud.T_world_sensor) for k, cloud in enumerate(clouds)]
    truth = read_pcd(folder / "gt_cloud.pcd")["intensity"]
    packed = np.load(shared / f"golden/labels/{name}.npz")
    theirs = np.unpackbits(packed["beautymap"])[: int(packed["n_points"])] > 0
    method = BeautyMap(BeautyMap.Params())
    method.begin(Context(Extent.of(*scans[:1]), raw_map=np.concatenate([s.points for s in scans])))
    for s in scans:
        method.observe(s)
    ours = np.concatenate([method.label(s) for s in scans])
    same, found, right, static, dynamic = EXPECTED[name]
    assert 100 * (ours == theirs).mean() >= same
    assert 100 * ours[theirs].mean() >= found
    assert 100 * theirs[ours].mean() >= right
    assert 100 * (~ours[truth == 0]).mean() == pytest.approx(static, abs=0.02)
    assert 100 * ours[truth == 1].mean() == pytest.approx(dynamic, abs=0.02)
