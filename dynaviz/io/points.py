"""Read the coordinates of a point cloud in any supported format."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

import numpy as np

from dynaviz.arrays import F32, single
from dynaviz.errors import DataError
from dynaviz.io.las import read_las
from dynaviz.io.npy import open_npy
from dynaviz.io.pcd import read_pcd
from dynaviz.io.ply import read_ply

Read = TypeVar("Read")


def read_points(path: str | os.PathLike[str]) -> F32:
    """Read a cloud: PCD, PLY, LAS, LAZ, or an array (N, 3 or more columns) in NPY.

    Args:
        path: the file; its suffix selects the format. A viewpoint in the file is not applied.

    Returns:
        (N, 3) float32, metres, in the file's frame; may contain non-finite values.

    Raises:
        DataError: for an unknown suffix, or if the file cannot be read, is corrupt or has no x, y or z.
        MissingDependency: for LAS and LAZ if laspy is not installed.
    """
    path = Path(path)
    return reader_of(path, _READERS)(path)


def reader_of(path: Path, readers: Mapping[str, Callable[[Path], Read]]) -> Callable[[Path], Read]:
    """The reader for the suffix of a path; DataError for an unknown suffix."""
    reader = readers.get(path.suffix.lower())
    if reader is None:
        suffixes = ", ".join(sorted(readers))
        raise DataError(path, "unknown point cloud format", hint=f"Give a file with one of the suffixes {suffixes}")
    return reader


def _read_pcd(path: Path) -> F32:
    return read_pcd(path).xyz


def _read_npy(path: Path) -> F32:
    hint = "Save (N, 3) float32, metres, with numpy.save"
    with open_npy(path, "NPY file", hint) as array:
        pass
    if not isinstance(array, np.ndarray) or array.ndim != 2 or array.shape[1] < 3 or array.dtype.kind not in "fiu":
        found = f"an array {array.shape} of {array.dtype}" if isinstance(array, np.ndarray) else "several arrays"
        raise DataError(path, f"contains {found}, not (N, 3 or more) numbers", hint=hint)
    return single(array[:, :3])


_READERS: dict[str, Callable[[Path], F32]] = {
    ".pcd": _read_pcd,
    ".ply": read_ply,
    ".npy": _read_npy,
    ".las": read_las,
    ".laz": read_las,
}
