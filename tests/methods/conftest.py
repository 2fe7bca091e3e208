from __future__ import annotations

import math
from functools import cached_property
from pathlib import Path

import numpy as np
import pytest

from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.params import resolve
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import load_sensor
from dynaviz.io.pcd import read_pcd


class Golden:
    """A sequence in memory, its ground truth, and the points that public implementations remove."""

    def __init__(self, shared: Path, name: str, folder: Path, sensor: str):
        self.name, self.shared, self.sensor = name, shared, load_sensor(sensor)
        clouds = [read_pcd(path) for path in sorted((folder / "pcd").glob("*.pcd"))]
        self.scans = [Scan(k, cloud.xyz, cloud.T_world_sensor) for k, cloud in enumerate(clouds)]
        self.truth = read_pcd(folder / "gt_cloud.pcd")["intensity"]
        packed = np.load(shared / f"golden/labels/{name}.npz")
        self.removed = {
            k: np.unpackbits(packed[k])[: int(packed["n_points"])] > 0
            for k in packed
            if k != "n_points"
        }

    @cached_property
    def points(self):
        return np.concatenate([scan.points for scan in self.scans])

    def observed(self, method, params):
        """A method after observing all scans."""
        running = method(params)
        running.begin(
            Context(
                Extent.of(*self.scans),
                self.sensor,
                raw_map=self.points if method.info.needs_map else None,
            )
        )
        for scan in self.scans:
            running.observe(scan)
        return running

    def run(self, method, preset=None, **values):
        """The labels of all points."""
        running = self.observed(
            method, resolve(method, preset).params if preset else method.Params(**values)
        )
        return np.concatenate([running.label(scan).dynamic for scan in self.scans])

    def scores(self, removed):
        """SA, DA and AA, percent."""
        sa = 100 * (~removed[self.truth == 0]).mean()
        da = 100 * removed[self.truth == 1].mean()
        return sa, da, math.sqrt(sa * da)


@pytest.fixture(scope="session")
def mini(shared: Path) -> Golden:
    """A simulated street."""
    if not (shared / "golden").is_dir():
        pytest.skip("needs golden/ in the folder of real data")
    return Golden(shared, "mini", shared / "golden/mini", "vlp16")


@pytest.fixture(scope="session")
def kitti_tracking_0012(mini: Golden, real_data: Path) -> Golden:
    """A real sequence."""
    name = "kitti_tracking_0012"
    return Golden(mini.shared, name, real_data / "unified" / name, "hdl64e")


@pytest.fixture(scope="session", params=["mini", "kitti_tracking_0012"])
def golden(request: pytest.FixtureRequest) -> Golden:
    """Each of both sequences."""
    return request.getfixturevalue(request.param)
