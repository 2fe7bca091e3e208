"""Read all fields of a point cloud, in the types of the file.

Coordinates, and attributes such as intensity.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F32, F64, single
from dynaviz.errors import DataError
from dynaviz.io.e57 import read_e57_fields
from dynaviz.io.las import read_las_fields
from dynaviz.io.npy import open_npy
from dynaviz.io.pcd import read_pcd
from dynaviz.io.ply import read_ply_rows
from dynaviz.io.text_cloud import SUFFIXES as TEXT_SUFFIXES
from dynaviz.io.text_cloud import read_text_fields

Fields = dict[str, NDArray[Any]]

AXES = ("x", "y", "z")


def read_fields(path: str | os.PathLike[str]) -> Fields:
    """Read all fields of a PCD, PLY, LAS, LAZ, NPY, NPZ, E57 or text file.

    Args:
        path: the file; its suffix selects the format.

    Returns:
        (N,) integers or floats by name: x, y and z in metres, and the attributes, unchanged. A
        field with several values per point is split: ``normal_0``, ``normal_1``.

    Raises:
        DataError: for an unknown suffix, or if the file cannot be read, is corrupt or has no x, y
            or z.
        MissingDependency: for LAS and LAZ if laspy is not installed, for E57 if pye57 is not.
    """
    path = Path(path)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        suffixes = ", ".join(sorted(_READERS))
        raise DataError(
            path,
            "unknown point cloud format",
            hint=f"Give a file with one of the suffixes {suffixes}",
        )
    fields = reader(path)
    if missing := [axis for axis in AXES if axis not in fields]:
        hint = "Write the cloud with x, y and z"
        raise DataError(
            path, f"has no {', '.join(missing)} (found: {', '.join(fields)})", hint=hint
        )
    return fields


def read_points(path: str | os.PathLike[str]) -> F32:
    """Read the coordinates of a PCD, PLY, LAS, LAZ, NPY or NPZ file.

    (N, 3) float32, metres, in the file's frame.

    A viewpoint in the file is not applied; values may be non-finite.

    Raises:
        DataError, MissingDependency: as ``read_fields``.
    """
    return single(given_coordinates(read_fields(path)))


def without_axes(fields: Mapping[str, NDArray[Any]]) -> Fields:
    """The attributes among the fields."""
    return {name: array for name, array in fields.items() if name not in AXES}


def coordinates(fields: Mapping[str, NDArray[Any]]) -> F64:
    """(N, 3) float64, metres."""
    return given_coordinates(fields).astype(np.float64)


def given_coordinates(fields: Mapping[str, NDArray[Any]]) -> F32 | F64:
    """(N, 3), metres: float32 if it holds the types of the file, otherwise float64."""
    dtype = np.result_type(np.float32, *(fields[axis].dtype for axis in AXES))
    with np.errstate(invalid="ignore"):  # signalling NaNs become quiet
        return np.column_stack([fields[axis].astype(dtype) for axis in AXES])


def columns_of(rows: NDArray[Any]) -> Fields:
    """The fields of a structured array, (N,) each; padding (``_``) is left out."""
    fields: Fields = {}
    for name in rows.dtype.names or ():
        column = rows[name]
        if name.strip("_") == "" or column.dtype.kind not in "fiub":
            continue
        if column.ndim == 1:
            fields[name] = column
        else:
            flat = column.reshape(len(rows), -1)
            fields |= {
                f"{name}_{k}" if flat.shape[1] > 1 else name: flat[:, k]
                for k in range(flat.shape[1])
            }
    return fields


def _npy(path: Path) -> Fields:
    hint = (
        "Save (N, 3 or more) float32, metres, or a structured array with x, y and z, with "
        "numpy.save"
    )
    with open_npy(path, "NPY file", hint) as array:
        rows = np.array(array) if isinstance(array, np.ndarray) else np.empty(0)
    if rows.dtype.names:
        return columns_of(rows)
    if rows.ndim != 2 or rows.shape[1] < 3 or rows.dtype.kind not in "fiu":
        problem = f"contains an array {rows.shape} of {rows.dtype}, not (N, 3 or more) numbers"
        raise DataError(path, problem, hint=hint)
    names = [*AXES, "intensity", *(f"column_{k}" for k in range(4, rows.shape[1]))]
    return {name: rows[:, k] for k, name in zip(range(rows.shape[1]), names, strict=False)}


def _npz(path: Path) -> Fields:
    """The arrays of an NPZ file with a value per point, and the columns of ``points``
    or ``xyz``.
    """
    hint = "Save points = (N, 3) float32, metres, and arrays of N values, with numpy.savez"
    with open_npy(path, "NPZ file", hint) as arrays:
        loaded = {name: arrays[name] for name in arrays}
    if all(axis in loaded for axis in AXES):
        return {name: array for name, array in loaded.items() if array.shape == loaded["x"].shape}
    clouds = [
        name
        for name, array in loaded.items()
        if array.ndim == 2 and array.shape[1] >= 3 and array.dtype.kind in "fiu"
    ]
    named = [name for name in ("points", "xyz") if name in clouds]
    if not named and len(clouds) != 1:
        problem = (
            f"contains {len(clouds) or 'no'} arrays (N, 3 or more) of numbers, and none named "
            "points"
        )
        raise DataError(path, problem, hint=hint)
    points = loaded.pop((named or clouds)[0])
    more = ["intensity", *(f"column_{k}" for k in range(4, points.shape[1]))][: points.shape[1] - 3]
    fields = {field: points[:, k] for k, field in enumerate([*AXES, *more])}
    return fields | {key: array for key, array in loaded.items() if array.shape == (len(points),)}


_READERS: dict[str, Callable[[Path], Fields]] = {
    ".pcd": lambda path: columns_of(read_pcd(path).rows),
    ".ply": lambda path: columns_of(read_ply_rows(path)),
    ".npy": _npy,
    ".npz": _npz,
    ".las": read_las_fields,
    ".laz": read_las_fields,
    ".e57": read_e57_fields,
    **dict.fromkeys(TEXT_SUFFIXES, read_text_fields),
}
