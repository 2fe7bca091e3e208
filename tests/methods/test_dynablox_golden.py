"""Scores on sequences whose labels of other public implementations are known: no nonsense, and no surprise later.

There are no labels of the public Dynablox. On these two sequences the public OctoMap scores 86.33 / 42.44 and
93.72 / 88.81 (SA / DA), the public DUFOMap 99.84 / 48.79 on the second.
"""

from __future__ import annotations

import numpy as np
import pytest

from dynaviz.io.pcd import read_pcd
from dynaviz.method import Context
from dynaviz.params import resolve
from dynaviz.scan import Scan
from dynaviz.sensors import load_sensor
from dynaviz.survey import Extent
from dynaviz_methods.dynablox import Dynablox


@pytest.mark.parametrize(
    ("name", "sensor", "preset", "sa", "da"),
    [
        ("mini", "vlp16", None, 99.46, 73.13),
        ("mini", "vlp16", "semindoor", 99.72, 69.97),
        ("kitti_tracking_0012", "hdl64e", "kitti", 99.96, 47.59),
    ],
)
def test_scores(request, shared, name, sensor, preset, sa, da):
    if not (shared / "golden").is_dir():
        pytest.skip("needs golden/ in the folder of real data")
    folder = shared / "golden/mini" if name == "mini" else request.getfixturevalue(name)
    clouds = [read_pcd(path) for path in sorted((folder / "pcd").glob("*.pcd"))]
    scans = [Scan(k, cloud.xyz, cloud.T_world_sensor) for k, cloud in enumerate(clouds)]
    truth = read_pcd(folder / "gt_cloud.pcd")["intensity"]
    method = Dynablox(resolve(Dynablox, preset=preset).params)
    method.begin(Context(Extent.of(*scans), load_sensor(sensor)))
    for scan in scans:
        method.observe(scan)
    removed = np.concatenate([method.label(scan) for scan in scans])
    assert 100 * (~removed[truth == 0]).mean() == pytest.approx(sa, abs=0.1)
    assert 100 * removed[truth == 1].mean() == pytest.approx(da, abs=0.5)
