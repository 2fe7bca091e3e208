"""SemanticKITTI's ``labels/*.label``: a uint32 for each point, class below and instance above."""

from __future__ import annotations

import os

import numpy as np

from dynaviz.arrays import U16
from dynaviz.errors import DataError
from dynaviz.io.atomic import opened, write_whole


def read_semantic_labels(path: str | os.PathLike[str], points: int) -> tuple[U16, U16]:
    """Read the labels of a sweep.

    Args:
        path: the file.
        points: how many points the sweep has.

    Returns:
        classes: (points,) uint16, the lower 16 bits.
        instances: (points,) uint16, the upper 16 bits.

    Raises:
        DataError: for a file that cannot be read, or that has another number of labels.
    """
    with opened(path, "Give a SemanticKITTI label file") as file:
        size = os.fstat(file.fileno()).st_size
        if size != 4 * points:
            problem = f"has {size} bytes, where {points} points need {4 * points}"
            raise DataError(path, problem, at=f"byte {min(size, 4 * points)}", hint="Copy the file again")
        both = np.fromfile(file, "<u2").reshape(-1, 2)
    return both[:, 0], both[:, 1]


def write_semantic_labels(path: str | os.PathLike[str], classes: U16) -> None:
    """Write the labels of a sweep, without instances, whole or not at all.

    Args:
        path: the file.
        classes: (points,) uint16, the lower 16 bits.

    Raises:
        DataError: where the file cannot be written.
    """
    write_whole(path, classes.astype("<u4").tobytes())
