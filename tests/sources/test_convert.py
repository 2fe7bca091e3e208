"""Converted sequences have the same points, poses and labels, for dynaviz and for
other programs.
"""

from __future__ import annotations

import dataclasses
import struct
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pytest
from helpers.worlds import room
from hypothesis import given
from hypothesis import settings as tried
from scipy.spatial.transform import Rotation

import dynaviz as dv
from dynaviz.contracts.scan import Scan, Sequence
from dynaviz.contracts.sensors import Sensor, load_sensor
from dynaviz.errors import DataError, UsageError
from dynaviz.sources.datasets.convert import convert
from dynaviz.sources.summary import summarize
from dynaviz.synthetic.simulate import simulate
from dynaviz.testing import InMemory


def read_plain_pcd(path: Path) -> tuple[dict[str, list[str]], list[tuple[float, ...]]]:
    """Read a PCD file of four floats per point, without dynaviz."""
    head, _, body = path.read_bytes().partition(b"DATA binary\n")
    words = {
        line.split()[0]: line.split()[1:] for line in head.decode().splitlines() if line[0] != "#"
    }
    return words, list(struct.iter_unpack("<4f", body))


def random_pose(seed: int) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.random(random_state=seed).as_matrix()
    T[:3, 3] = np.random.default_rng(seed).normal(size=3) * 100
    return T


def in_memory(*scans: Scan, sensor: Sensor | None = None) -> InMemory:
    return InMemory(scans, "some", sensor or Sensor())


def test_a_copy_has_the_same_digest(tmp_path: Path) -> None:
    world = room(frames=4)
    done = convert(world, tmp_path / "copy")
    copy = dv.open(tmp_path / "copy")
    assert summarize(copy).digest == summarize(world).digest
    assert (done.exact, done.pose_error, done.frames, done.points, done.remarks()) == (
        True,
        0,
        4,
        12_000,
        [],
    )
    assert (copy.name, [scan.index for scan in copy]) == ("room", [10, 11, 12, 13])
    for scan, original in zip(copy, world.scans, strict=True):
        np.testing.assert_array_equal(scan.instances, original.instances)
    # At 10 Hz, frame 10 is at 1 s.
    assert [scan.stamp_ns - 1_000_000_000 for scan in copy] == [
        scan.stamp_ns for scan in world.scans
    ]


def test_methods_give_the_same_labels_on_the_copy(tmp_path: Path) -> None:
    world = room(frames=5)
    convert(world, tmp_path / "copy")
    for method, settings in (("octomap", ()), ("removert", ("elevation=[-60,60]",))):
        first, second = (
            dv.run(method, s, settings=settings, threads=1) for s in (world, tmp_path / "copy")
        )
        assert first.labels_sha256 == second.labels_sha256
        assert first.counts == second.counts


def test_a_copy_of_a_simulation_keeps_classes_and_lidars(tmp_path: Path) -> None:
    for name in ("demo", "square_vlp32c"):
        original = dv.open(simulate(name, tmp_path / name, frames=2))
        done = convert(original, tmp_path / f"{name}_copy")
        copy = dv.open(tmp_path / f"{name}_copy")
        assert done.moved_rays == 0
        assert done.pose_error < 1e-15
        for a, b in zip(original, copy, strict=True):
            for field in ("points", "labels", "classes", "instances"):
                np.testing.assert_array_equal(getattr(a, field), getattr(b, field))
            np.testing.assert_allclose(a.T_world_sensor, b.T_world_sensor, atol=1e-15, rtol=0)
            np.testing.assert_allclose(a.origins, b.origins, atol=1e-14, rtol=0)
            assert (a.class_names, a.stamp_ns) == (b.class_names, b.stamp_ns)
        assert (copy.sensor, copy.name) == (original.sensor, original.name)


