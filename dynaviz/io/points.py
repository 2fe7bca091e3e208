"""A cloud's coordinates, whatever the format of its file."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from dynaviz.arrays import F32
from dynaviz.errors import DataError
from dynaviz.io.las import read_las
from dynaviz.io.npy import loaded
from dynaviz.io.pcd import read_pcd
from dynaviz.io.ply import read_ply


def read_points(path: str | os.PathLike[str]) -> F32:
    """Read a cloud: PCD, PLY, LAS, LAZ, or an array (N, 3 or more columns) in NPY.

    Args:
        path: its suffix tells the format. A viewpoint in the file is not applied.

    Returns:
        (N, 3) float32, metres, in the file's frame; may hold non-finite values.

    Raises:
        DataError: for a suffix that is not known, a file that cannot be read, is damaged or has no x, y, z.
        MissingDependency: for LAS and LAZ without laspy.
    """
    path = Path(path)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        kinds = ", ".join(sorted(_READERS))
        raise DataError(path, "is no cloud that can be read", hint=f"Give a file that ends in one of {kinds}")
    return reader(path)


def _pcd(path: Path) -> F32:
    return read_pcd(path).xyz


def _npy(path: Path) -> F32:
    hint = "Save (N, 3) float32, metres, with numpy.save"
    with loaded(path, "NPY file", hint) as array:
        pass
    if not isinstance(array, np.ndarray) or array.ndim != 2 or array.shape[1] < 3 or array.dtype.kind not in "fiu":
        what = f"an array {array.shape} of {array.dtype}" if isinstance(array, np.ndarray) else "several arrays"
        raise DataError(path, f"holds {what}, not (N, 3 or more) numbers", hint=hint)
    with np.errstate(over="ignore"):  # beyond float32 is infinite
        return array[:, :3].astype(np.float32)


_READERS: dict[str, Callable[[Path], F32]] = {
    ".pcd": _pcd,
    ".ply": read_ply,
    ".npy": _npy,
    ".las": read_las,
    ".laz": read_las,
}
