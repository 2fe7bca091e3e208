"""A cloud's coordinates, whatever the format of its file."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from dynaviz.errors import DataError, MissingDependency
from dynaviz.io.atomic import opened
from dynaviz.io.pcd import read_pcd
from dynaviz.io.ply import read_ply
from dynaviz.scan import F32


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
    with opened(path, hint) as file:
        try:
            array = np.load(file, allow_pickle=False)
        except (ValueError, EOFError) as error:
            raise DataError(path, f"is no whole NPY file ({str(error)[:80]})", hint=hint) from None
    if not isinstance(array, np.ndarray) or array.ndim != 2 or array.shape[1] < 3 or array.dtype.kind not in "fiu":
        what = f"an array {array.shape} of {array.dtype}" if isinstance(array, np.ndarray) else "several arrays"
        raise DataError(path, f"holds {what}, not (N, 3 or more) numbers", hint=hint)
    with np.errstate(over="ignore"):  # beyond float32 is infinite
        return array[:, :3].astype(np.float32)


def _las(path: Path) -> F32:
    try:
        import laspy
    except ModuleNotFoundError:
        raise MissingDependency(
            f"{path}: LAS and LAZ files need laspy. Install it with: pip install 'dynaviz[las]'"
        ) from None
    hint = "Write or copy the file again"
    with opened(path, hint) as file:
        try:
            las = laspy.read(file, closefd=False)
            points, promised = np.asarray(las.xyz), las.header.point_count
        # Damaged files make laspy and its decompressor fail in many ways.
        except Exception as error:
            raise DataError(path, f"is no whole LAS file ({str(error)[:80]})", hint=hint) from None
    if len(points) < promised:
        problem = f"is too short: it has {len(points)} points, where its header says {promised}"
        raise DataError(path, problem, hint=hint)
    return points.astype(np.float32)


_READERS: dict[str, Callable[[Path], F32]] = {
    ".pcd": _pcd,
    ".ply": read_ply,
    ".npy": _npy,
    ".las": _las,
    ".laz": _las,
}
