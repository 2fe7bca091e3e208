"""Scans and poses as the files that programs write."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from dynaviz.io.pcd import write_pcd
from helpers.street import Sweep


def scans_to(
    folder: Path, names: Sequence[str], sweeps: Sequence[Sweep], suffix: str = ".pcd"
) -> Path:
    """Write the scans under these names."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, sweep in zip(names, sweeps, strict=True):
        if suffix == ".pcd":
            x, y, z = sweep.points.T
            write_pcd(folder / f"{name}.pcd", {"x": x, "y": y, "z": z}, np.eye(4))
        else:
            rows = np.column_stack([sweep.points, np.full(len(sweep.points), 0.3, np.float32)])
            rows.astype("<f4").tofile(folder / f"{name}.bin")
    return folder


def quaternions(poses: Sequence[np.ndarray]) -> np.ndarray:
    """(N, 7) x y z qx qy qz qw."""
    return np.array([[*T[:3, 3], *Rotation.from_matrix(T[:3, :3]).as_quat()] for T in poses])


def kitti(path: Path, poses: Sequence[np.ndarray]) -> Path:
    """12 numbers per line."""
    np.savetxt(path, [T[:3].ravel() for T in poses], fmt="%.9f")
    return path


def tum(
    path: Path, poses: Sequence[np.ndarray], times: Sequence[int], w_first: bool = False
) -> Path:
    """Times in nanoseconds, positions and quaternions."""
    table = quaternions(poses)
    if w_first:
        table = table[:, [0, 1, 2, 6, 3, 4, 5]]
    rows = [
        f"{t // 10**9}.{t % 10**9:09d} " + " ".join(f"{v:.9f}" for v in row)
        for t, row in zip(times, table, strict=True)
    ]
    path.write_text("\n".join(rows) + "\n")
    return path
