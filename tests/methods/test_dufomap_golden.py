"""The labels of the public program on the same input, and the program itself where it is installed."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from dynaviz.io.pcd import read_pcd
from dynaviz.method import Context
from dynaviz.scan import Scan
from dynaviz.survey import Extent
from dynaviz_methods.dufomap import DufoMap


class Golden:
    """A sequence in memory, its ground truth, and what the public program removed."""

    def __init__(self, shared: Path, name: str, folder: Path):
        clouds = [read_pcd(path) for path in sorted((folder / "pcd").glob("*.pcd"))]
        self.scans = [Scan(k, cloud.xyz, cloud.T_world_sensor) for k, cloud in enumerate(clouds)]
        self.truth = read_pcd(folder / "gt_cloud.pcd")["intensity"]
        packed = np.load(shared / f"golden/labels/{name}.npz")
        n = int(packed["n_points"])
        self.removed = {k: np.unpackbits(packed[k])[:n] > 0 for k in packed if k.startswith("dufomap")}

    def run(self, online=False, **values):
        method = DufoMap(DufoMap.Params(max_range=50.0, **values))  # as the public program's example
        method.begin(Context(Extent.of(*self.scans)))
        labels = []
        for scan in self.scans:
            method.observe(scan)
            if online:
                labels.append(method.label(scan))
        return np.concatenate(labels or [method.label(scan) for scan in self.scans])

    def scores(self, removed):
        sa = 100 * (~removed[self.truth == 0]).mean()
        da = 100 * removed[self.truth == 1].mean()
        return sa, da, math.sqrt(sa * da)


@pytest.fixture(scope="module")
def mini(shared):
    if not (shared / "golden").is_dir():
        pytest.skip("needs golden/ in the folder of real data")
    return Golden(shared, "mini", shared / "golden/mini")


def test_it_is_the_public_program_in_every_point(mini):
    np.testing.assert_array_equal(mini.run(), mini.removed["dufomap"])
    np.testing.assert_array_equal(mini.run(unknown_margin=2), mini.removed["dufomap_dp2"])


def test_on_real_data_but_for_points_on_borders(mini, shared, kitti_tracking_0012):
    golden = Golden(shared, "kitti_tracking_0012", kitti_tracking_0012)
    ours, theirs = golden.run(), golden.removed["dufomap"]
    assert (ours != theirs).sum() < 100
    assert golden.scores(ours) == pytest.approx(golden.scores(theirs), abs=0.01)


@pytest.mark.parametrize("values", [{}, {"unknown_margin": 0}, {"unknown_margin": 4}, {"hit_margin": 0.35}], ids=str)
@pytest.mark.parametrize("online", [False, True], ids=["", "online"])
def test_other_parameters_and_online_are_the_public_program_too(mini, values, online):
    public = pytest.importorskip("dufomap", reason="needs the public program: pip install dufomap")
    program = public.dufomap(0.1, values.get("hit_margin", 0.2), values.get("unknown_margin", 1))
    theirs = []
    for scan in mini.scans:
        r = np.linalg.norm(scan.points - scan.position, axis=1)
        program.run(scan.points[(r > 0.2) & (r < 50)], scan.T_world_sensor, False)
        if online:
            theirs.append(program.segment(scan.points, scan.T_world_sensor, False))
    theirs = theirs or [program.segment(scan.points, scan.T_world_sensor, False) for scan in mini.scans]
    differ = mini.run(online, **values) != (np.concatenate(theirs) > 0)
    assert differ.sum() < 30
