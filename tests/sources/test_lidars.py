"""Two lidars of one vehicle in a bag or in folders: each scan has the pose of its own lidar."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.bags import POSES, XYZ, BagWriter, N, at, columns

import dynaviz as dv
from dynaviz.errors import UsageError
from dynaviz.sources.datasets.lidars import Lidars

MOUNTS = {"front": at(1.0, 0.0, 0.5), "rear": at(-2.0, 0.3, 0.5, np.pi)}
WRITTEN = "{a}=1,0,0.5,0,0,0;{b}=-2,0.3,0.5,0,0,180"


def assert_alternating(sequence: dv.Sequence) -> None:
    """Frames alternate between the lidars; each has its own pose and ray origin."""
    assert isinstance(sequence.reader, Lidars)
    assert len(sequence) == 2 * N
    for k in range(2 * N):
        T = POSES[k // 2] @ MOUNTS["front" if k % 2 == 0 else "rear"]
        scan = sequence[k]
        assert scan.index == k
        np.testing.assert_allclose(scan.T_world_sensor, T, atol=1e-6)
        np.testing.assert_allclose(scan.origins[0], T[:3, 3], atol=1e-6)
        np.testing.assert_allclose(scan.points, XYZ[k // 2] @ T[:3, :3].T + T[:3, 3], atol=1e-4)


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """A bag with two cloud topics at the same times and the odometry of the vehicle."""
    with BagWriter(tmp_path / "drive") as bag:
        for k in range(N):
            for name in MOUNTS:
                bag.cloud(k / 10, columns(XYZ[k]), topic=f"/{name}", frame="base")
            bag.odometry(k / 10, POSES[k], child="base")
    return bag.path


def test_two_topics_of_a_bag(bag: Path) -> None:
    assert_alternating(
        dv.open(f"{bag}#/front,/rear", extrinsic=WRITTEN.format(a="/front", b="/rear"))
    )
    found = dv.open(
        f"{bag}#/rear,/front", frames="2:4", extrinsic=WRITTEN.format(a="/front", b="/rear")
    )
    np.testing.assert_allclose(found[0].T_world_sensor, POSES[1] @ MOUNTS["rear"], atol=1e-6)


def test_two_folders(tmp_path: Path) -> None:
    for name in MOUNTS:
        (tmp_path / "car" / name).mkdir(parents=True)
        for k in range(N):
            np.save(tmp_path / "car" / name / f"{k:06d}.npy", XYZ[k])
    np.savetxt(tmp_path / "poses.txt", POSES[:, :3].reshape(N, 12))
    mounts = WRITTEN.format(a="front", b="rear")
    sequence = dv.open(f"{tmp_path}/car#front,rear", poses=tmp_path / "poses.txt", extrinsic=mounts)
    assert_alternating(sequence)
    assert sequence.name == "car"


def test_mistakes(bag: Path) -> None:
    with pytest.raises(
        UsageError,
        match=r"extrinsic=./front=1.: must name each lidar once\. Give /front=X,Y,Z,ROLL",
    ):
        dv.open(f"{bag}#/front,/rear", extrinsic="/front=1")
    with pytest.raises(
        UsageError, match=r"poses are estimated for one lidar\. Estimate them for .*#/front, then"
    ):
        dv.open(f"{bag}#/front,/rear", poses="small-gicp")
