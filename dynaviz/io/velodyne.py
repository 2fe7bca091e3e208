"""KITTI's ``velodyne/*.bin`` and nuScenes' ``*.pcd.bin``: float32 values per point, sensor frame."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from dynaviz.arrays import F32, single
from dynaviz.errors import DataError
from dynaviz.io.atomic import open_file

FIELDS = ("x", "y", "z", "intensity", "ring")


def read_velodyne(path: str | os.PathLike[str], fields: int = 4) -> F32:
    """Read a sweep.

    Args:
        path: the file.
        fields: values per point: 4 for KITTI, 5 for nuScenes, which adds the ring.

    Returns:
        (N, fields) float32: x y z in metres, sensor frame, and intensity.

    Raises:
        DataError: if the file cannot be read or ends in the middle of a point.
    """
    row = 4 * fields
    with open_file(path, f"Give a file of float32 {' '.join(FIELDS[:fields])}") as file:
        size = os.fstat(file.fileno()).st_size
        if size % row:
            layout = f"{' '.join(FIELDS[:fields])}, float32"
            problem = f"ends in the middle of a point: {size} bytes is not a multiple of {row} ({layout})"
            raise DataError(Path(path), problem, at=f"byte {size - size % row}", hint="Copy the file again")
        return single(np.fromfile(file, "<f4")).reshape(-1, fields)
