"""SemanticKITTI's ``labels/*.label`` files.

A uint32 per point, lower 16 bits class, upper instance.
"""

from __future__ import annotations

import os

import numpy as np

from dynaviz.arrays import U16
from dynaviz.errors import DataError
from dynaviz.io.atomic import open_file, write_atomic


def read_semantic_labels(path: str | os.PathLike[str], points: int) -> tuple[U16, U16]:
    """Read the labels of a sweep.

    Args:
        path: the file.
        points: number of points of the sweep.

    Returns:
        classes: (points,) uint16, the lower 16 bits.
        instances: (points,) uint16, the upper 16 bits.

    Raises:
        DataError: if the file cannot be read or has a different number of labels.
    """
    with open_file(path, "Give a SemanticKITTI label file") as file:
        size = os.fstat(file.fileno()).st_size
        if size != 4 * points:
            problem = f"has {size} bytes, but {points} points need {4 * points}"
            raise DataError(
                path, problem, at=f"byte {min(size, 4 * points)}", hint="Copy the file again"
            )
        pairs = np.fromfile(file, "<u2").reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def write_semantic_labels(
    path: str | os.PathLike[str], classes: U16, instances: U16 | None = None
) -> None:
    """Write the labels of a sweep atomically.

    Args:
        path: the file.
        classes: (points,) uint16, the lower 16 bits.
        instances: (points,) uint16, the upper 16 bits; None for 0.

    Raises:
        DataError: if the file cannot be written.
    """
    values = classes.astype("<u4")
    if instances is not None:
        values |= instances.astype("<u4") << 16
    write_atomic(path, values.tobytes())
