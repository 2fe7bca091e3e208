"""The layout of the public benchmark.

Poses, ground truth by row and by position, and invalid files.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.pcd_files import write_encoded
from helpers.worlds import room

from dynaviz.contracts.scan import Scan, Sequence
from dynaviz.contracts.sensors import load_sensor
from dynaviz.errors import DataError, UsageError
from dynaviz.io.pcd import read_pcd, write_pcd
from dynaviz.sources.datasets import open_sequence
from dynaviz.sources.datasets.benchmark import BenchmarkSequence
from dynaviz.spatial import geometry


def xyz(points: Any) -> dict[str, Any]:
    return dict(zip("xyz", np.asarray(points).T, strict=True))


def write(folder: Path, scans: list[Scan], order: slice = slice(None), **cloud: Any) -> Path:
    """Write scans, and their labelled cloud in the given order of points."""
    for scan in scans:
        write_pcd(folder / f"pcd/{scan.index:06d}.pcd", xyz(scan.points), scan.T_world_sensor)
    labels = np.concatenate([scan.labels for scan in scans if scan.labels is not None]).astype(
        np.float32
    )
    points = np.concatenate([scan.points for scan in scans])
    fields = {**xyz(points), "intensity": labels, **cloud}
    write_pcd(folder / "gt_cloud.pcd", {name: array[order] for name, array in fields.items()})
    return folder


@pytest.fixture
def scans() -> list[Scan]:
    return room(frames=4, rays=500).scans


@pytest.fixture
def folder(tmp_path: Path, scans: list[Scan]) -> Path:
    return write(tmp_path / "drive", scans)


def assert_same(sequence: Sequence, scans: list[Scan]) -> None:
    assert len(sequence) == len(scans)
    for position, scan in enumerate(scans):
        read = sequence[position]
        assert read.index == scan.index
        np.testing.assert_array_equal(read.points, scan.points)
        np.testing.assert_allclose(read.T_world_sensor, scan.T_world_sensor, atol=1e-15)
        np.testing.assert_array_equal(read.origins, scan.T_world_sensor[None, :3, 3])
        np.testing.assert_array_equal(read.labels, scan.labels)  # type: ignore[arg-type]


@pytest.mark.parametrize("inner", ["", "pcd"])
def test_scans_have_pose_and_labels(folder: Path, scans: list[Scan], inner: str) -> None:
    sequence = open_sequence(str(folder / inner))
    assert isinstance(sequence.reader, BenchmarkSequence)
    assert (sequence.name, sequence.sensor.name, sequence.has_labels) == ("drive", "unknown", True)
    assert sequence.truth is not None
    assert sequence.reader.truth.by_index
    assert_same(sequence, scans)
    assert sequence[0].stamp_ns is None


def test_beyond_the_end_is_an_index_error(folder: Path) -> None:
    with pytest.raises(IndexError):
        open_sequence(str(folder))[4]


def test_without_a_labelled_cloud_there_are_no_labels(folder: Path) -> None:
    (folder / "gt_cloud.pcd").unlink()
    sequence = open_sequence(str(folder))
    assert not sequence.has_labels
    assert sequence[0].labels is None


@pytest.mark.parametrize("data", ["ascii", "binary_compressed"])
def test_a_labelled_cloud_in_any_encoding_is_read(
    folder: Path, scans: list[Scan], data: str
) -> None:
    cloud = read_pcd(folder / "gt_cloud.pcd")
    write_encoded(
        folder / "gt_cloud.pcd",
        {name: cloud[name] for name in ("x", "y", "z", "intensity")},
        data=data,
    )
    assert_same(open_sequence(str(folder)), scans)


def test_a_labelled_cloud_in_another_order_is_matched_by_position(
    tmp_path: Path, scans: list[Scan]
) -> None:
    sequence = open_sequence(str(write(tmp_path, scans, slice(None, None, -1))))
    assert isinstance(sequence.reader, BenchmarkSequence)
    assert_same(sequence, scans)
    assert sequence.facts == {
        "ground truth by": "coordinates in gt_cloud.pcd",
        "unmatched points": "0",
    }


def test_unmatched_points_are_unlabelled_and_counted(tmp_path: Path, scans: list[Scan]) -> None:
    sequence = open_sequence(str(write(tmp_path, scans, slice(10, None))))
    assert isinstance(sequence.reader, BenchmarkSequence)
    labels = sequence[0].labels
    assert labels is not None
    assert (labels[:10] == 255).all()
    np.testing.assert_array_equal(labels[10:], scans[0].labels[10:])  # type: ignore[index]
    _ = sequence[0]  # reading again does not count points twice
    assert sequence.facts["unmatched points"] == "10"


def test_points_within_a_centimetre_match(tmp_path: Path) -> None:
    points = np.array([[0, 0, 0], [5, 0, 0], [10, 0, 0], [np.nan, 0, 0]], np.float32)
    write(tmp_path, [Scan(0, points, np.eye(4), labels=np.array([1, 0, 1, 0], np.uint8))])
    moved = points + np.array([[0.009, 0, 0], [0, 0, 0], [0.011, 0, 0], [0, 0, 0]], np.float32)
    write_pcd(tmp_path / "pcd/000000.pcd", xyz(moved), np.eye(4))
    assert open_sequence(str(tmp_path))[0].labels.tolist() == [1, 0, 255, 255]  # type: ignore[union-attr]


def test_a_scan_that_differs_in_the_middle_is_still_matched(tmp_path: Path) -> None:
    scans = room(frames=9, rays=200).scans
    write(tmp_path, scans)
    write_pcd(tmp_path / f"pcd/{scans[2].index:06d}.pcd", xyz(scans[2].points[::-1]), np.eye(4))
    sequence = open_sequence(str(tmp_path))
    np.testing.assert_array_equal(sequence[2].labels, scans[2].labels[::-1])  # type: ignore[arg-type,index]
    np.testing.assert_array_equal(sequence[3].labels, scans[3].labels)  # type: ignore[arg-type]


def test_nan_and_duplicate_points_are_matched_by_row(tmp_path: Path) -> None:
    points = np.array([[np.nan, 1, 2], [3, 4, 5], [3, 4, 5]], np.float32)
    write(tmp_path, [Scan(0, points, np.eye(4), labels=np.array([0, 1, 0], np.uint8))])
    scan = open_sequence(str(tmp_path))[0]
    np.testing.assert_array_equal(scan.points, points)
    assert scan.labels.tolist() == [0, 1, 0]  # type: ignore[union-attr]


def test_unlabelled_points_classes_and_instances(tmp_path: Path, scans: list[Scan]) -> None:
    n = sum(map(len, scans))
    intensity = np.full(n, 255, np.float32)
    write(
        tmp_path,
        scans,
        intensity=intensity,
        **{"class": np.arange(n).astype("u2"), "instance": np.arange(n)[::-1]},
    )
    scan = open_sequence(str(tmp_path))[1]
    assert (scan.labels == 255).all()
    np.testing.assert_array_equal(scan.classes, np.arange(n)[500:1000])  # type: ignore[arg-type]
    np.testing.assert_array_equal(scan.instances, np.arange(n)[::-1][500:1000])  # type: ignore[arg-type]


def test_an_invalid_intensity_is_reported(tmp_path: Path, scans: list[Scan]) -> None:
    write(tmp_path, scans, intensity=np.full(2000, 0.27, np.float32))
    with pytest.raises(DataError, match=r"gt_cloud\.pcd: intensity 0\.27 is not a label"):
        open_sequence(str(tmp_path))[0]


def test_a_labelled_cloud_without_intensity_is_reported(folder: Path) -> None:
    write_pcd(folder / "gt_cloud.pcd", xyz(np.zeros((3, 3))))
    with pytest.raises(DataError, match=r"gt_cloud\.pcd: field 'intensity' is missing"):
        open_sequence(str(folder))


def test_sequence_toml_sets_name_sensor_and_rate(folder: Path) -> None:
    (folder / "sequence.toml").write_text(
        'name = "street"\nsensor = "hdl64e"\nrate = 20\nmore = 1\n'
    )
    sequence = open_sequence(str(folder))
    assert (sequence.name, sequence.sensor) == ("street", load_sensor("hdl64e"))
    assert sequence[1].stamp_ns == 11 * 50_000_000  # frame 11 at 20 Hz


@pytest.mark.parametrize(
    "content",
    [
        "name = ",
        "name = 7",
        'name = "../up"',
        'name = ""',
        'rate = "fast"',
        "rate = 0.0",
        "sensor = []",
    ],
)
def test_an_invalid_sequence_toml_is_reported(folder: Path, content: str) -> None:
    (folder / "sequence.toml").write_text(content)
    with pytest.raises(DataError, match=r"sequence\.toml: .* Set name"):
        open_sequence(str(folder))


def test_an_unknown_sensor_is_reported(folder: Path) -> None:
    (folder / "sequence.toml").write_text('sensor = "hdl65"')
    with pytest.raises(UsageError, match="hdl64e"):
        open_sequence(str(folder))


def test_rays_start_at_the_mount_of_their_lidar(tmp_path: Path) -> None:
    T_world_sensor = geometry.pose((10, 20, 30), (1, 0, 0, 1))  # a quarter turn to the left
    fields = {**xyz(np.ones((3, 3), np.float32)), "lidar": np.array([0, 1, 0], np.uint8)}
    write_pcd(tmp_path / "pcd/000005.pcd", fields, T_world_sensor)
    np.testing.assert_array_equal(open_sequence(str(tmp_path))[0].origins, [[10, 20, 30]])
    (tmp_path / "sequence.toml").write_text('sensor = "vlp32c_pair"')
    x, y, z = load_sensor("vlp32c_pair").mounts[1][:3]
    expected = [[10, 20, 30], [10 - y, 20 + x, 30 + z], [10, 20, 30]]
    np.testing.assert_allclose(open_sequence(str(tmp_path))[0].origins, expected, atol=1e-12)
    write_pcd(
        tmp_path / "pcd/000005.pcd",
        {**fields, "lidar": np.array([0, 1, 2], np.uint8)},
        T_world_sensor,
    )
    with pytest.raises(DataError, match=r"000005\.pcd: a point has lidar 2"):
        open_sequence(str(tmp_path))[0]


def test_a_scan_without_viewpoint_is_reported_with_a_hint(folder: Path) -> None:
    write_pcd(folder / "pcd/000012.pcd", xyz(np.zeros((3, 3))))
    with pytest.raises(
        DataError, match=r"000012\.pcd: has no VIEWPOINT.*world frame.*tx ty tz qw qx qy qz"
    ):
        open_sequence(str(folder))


def test_a_viewpoint_of_zeros_is_refused(folder: Path) -> None:
    path = folder / "pcd/000012.pcd"
    content = path.read_bytes()
    start = content.index(b"VIEWPOINT")
    path.write_bytes(
        content[:start] + b"VIEWPOINT 0 0 0 0 0 0 0" + content[content.index(b"\n", start) :]
    )
    with pytest.raises(DataError, match=r"000012\.pcd, VIEWPOINT: .*quaternion of length 1"):
        open_sequence(str(folder))


def test_a_truncated_scan_is_reported_on_opening(folder: Path) -> None:
    path = folder / "pcd/000012.pcd"
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(DataError, match=r"000012\.pcd, byte \d+: file is too short"):
        open_sequence(str(folder))


def test_names_must_be_frame_numbers(folder: Path) -> None:
    for name, problem in (("map.pcd", "not a frame number"), ("10.pcd", "same number as")):
        (folder / "pcd" / name).write_bytes((folder / "pcd/000010.pcd").read_bytes())
        with pytest.raises(DataError, match=problem):
            open_sequence(str(folder))
        (folder / "pcd" / name).unlink()


def test_the_golden_sequence_opens(shared: Path) -> None:
    sequence = open_sequence(str(shared / "golden/mini"))
    assert len(sequence) == 20
    assert all((scan.labels == 1).any() for scan in (sequence[k] for k in range(20)))