def test_other_programs_read_the_copy(tmp_path: Path) -> None:
    import open3d as o3d

    scan = dataclasses.replace(room(frames=1).scans[0], T_world_sensor=random_pose(3), origins=None)
    convert(in_memory(scan), tmp_path / "copy")
    path = tmp_path / "copy/pcd/000010.pcd"
    cloud = o3d.io.read_point_cloud(str(path))
    np.testing.assert_array_equal(np.asarray(cloud.points), scan.points.astype(np.float64))
    words, points = read_plain_pcd(path)
    assert words["VERSION"] == ["0.7"]
    assert words["FIELDS"] == ["x", "y", "z", "intensity"]
    assert (words["SIZE"], words["TYPE"], words["COUNT"]) == (["4"] * 4, ["F"] * 4, ["1"] * 4)
    assert (words["WIDTH"], words["HEIGHT"], words["POINTS"]) == (["3000"], ["1"], ["3000"])
    np.testing.assert_array_equal(np.array(points)[:, :3], scan.points)
    view = np.array(words["VIEWPOINT"], float)
    np.testing.assert_array_equal(view[:3], scan.position)
    rotation = Rotation.from_quat(view[[4, 5, 6, 3]]).as_matrix()
    np.testing.assert_allclose(rotation, scan.T_world_sensor[:3, :3], atol=1e-15, rtol=0)
    truth = o3d.t.io.read_point_cloud(str(tmp_path / "copy/gt_cloud.pcd")).point
    np.testing.assert_array_equal(truth["positions"].numpy(), scan.points)
    np.testing.assert_array_equal(truth["intensity"].numpy()[:, 0], scan.labels)
    head = (tmp_path / "copy/gt_cloud.pcd").read_bytes().split(b"DATA")[0].decode()
    assert "FIELDS x y z intensity class instance\n" in head


@tried(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_poses_are_read_back_to_a_few_units_in_the_last_place(seed: int) -> None:
    from dynaviz.spatial import geometry

    T = random_pose(seed)
    back = geometry.pose(T[:3, 3], geometry.quaternion(T[:3, :3]))
    assert np.abs(back - T).max() < 2e-15  # and 17 digits represent every float64
    again = geometry.pose(back[:3, 3], geometry.quaternion(back[:3, :3]))
    assert np.abs(again - back).max() < 2e-15


def test_frames_without_points_labels_or_numbers(tmp_path: Path) -> None:
    full = room(frames=1).scans[0]
    points = full.points.copy()
    points[5] = np.nan
    scans = [
        dataclasses.replace(full, index=1, points=points),
        Scan(2, np.empty((0, 3), np.float32), np.eye(4), labels=np.empty(0, np.uint8)),
        Scan(7, full.points[:9], np.eye(4)),
        dataclasses.replace(full, index=8, labels=np.full(len(full), 255, np.uint8)),
    ]
    done = convert(in_memory(*scans), tmp_path / "copy")
    copy = dv.open(tmp_path / "copy")
    assert [len(scan) for scan in copy] == [3000, 0, 9, 3000]
    np.testing.assert_array_equal(copy[0].points, points)
    np.testing.assert_array_equal(copy[0].labels, full.labels)
    assert set(copy[2].labels) == set(copy[3].labels) == {255}
    assert done.unlabelled == 3009
    assert "3,009 of 6,009 points are unlabelled" in done.remarks()[0]
    assert "rate" not in (tmp_path / "copy/sequence.toml").read_text()


def test_without_labels_there_is_no_ground_truth(tmp_path: Path) -> None:
    convert(room(frames=2, labelled=False), tmp_path / "copy")
    assert not (tmp_path / "copy/gt_cloud.pcd").exists()
    assert not dv.open(tmp_path / "copy").has_labels


def test_other_ray_origins_are_reported(tmp_path: Path) -> None:
    full = room(frames=1).scans[0]
    origins = np.tile(full.position, (len(full), 1))
    origins[:40] += 0.3
    done = convert(in_memory(dataclasses.replace(full, origins=origins)), tmp_path / "copy")
    assert (done.moved_rays, done.exact) == (40, False)
    assert "rays of 40 points" in done.remarks()[0]
    pair = load_sensor("vlp32c_pair")
    origins = (
        full.position + np.array([mount[:3] for mount in pair.mounts])[np.arange(len(full)) % 2]
    )
    done = convert(
        in_memory(dataclasses.replace(full, origins=origins), sensor=pair), tmp_path / "pair"
    )
    assert done.moved_rays == 0
    np.testing.assert_allclose(dv.open(tmp_path / "pair")[0].origins, origins, atol=1e-12)


def test_nothing_is_overwritten_and_no_partial_copy_is_left(tmp_path: Path) -> None:
    world = room(frames=2)
    (tmp_path / "there").mkdir()
    with pytest.raises(DataError, match="there: already exists"):
        convert(world, tmp_path / "there")

    class Broken(InMemory):
        def __getitem__(self, position: int) -> Scan:
            if position:
                raise DataError("b.bin", "ends in the middle")
            return super().__getitem__(position)

    broken: Sequence = Broken(world.scans, "broken")
    with pytest.raises(DataError, match=r"b\.bin: ends"):
        convert(broken, tmp_path / "new")
    with pytest.raises(UsageError, match="frame 10 comes after 11"):
        convert(in_memory(*reversed(world.scans)), tmp_path / "new")
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="cannot be written"):
        convert(world, tmp_path / "file/new")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "there"]
