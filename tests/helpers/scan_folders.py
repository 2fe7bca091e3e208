"""Write folders of scans in every supported format, with pose files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dynaviz.contracts.scan import Scan
from dynaviz.io.pcd import write_pcd
from dynaviz.spatial import geometry
from helpers.bags import START, at

N = 5
XYZ = np.random.default_rng(0).uniform(-20, 20, (N, 40, 3)).astype(np.float32)
POSES = np.array([at(2.0 * k, -0.5 * k, 1.5, 0.2 * k) for k in range(N)])
STAMPS = [START + k * 100_000_000 for k in range(N)]


def _write_with_open3d(path: Path, xyz: np.ndarray) -> None:
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(xyz.astype(np.float64)))
    o3d.io.write_point_cloud(str(path), cloud)


def _write_las(path: Path, xyz: np.ndarray) -> None:
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales = [1e-4] * 3
    las = laspy.LasData(header)
    las.x, las.y, las.z = xyz.T.astype(np.float64)
    las.write(path)


WRITERS: dict[str, Callable[[Path, np.ndarray], None]] = {
    ".bin": lambda path, xyz: np.column_stack([xyz, np.ones(len(xyz))]).astype("<f4").tofile(path),
    ".npy": np.save,
    ".npz": lambda path, xyz: np.savez(path, points=xyz, intensity=np.ones(len(xyz))),
    ".pcd": _write_with_open3d,
    ".ply": _write_with_open3d,
    ".las": _write_las,
    ".laz": _write_las,
}
"""By suffix: writes points (N, 3)."""


def write_scans(
    folder: Path, suffix: str = ".bin", names: list[str] | None = None, clouds: np.ndarray = XYZ
) -> Path:
    """Write scans named by number, or by the given names; returns the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for k, xyz in enumerate(clouds):
        WRITERS[suffix](folder / f"{names[k] if names else f'{k:06d}'}{suffix}", xyz)
    return folder


def write_attributed_scans(
    folder: Path, scans: Sequence[Scan], offset: np.ndarray | float | None = 0.0
) -> Path:
    """Write scans in the sensor frame with ring and intensity, and their poses; returns the folder.

    Args:
        folder: a new one.
        scans: to write, in the world frame.
        offset: metres, added to the positions, so that sums are exact; None writes no poses.
    """
    folder.mkdir(parents=True)
    for scan in scans:
        local = geometry.transform(geometry.inverse(scan.T_world_sensor), scan.points)
        numbers = np.arange(len(local))
        fields = {axis: local[:, k] for k, axis in enumerate("xyz")}
        fields |= {
            "ring": (numbers % 16).astype(np.uint16),
            "intensity": (numbers / 7).astype(np.float32),
        }
        write_pcd(folder / f"{scan.index:06d}.pcd", fields)
    if offset is not None:
        T = np.array([scan.T_world_sensor for scan in scans])
        T[:, :3, 3] = np.round(T[:, :3, 3] * 1024) / 1024 + offset
        np.savetxt(folder / "poses.txt", T[:, :3].reshape(len(T), 12), fmt="%.17g")
    return folder


def write_kitti_poses(path: Path, poses: np.ndarray = POSES) -> Path:
    """Write poses (K, 4, 4) with 12 numbers per line; returns the path."""
    np.savetxt(path, poses[:, :3].reshape(len(poses), 12))
    return path


def write_tum_poses(path: Path, stamps: list[int], poses: np.ndarray) -> Path:
    """Write poses (K, 4, 4) with stamps in nanoseconds; returns the path."""
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    rows = zip(stamps, poses[:, :3, 3], quaternions, strict=True)
    path.write_text(
        "".join(
            f"{t // 10**9}.{t % 10**9:09d} {' '.join(map(repr, [*p.tolist(), *q.tolist()]))}\n"
            for t, p, q in rows
        )
    )
    return path
