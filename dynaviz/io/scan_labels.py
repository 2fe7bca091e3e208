"""Moving points of one scan in a file that any program wrote: ``.label``, ``.npy`` or ``.npz``.

Values are 0 (static) and 1 (moving), or classes of SemanticKITTI, of which 251 and above are
moving.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from dynaviz.arrays import U16, Bool
from dynaviz.errors import DataError
from dynaviz.io.atomic import open_file
from dynaviz.io.npy import open_npy

SUFFIXES = (".label", ".npy", ".npz")
MOVING = 251  # lowest moving class of SemanticKITTI
# lowest static class of its moving object segmentation task, "static"; 0 is unlabelled, 1 an
# outlier
_STATIC = 9
_VALUES = "Write 0 and 1, or classes of SemanticKITTI (9 static, 251 moving)"


def read_moving(path: str | os.PathLike[str], points: int, key: str | None = None) -> Bool:
    """Read which points of a scan move.

    A file that contains no value but 0 and 1 is binary. Any other contains classes, where 0 and 1
    are static (unlabelled, outlier). Only the lower 16 bits count; SemanticKITTI has the instance
    in the upper ones.

    Args:
        path: ``.label`` (a uint32 per point), ``.npy`` or ``.npz`` (an array of (N,) or (N, 1)
            integers or booleans).
        points: number of points of the scan.
        key: name of the array in an ``.npz``; by default its only array.

    Returns:
        (points,) bool, in the order of the file.

    Raises:
        DataError: if the file cannot be read, has a different number of labels, or values of
            another meaning.
    """
    path = Path(path)
    stored = _label(path) if path.suffix == ".label" else _array(path, key)
    if len(stored) != points:
        problem = f"has {len(stored):,} labels, but the scan has {points:,} points"
        hint = (
            "Write a label for each point, in the order of the scan, also for points that the "
            "program ignores"
        )
        raise DataError(path, problem, hint=hint)
    values = (stored.astype(np.int64) & 0xFFFF).astype(np.uint16)
    moving: Bool = values == 1 if values.max(initial=0) <= 1 else _moving_class(path, values)
    return moving


def _moving_class(path: Path, classes: U16) -> Bool:
    """Which classes are moving; refuses values that mean something else."""
    used = np.bincount(classes, minlength=1 << 16) > 0
    if used[2:_STATIC].any():
        problem = (
            f"contains the value {2 + int(used[2:_STATIC].argmax())}, which SemanticKITTI does not "
            "use"
        )
        raise DataError(path, problem, hint=f"Map the classes of a network back first. {_VALUES}")
    if used[1] and used[MOVING:].any() and not used[_STATIC:MOVING].any():
        problem = (
            f"contains 1 and {MOVING + int(used[MOVING:].argmax())}, and no static class: their "
            "meaning is unclear"
        )
        raise DataError(path, problem, hint=_VALUES)
    moving: Bool = classes >= MOVING
    return moving


def _label(path: Path) -> Any:
    with open_file(path, "Give a SemanticKITTI label file") as file:
        content = file.read()
    if len(content) % 4:
        problem = f"has {len(content)} bytes, which is not a multiple of 4"
        raise DataError(path, problem, at=f"byte {len(content)}", hint="Copy the file again")
    return np.frombuffer(content, "<u4")


def _array(path: Path, key: str | None) -> Any:
    kind = f"{path.suffix[1:].upper()} file"
    with open_npy(path, kind, "Write it with numpy.save or numpy.savez") as content:
        names = None if isinstance(content, np.ndarray) else list(content)
        name = names[0] if names and len(names) == 1 and key is None else key
        array = content if names is None else content[name] if name in names else None
        if isinstance(
            array, bytes
        ):  # numpy returns members that do not begin like an array as they are
            raise ValueError(f"{name} is not an array")
    if array is None:
        problem = f"contains the arrays {', '.join(names[:20])}" if names else "contains no array"
        problem += "" if key is None else f", and none named {key}"
        raise DataError(path, problem, hint="Name the array with the labels: --key NAME")
    return _checked(path, array)


def _checked(path: Path, array: Any) -> Any:
    """An array with one whole number of at least 0 per point."""
    found = f"contains an array {array.shape} of {array.dtype}"
    if array.ndim == 2 and array.shape[1] == 1:
        array = array[:, 0]
    if array.ndim != 1 or array.dtype.kind not in "biuf":
        raise DataError(path, found, hint=f"Save one number per point. {_VALUES}")
    if array.dtype.kind == "f" and not (np.isfinite(array) & (array == np.floor(array))).all():
        raise DataError(
            path,
            f"{found} with fractions",
            hint=f"Apply the threshold of your network first. {_VALUES}",
        )
    if array.dtype.kind != "b" and (array < 0).any():
        raise DataError(path, f"contains the value {array[array < 0][0]}", hint=_VALUES)
    return array
