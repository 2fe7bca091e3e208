"""E57 files, read with pye57: one scan per file, with its pose."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F64
from dynaviz.errors import DataError, MissingDependency
from dynaviz.io.atomic import open_file
from dynaviz.spatial import geometry

SUFFIX = ".e57"
_HINT = "Export one scan per file, numbered, with its pose"
_NAMES = {
    "cartesianX": "x",
    "cartesianY": "y",
    "cartesianZ": "z",
    "colorRed": "red",
    "colorGreen": "green",
    "colorBlue": "blue",
    "timeStamp": "time",
    "rowIndex": "row",
    "columnIndex": "column",
}
_INVALID = "cartesianInvalidState"


def read_e57_fields(path: str | os.PathLike[str]) -> dict[str, NDArray[Any]]:
    """Read the only scan of a file, in its own frame.

    Returns:
        (N,) by name: x, y and z in metres, and the other fields. Points that the file states to be
        invalid are NaN.

    Raises:
        DataError: if the file cannot be read, has several scans, or no cartesian coordinates.
        MissingDependency: if pye57 is not installed.
    """
    path = Path(path)
    with _opened(path) as file:
        fields = file.read_scan_raw(0, ignore_unsupported_fields=True)
    invalid = fields.pop(_INVALID, None)
    named = {_NAMES.get(name, name): np.asarray(values) for name, values in fields.items()}
    for axis in "xyz":
        if axis in named and invalid is not None:
            named[axis] = np.where(np.asarray(invalid) > 0, np.nan, named[axis])
    return named


def read_e57_pose(path: Path) -> F64 | None:
    """(4, 4) float64, metres: T_world_sensor of the only scan; None if the file has none.

    Raises:
        DataError, MissingDependency: as ``read_e57_fields``.
    """
    with _opened(path) as file:
        header = file.get_header(0)
        if not header.has_pose():
            return None
        return geometry.pose(tuple(header.translation), tuple(header.rotation))


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """The file, with one scan."""
    try:
        import pye57
    except ModuleNotFoundError:
        raise MissingDependency(
            f"{path}: E57 files need pye57. Install it with: pip install pye57"
        ) from None
    with open_file(path, _HINT):
        pass
    try:
        with pye57.E57(os.fspath(path)) as file:
            if file.scan_count != 1:
                raise DataError(path, f"contains {file.scan_count} scans", hint=_HINT)
            yield file
    except DataError:
        raise
    except Exception as error:  # libe57 raises its own errors for corrupt files
        problem = f"not a valid E57 file ({str(error)[:80]})"
        raise DataError(path, problem, hint="Write or copy the file again") from None
