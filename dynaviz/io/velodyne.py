"""KITTI's ``velodyne/*.bin``: x y z intensity of each point, float32, sensor frame."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from dynaviz.errors import DataError
from dynaviz.io.atomic import opened
from dynaviz.scan import F32


def read_velodyne(path: str | os.PathLike[str]) -> F32:
    """Read a sweep.

    Returns:
        (N, 4) float32: x y z in metres, sensor frame, and intensity.

    Raises:
        DataError: for a file that cannot be read, or whose size is not a multiple of 16 bytes.
    """
    with opened(path, "Give a KITTI velodyne file") as file:
        size = os.fstat(file.fileno()).st_size
        if size % 16:
            problem = f"ends in the middle of a point: {size} bytes are no multiple of 16 (x y z intensity, float32)"
            raise DataError(Path(path), problem, at=f"byte {size - size % 16}", hint="Copy the file again")
        return np.fromfile(file, "<f4").reshape(-1, 4)
