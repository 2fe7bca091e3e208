"""KITTI's calibration files, with a line ``NAME: NUMBERS`` per matrix."""

from __future__ import annotations

import os
from collections.abc import Mapping

import numpy as np

from dynaviz.arrays import F64
from dynaviz.errors import DataError
from dynaviz.io.atomic import open_file
from dynaviz.spatial import geometry

_HINT = "Write each line as NAME: NUMBERS, with 12 numbers for a transform"


def read_calib(path: str | os.PathLike[str]) -> dict[str, F64]:
    """Read all lines except the date. The colon may be missing, as in some of KITTI's own files.

    Returns:
        float64 arrays by name: (12,), (9,) or any other length, as in the file.

    Raises:
        DataError: if the file cannot be read or a line contains anything but numbers.
    """
    rows = {}
    with open_file(path, _HINT) as file:
        for number, line in enumerate(file, 1):
            name, *values = line.decode("latin-1").split() or [""]
            if name == "calib_time:":
                continue
            try:
                rows[name.removesuffix(":")] = np.array(values, np.float64)
            except ValueError:
                raise DataError(
                    path, "contains something other than numbers", at=f"line {number}", hint=_HINT
                ) from None
    return rows


def calib_matrix(path: str | os.PathLike[str], rows: Mapping[str, F64], *names: str) -> F64:
    """The first of the named rows that exists, as (3, 4) or (3, 3) float64.

    Raises:
        DataError: if no row exists, or the row does not have 12 or 9 finite numbers.
    """
    name = next((name for name in names if name in rows), None)
    if name is None:
        raise DataError(path, f"line {' or '.join(names)} is missing", hint=_HINT)
    if rows[name].size not in (9, 12) or not np.isfinite(rows[name]).all():
        raise DataError(path, f"line {name} must have 9 or 12 finite numbers", hint=_HINT)
    return rows[name].reshape(3, -1)


def calib_transform(path: str | os.PathLike[str], rows: Mapping[str, F64], *names: str) -> F64:
    """``calib_matrix`` as a rigid transform, (4, 4) float64, metres.

    The rotation is orthonormalised, because the numbers in the files are rounded.

    Raises:
        DataError: as in ``calib_matrix``, and for a rotation of zeros.
    """
    matrix = calib_matrix(path, rows, *names)
    T = np.eye(4)
    try:
        T[:3, :3] = geometry.matrix(geometry.quaternion(matrix[:, :3]))
    except ValueError:
        raise DataError(path, f"line {' or '.join(names)} does not contain a rotation", hint=_HINT) from None
    if matrix.shape == (3, 4):
        T[:3, 3] = matrix[:, 3]
    return T
