"""KITTI's ``velodyne/*.bin``, nuScenes' ``*.pcd.bin`` and others.

Float32 values per point, sensor frame.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dynaviz.arrays import F32, single
from dynaviz.errors import DataError
from dynaviz.io.atomic import open_file

_COLUMNS = (3, 4, 5, 6)
# points to look at, points needed, largest coordinate
_SAMPLE = 2000
_FEWEST = 50
_FARTHEST = 1e7
_SHUFFLED = 0.5  # ratio of steps to distances of points in no order
_CLEARLY = 0.1  # by which columns must differ more than with four

FIELDS = ("x", "y", "z", "intensity", "ring", "time")


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
            problem = (
                f"ends in the middle of a point: {size} bytes is not a multiple of {row} ({layout})"
            )
            hint = (
                "Copy the file again. If it has other columns, open its folder as files:PATH, "
                "which detects them"
            )
            raise DataError(Path(path), problem, at=f"byte {size - size % row}", hint=hint)
        return single(np.fromfile(file, "<f4")).reshape(-1, fields)


def velodyne_attributes(rows: F32, names: Sequence[str] = FIELDS) -> dict[str, F32]:
    """The columns after x, y and z by name, each (N,) float32."""
    return {names[k]: rows[:, k] for k in range(3, rows.shape[1])}


def detect_columns(path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Detect the columns of a file of float32 values from its content.

    Scanners measure neighbours one after the other, so that consecutive points are close together.
    With a wrong number of columns they are not. If the points were shuffled, the columns tell:
    with a wrong number, each mixes values of all. Four columns, as in KITTI, are assumed unless
    another number fits clearly better.

    Returns:
        The names of the columns: ``x y z``, ``intensity``, then ``ring`` for small whole numbers,
        otherwise ``time``.

    Raises:
        DataError: if the file cannot be read, or its size fits no number of columns.
    """
    with open_file(path, "Give a file of float32 x y z intensity") as file:
        size = os.fstat(file.fileno()).st_size
        values = single(np.fromfile(file, "<f4", _SAMPLE * 60))
    spread = {
        n: _spread(values[: len(values) // n * n].reshape(-1, n))
        for n in _COLUMNS
        if size % (4 * n) == 0
    }
    if not spread:
        return FIELDS[:4]  # reading it reports the error
    best = next(n for n in spread if spread[n] <= 1.5 * min(spread.values()))
    if 4 in spread and not spread[best] < 0.5 * spread[4]:
        best = 4
    if _SHUFFLED < spread[best] < np.inf:
        best = _by_distributions(values, [*spread])
    rows = values[: len(values) // best * best].reshape(-1, best)
    names = list(FIELDS[:4][:best])
    for k in range(4, best):
        column = rows[:, k]
        whole = (
            len(column)
            and (column == np.round(column)).all()
            and column.min() >= 0
            and column.max() < 256
        )
        name = "ring" if whole else "time"
        names.append(name if name not in names else f"column_{k}")
    return tuple(names)


def _by_distributions(values: F32, numbers: Sequence[int]) -> int:
    """The number of columns with which columns differ most; four unless another is clearly better.

    Args:
        values: of the file, row by row.
        numbers: of columns that its size allows.
    """
    unlike = {n: _unlike(values[: len(values) // n * n].reshape(-1, n)) for n in numbers}
    best = max(unlike, key=lambda n: unlike[n])
    return best if 4 not in unlike or unlike[best] > unlike[4] + _CLEARLY else 4


def _unlike(rows: F32) -> float:
    """How different columns are, in the mean of all pairs: 0 if equal, 1 without common values.

    It is the largest difference of their shares below a value.
    """
    if len(rows) < _FEWEST or not np.isfinite(rows).all():
        return 0.0
    levels = np.quantile(rows, np.linspace(0.02, 0.98, 49))
    shares = (rows[:, :, None] <= levels).mean(0)
    pairs = [
        float(np.abs(shares[a] - shares[b]).max())
        for a in range(len(shares))
        for b in range(a + 1, len(shares))
    ]
    return float(np.mean(pairs))


def _spread(rows: F32) -> float:
    """How far consecutive points are apart compared with random ones.

    Infinite if the values are no coordinates.
    """
    xyz = rows[:, :3].astype(np.float64)
    if len(xyz) < _FEWEST or not np.isfinite(xyz).all() or np.abs(xyz).max() > _FARTHEST:
        return np.inf
    steps = np.median(np.abs(np.diff(xyz, axis=0)).sum(1))
    apart = np.median(np.abs(xyz[: len(xyz) // 2] - xyz[len(xyz) - len(xyz) // 2 :]).sum(1))
    return float(steps / apart) if apart > 0 else np.inf
