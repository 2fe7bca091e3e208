"""Poses of a file, for the scans of a sequence."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dynaviz.arrays import F64
from dynaviz.contracts.scan import Sequence
from dynaviz.errors import DataError
from dynaviz.io.poses import read_poses


def poses_for(sequence: Sequence, file: Path) -> F64:
    """(frames, 4, 4) float64, metres: T_world_sensor of each frame by position.

    Found by number, or by stamp if the scans have stamps.

    Raises:
        DataError: if a scan has no pose.
    """
    found = read_poses(file)
    rows = found.numbers if found.numbers is not None else found.stamps
    poses = dict(zip([] if rows is None else rows.tolist(), found.poses, strict=True))
    chosen = []
    for position in range(len(sequence)):
        scan = sequence[position]
        T = poses.get(scan.index if found.numbers is not None else scan.stamp_ns)
        if T is None:
            raise DataError(
                file, f"has no pose for frame {scan.index}", hint="Estimate the poses again"
            )
        chosen.append(T)
    return np.array(chosen)
