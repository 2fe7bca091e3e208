"""The message sensor_msgs/PointCloud2: points of any layout as rows of an array."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import F32

_KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # PointField's INT8 ... FLOAT64


def rows_of(message: Any) -> NDArray[Any]:
    """The points of a message, as they are: any fields, offsets, padding, byte order; organised clouds row by row.

    Returns:
        (height * width,) of a structured dtype with the message's fields.

    Raises:
        ValueError: for fields that do not fit into a point, or data shorter than the message says.
    """
    order = ">" if message.is_bigendian else "<"
    height, width, step, stride = (
        int(getattr(message, name)) for name in ("height", "width", "point_step", "row_step")
    )
    fields = {field.name: field for field in message.fields if field.name}
    if unknown := next((field for field in fields.values() if field.datatype not in _KINDS), None):
        raise ValueError(f"field '{unknown.name}' has the unknown data type {unknown.datatype}")
    forms = [
        (order + _KINDS[f.datatype], (f.count,)) if f.count > 1 else order + _KINDS[f.datatype] for f in fields.values()
    ]
    dtype = np.dtype({
        "names": list(fields), "formats": forms, "offsets": [f.offset for f in fields.values()], "itemsize": step,
    })  # fmt: skip  # raises where a field lies beyond the point
    stride = stride if height > 1 else width * step  # the stride of one row does not matter, and drivers get it wrong
    data = np.ascontiguousarray(message.data, np.uint8)
    needed = (height - 1) * stride + width * step if height and width else 0
    if stride < width * step or len(data) < needed:
        raise ValueError(f"{height} x {width} points of {step} bytes need {needed} bytes, the message has {len(data)}")
    if not needed:
        return np.empty(0, dtype)
    return np.ndarray((height, width), dtype, data, strides=(stride, step)).reshape(-1)


def xyz_of(rows: NDArray[Any]) -> F32:
    """(N, 3) float32, metres, in the message's frame. A return at the sensor itself is none: it becomes NaN.

    Raises:
        ValueError: where x, y or z is missing.
    """
    names = rows.dtype.names or ()
    if missing := [axis for axis in "xyz" if axis not in names or rows.dtype[axis].shape]:
        raise ValueError(f"no field {' '.join(missing)}, only: {' '.join(names)}")
    xyz = np.empty((len(rows), 3), np.float32)
    with np.errstate(over="ignore"):  # beyond float32 is infinite
        for axis, name in enumerate("xyz"):
            xyz[:, axis] = rows[name]
    xyz[(xyz == 0).all(1)] = np.nan  # how drivers of organised clouds write that nothing came back
    return xyz
