"""Decode sensor_msgs/PointCloud2 messages of any layout into structured arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F32, single

# PointField's INT8 ... FLOAT64
_TYPES = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    8: "f8",
}


def cloud_rows(message: Any) -> NDArray[Any]:
    """The points of a message with all fields, unchanged; organised clouds row by row.

    Any offsets, padding and byte order are supported.

    Returns:
        (height * width,) of a structured dtype with the message's fields.

    Raises:
        ValueError: if a field does not fit into a point, or the data are shorter than the message
            states.
    """
    order = ">" if message.is_bigendian else "<"
    height, width, step, stride = (
        int(getattr(message, name)) for name in ("height", "width", "point_step", "row_step")
    )
    fields = {field.name: field for field in message.fields if field.name}
    if unknown := next((field for field in fields.values() if field.datatype not in _TYPES), None):
        raise ValueError(f"field '{unknown.name}' has unknown data type {unknown.datatype}")
    formats = [
        (order + _TYPES[f.datatype], (f.count,)) if f.count > 1 else order + _TYPES[f.datatype]
        for f in fields.values()
    ]
    dtype = np.dtype({
        "names": list(fields), "formats": formats, "offsets": [f.offset for f in fields.values()],
        "itemsize": step,
    })  # fmt: skip  # raises if a field extends beyond the point
    stride = stride if height > 1 else width * step  # unused for one row; some drivers set it wrong
    data = np.ascontiguousarray(message.data, np.uint8)
    needed = (height - 1) * stride + width * step if height and width else 0
    if stride < width * step or len(data) < needed:
        raise ValueError(
            f"{height} x {width} points of {step} bytes need {needed} bytes, the message has "
            f"{len(data)}"
        )
    if not needed:
        return np.empty(0, dtype)
    return np.ndarray((height, width), dtype, data, strides=(stride, step)).reshape(-1)


def cloud_xyz(rows: NDArray[Any]) -> F32:
    """(N, 3) float32, metres, in the message's frame.

    Points at the origin are not returns and become NaN.

    Raises:
        ValueError: if x, y or z is missing.
    """
    names = rows.dtype.names or ()
    if missing := [axis for axis in "xyz" if axis not in names or rows.dtype[axis].shape]:
        raise ValueError(f"field {' '.join(missing)} is missing (found: {' '.join(names)})")
    xyz = np.empty((len(rows), 3), np.float32)
    for axis, name in enumerate("xyz"):
        xyz[:, axis] = single(rows[name])
    xyz[(xyz == 0).all(1)] = np.nan  # drivers of organised clouds write missing returns as zeros
    return xyz
