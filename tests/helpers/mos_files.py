"""Write small sequences in the layouts of HeLiMOS and DOALS."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from helpers.bags import START, at
from helpers.kitti_files import write_sweep


def write_helimos(folder: Path, lidars: Iterable[str] = ("Ouster",)) -> Path:
    """HeLiMOS: four sweeps of each lidar, which moves 1 m forward per sweep.

    The first three have labels.

    Returns:
        The folder ``Deskewed_LiDAR``.
    """
    root = folder / "KAIST05/Deskewed_LiDAR"
    for lidar in lidars:
        (root / lidar / "labels").mkdir(parents=True, exist_ok=True)
        for frame in range(4):
            write_sweep(
                root / lidar / f"velodyne/{frame:06d}.bin",
                [(10, 0, 0), (20, 1, 0), (2, 2, 0), (0, 1, 0)],
            )
            if frame < 3:
                np.array([9, 251, 0, 1], "<u4").tofile(root / lidar / f"labels/{frame:06d}.label")
        (root / lidar / "calib.txt").write_text("Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n")
        (root / lidar / "poses.txt").write_text(
            "".join(f"1 0 0 {k} 0 1 0 0 0 0 1 0\n" for k in range(4))
        )
    for frame, split in enumerate(("train", "val", "test")):
        (root / f"{split}.txt").write_text(f"{frame:06d}\n")
    return root


def write_doals(folder: Path) -> Path:
    """DOALS: five scans as files named by stamp; the second and the fourth have labels.

    Returns:
        The folder of the sequence.
    """
    root = folder / "hauptgebaeude/sequence_1"
    stamps = [START + k * 100_000_000 for k in range(5)]
    for stamp in stamps:
        write_sweep(root / f"scans/{stamp}.bin", np.arange(1.0, 16.0).reshape(5, 3))
    poses = np.array([at(0.5 * k) for k in range(5)])
    np.savetxt(root / "poses.txt", poses[:, :3].reshape(5, 12))
    (root / "indices.csv").write_text(f"{stamps[1]},1,2\n{stamps[3]},4\n")
    return root
