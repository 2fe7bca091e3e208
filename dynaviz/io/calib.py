"""KITTI's calibration files: ``name: numbers`` in each line."""

from __future__ import annotations

import os
from collections.abc import Mapping

import numpy as np

from dynaviz.arrays import F64
from dynaviz.errors import DataError
from dynaviz.io.atomic import opened
from dynaviz.spatial import geometry

_HINT = "A line of a calibration file reads NAME: NUMBERS, with 12 numbers for a transform"


def read_calib(path: str | os.PathLike[str]) -> dict[str, F64]:
    """Read all lines but the date; the colon may be missing, as in some of KITTI's own files.

    Returns:
        By name, (12,), (9,) or another number of float64 as in the file.

    Raises:
        DataError: for a file that cannot be read, or a line that is not numbers.
    """
    rows = {}
    with opened(path, _HINT) as file:
        for number, line in enumerate(file, 1):
            name, *values = line.decode("latin-1").split() or [""]
            if name == "calib_time:":
                continue
            try:
                rows[name.removesuffix(":")] = np.array(values, np.float64)
            except ValueError:
                raise DataError(path, "has something else than numbers", at=f"line {number}", hint=_HINT) from None
    return rows


def matrix_of(path: str | os.PathLike[str], rows: Mapping[str, F64], *names: str) -> F64:
    """(3, 4) or (3, 3) float64: the first of the named rows that is there, as it stands in the file.

    Raises:
        DataError: where none is there, or it has neither 12 nor 9 finite numbers.
    """
    name = next((name for name in names if name in rows), None)
    if name is None:
        raise DataError(path, f"has no line {' or '.join(names)}", hint=_HINT)
    if rows[name].size not in (9, 12) or not np.isfinite(rows[name]).all():
        raise DataError(path, f"has neither 9 nor 12 numbers in its line {name}", hint=_HINT)
    return rows[name].reshape(3, -1)


def rigid_of(path: str | os.PathLike[str], rows: Mapping[str, F64], *names: str) -> F64:
    """(4, 4) float64, metres: as ``matrix_of``, made rigid, for the files round the numbers.

    Raises:
        DataError: as ``matrix_of``, and for a rotation of zeros.
    """
    matrix = matrix_of(path, rows, *names)
    T = np.eye(4)
    try:
        T[:3, :3] = geometry.matrix(geometry.quaternion(matrix[:, :3]))
    except ValueError:
        raise DataError(path, f"has no rotation in its line {' or '.join(names)}", hint=_HINT) from None
    if matrix.shape == (3, 4):
        T[:3, 3] = matrix[:, 3]
    return T
