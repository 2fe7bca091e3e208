"""The labels of the public implementations on the same input."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dynaviz.io.pcd import read_pcd
from dynaviz.method import Context
from dynaviz.scan import Scan
from dynaviz.survey import Extent
from dynaviz_methods.octomap import OctoMap, OctoMapG, OctoMapGF


class Golden:
    """A sequence in memory, its ground truth, and what the public implementations removed."""

    def __init__(self, shared: Path, name: str, folder: Path):
        clouds = [read_pcd(path) for path in sorted((folder / "pcd").glob("*.pcd"))]
        self.scans = [Scan(k, cloud.xyz, cloud.T_world_sensor) for k, cloud in enumerate(clouds)]
        self.extent = Extent.of(*self.scans)
        self.truth = read_pcd(folder / "gt_cloud.pcd")["intensity"]
        packed = np.load(shared / f"golden/labels/{name}.npz")
        self.removed = {k: np.unpackbits(packed[k])[: int(packed["n_points"])] > 0 for k in packed if k != "n_points"}

    def run(self, method, **values):
        ran = method(method.Params(**values))
        ran.begin(Context(self.extent))
        for scan in self.scans:
            ran.observe(scan)
        return np.concatenate([ran.label(scan) for scan in self.scans])

    def scores(self, removed):
        sa = 100 * (~removed[self.truth == 0]).mean()
        da = 100 * removed[self.truth == 1].mean()
        return sa, da, math.sqrt(sa * da)


@pytest.fixture(scope="module")
def mini(shared):
    if not (shared / "golden").is_dir():
        pytest.skip("needs golden/ in the folder of real data")
    return Golden(shared, "mini", shared / "golden/mini")


@pytest.fixture(scope="module", params=["mini", "kitti_tracking_0012"])
def golden(request, shared, mini, tmp_path_factory):
    if request.param == "mini":
        return mini
    out = tmp_path_factory.mktemp("real")
    subprocess.run([sys.executable, shared / "data/unpack.py", out], check=True, stdout=subprocess.DEVNULL)
    return Golden(shared, request.param, out / "unified" / request.param)


def test_octomap_is_the_public_one_but_for_points_on_borders(golden):
    ours, theirs = golden.run(OctoMap), golden.removed["octomap"]
    assert (ours == theirs).mean() > 0.9999
    assert ours[theirs].mean() > 0.999
    assert golden.scores(ours) == pytest.approx(golden.scores(theirs), abs=0.01)


def test_with_its_resolution_rounded_to_float32_it_is_the_same_in_every_point(golden):
    np.testing.assert_array_equal(golden.run(OctoMap, resolution=float(np.float32(0.1))), golden.removed["octomap"])


def test_octomap_g_scores_as_the_public_one(golden):
    ours, theirs = golden.scores(golden.run(OctoMapG)), golden.scores(golden.removed["octomap_g"])
    assert ours == pytest.approx(theirs, abs=1.0)


def test_the_noise_filter_keeps_more_static_points(mini):
    assert mini.scores(mini.run(OctoMapGF))[0] > mini.scores(mini.run(OctoMapG))[0]
