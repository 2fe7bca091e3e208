"""The labels of the benchmark's port on the same input."""

from __future__ import annotations

import numpy as np
import pytest

from dynaviz.io.pcd import read_pcd
from dynaviz.method import Context
from dynaviz.params import resolve
from dynaviz.scan import Scan
from dynaviz.sensors import load_sensor
from dynaviz.survey import Extent
from dynaviz_methods.removert import Removert, RemovertParams

SENSORS = {"mini": "vlp16", "kitti_tracking_0012": "hdl64e"}
PUBLISHED = {"mini": (97.02, 37.78), "kitti_tracking_0012": (99.71, 19.89)}  # SA and DA
OURS = {"mini": (91.20, 91.20), "kitti_tracking_0012": (92.14, 96.32)}
REVERTED = {"mini": (97.81, 80.78), "kitti_tracking_0012": (99.51, 91.34)}


@pytest.fixture(scope="module", params=SENSORS)
def golden(request, shared):
    """Name, scans, their ground truth, and what the public port removed."""
    if not (shared / "golden").is_dir():
        pytest.skip("needs golden/ in the folder of real data")
    name = request.param
    folder = shared / "golden/mini" if name == "mini" else request.getfixturevalue(name)
    clouds = [read_pcd(path) for path in sorted((folder / "pcd").glob("*.pcd"))]
    scans = [Scan(k, cloud.xyz, cloud.T_world_sensor) for k, cloud in enumerate(clouds)]
    packed = np.load(shared / f"golden/labels/{name}.npz")
    removed = np.unpackbits(packed["removert_port"])[: int(packed["n_points"])] > 0
    return name, scans, read_pcd(folder / "gt_cloud.pcd")["intensity"], removed


def run(scans, params, sensor):
    method = Removert(params)
    raw_map = np.concatenate([s.points for s in scans])
    method.begin(Context(Extent.of(scans[0]), load_sensor(sensor), raw_map=raw_map))
    for s in scans:
        method.observe(s)
    return np.concatenate([method.label(s) for s in scans])


def scores(truth, removed):
    return 100 * (~removed[truth == 0]).mean(), 100 * removed[truth == 1].mean()


def test_the_port_removes_what_the_public_one_does(golden):
    name, scans, truth, theirs = golden
    ours = run(scans, resolve(Removert, preset="port").params, SENSORS[name])
    assert (ours == theirs).mean() > 0.99998  # their angles are of single precision
    assert ours[theirs].mean() > 0.999
    assert scores(truth, ours) == pytest.approx(scores(truth, theirs), abs=0.005)
    assert scores(truth, ours) == pytest.approx(PUBLISHED[name], abs=0.01)


def test_judging_every_point_finds_far_more_of_what_moves(golden):
    name, scans, truth, _ = golden
    assert scores(truth, run(scans, RemovertParams(), SENSORS[name])) == pytest.approx(OURS[name], abs=0.02)


def test_with_the_revert_step_most_of_what_stands_is_kept(golden):
    name, scans, truth, _ = golden
    params = RemovertParams(resolutions=(2.5,), revert_resolutions=(2.09,))
    assert scores(truth, run(scans, params, SENSORS[name])) == pytest.approx(REVERTED[name], abs=0.02)
